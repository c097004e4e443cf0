//! The extractor as a program of its own.

fn main() -> std::process::ExitCode {
    ports::stage_main(extractor::run)
}
