//! The localiser as a program of its own.

fn main() -> std::process::ExitCode {
    ports::stage_main(localiser::run)
}
