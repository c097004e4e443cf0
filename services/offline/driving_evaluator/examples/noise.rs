//! Prints the tables of noise. It builds without the laboratory.
//!
//! ```text
//! cargo run --release -p stgdat-driving-evaluator --example noise                      # generated agents
//! cargo run --release -p stgdat-driving-evaluator --example noise DIR/driving womd 8   # recorded ones
//! ```

use std::path::PathBuf;

use driving_evaluator::{DrivingError, Options, synthetic, under_noise};

#[expect(clippy::print_stdout, reason = "it prints its tables")]
fn main() -> Result<(), DrivingError> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let options = Options {
        folder: arguments.first().map(PathBuf::from).unwrap_or_default(),
        sources: arguments.get(1).cloned().into_iter().collect(),
        weights: None,
        precision: nn::Precision::F32,
        map: true,
        evidence: true,
        priors: true,
        noise: evaluator::Noise::default(),
        threads: std::thread::available_parallelism().map_or(1, usize::from),
    };
    let table = if arguments.is_empty() {
        synthetic(&options)?.markdown()
    } else {
        let scenes = arguments.get(2).and_then(|scenes| scenes.parse().ok()).unwrap_or(8);
        under_noise(&options, scenes, |_| ())?.markdown()
    };
    println!("{table}");
    Ok(())
}
