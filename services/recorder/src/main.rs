//! The recorder as a separate program.

fn main() -> std::process::ExitCode {
    ports::stage_main(recorder::stage::run)
}
