//! Prints the tables of generated agents under noise. It builds without the laboratory.
//!
//! ```text
//! cargo run --release -p stgdat-driving-evaluator --example noise
//! ```

use std::path::PathBuf;

use driving_evaluator::{DrivingError, Options, synthetic};

#[expect(clippy::print_stdout, reason = "it prints its tables")]
fn main() -> Result<(), DrivingError> {
    let options = Options {
        folder: PathBuf::new(),
        sources: Vec::new(),
        weights: None,
        precision: nn::Precision::F32,
        map: true,
        evidence: true,
        priors: true,
        threads: std::thread::available_parallelism().map_or(1, usize::from),
    };
    println!("{}", synthetic(&options)?.markdown());
    Ok(())
}
