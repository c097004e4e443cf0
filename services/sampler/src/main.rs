//! The sampler as a separate program.

fn main() -> std::process::ExitCode {
    ports::stage_main(sampler::run)
}
