//! Trains a model as the JSON file of options says: `cargo run --release -p stgdat-trainer --example train options.json`.

use burn::tensor::Device;
use trainer::{TrainOptions, train};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let options: TrainOptions = match std::env::args().nth(1) {
        Some(path) => serde_json::from_str(&std::fs::read_to_string(path)?)?,
        None => TrainOptions::default(),
    };
    let summary = train(&options, &Device::flex())?;
    println!("{}", serde_json::to_string_pretty(&summary.card.gains)?);
    Ok(())
}
