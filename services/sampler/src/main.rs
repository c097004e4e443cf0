//! The sampler as a program of its own.

fn main() -> std::process::ExitCode {
    ports::stage_main(sampler::stage::run)
}
