//! The decoder as a program of its own.

fn main() -> std::process::ExitCode {
    ports::stage_main(decoder::run)
}
