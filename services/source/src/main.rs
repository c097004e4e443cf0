//! The source as a program of its own.

fn main() -> std::process::ExitCode {
    ports::stage_main(source::stage::run)
}
