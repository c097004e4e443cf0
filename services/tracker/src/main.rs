//! The tracker as a separate program.

fn main() -> std::process::ExitCode {
    ports::stage_main(tracker::run)
}
