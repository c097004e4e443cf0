//! The localiser as a standalone program.

fn main() -> std::process::ExitCode {
    ports::stage_main(localiser::run)
}
