//! The encoder as a standalone program.

fn main() -> std::process::ExitCode {
    ports::stage_main(encoder::run)
}
