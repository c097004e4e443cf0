//! The encoder as a program of its own.

fn main() -> std::process::ExitCode {
    ports::stage_main(encoder::run)
}
