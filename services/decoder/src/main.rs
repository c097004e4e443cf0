//! The decoder as a standalone program.

fn main() -> std::process::ExitCode {
    ports::stage_main(decoder::run)
}
