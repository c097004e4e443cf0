//! The source as a standalone program.

fn main() -> std::process::ExitCode {
    ports::stage_main(source::stage::run)
}
