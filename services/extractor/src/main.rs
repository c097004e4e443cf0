//! The extractor as a standalone program.

fn main() -> std::process::ExitCode {
    ports::stage_main(extractor::run)
}
