//! Trains a model as the JSON file of options says: `cargo run --release -p stgdat-trainer --example train options.json`.

use trainer::{TrainOptions, train};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let name = arguments.next().unwrap_or_default();
    let mut options = serde_json::to_value(trainer::recipe(&name).unwrap_or_default())?;
    for pair in arguments {
        let (key, value) = pair.split_once('=').ok_or("key=value")?;
        let mut place = &mut options;
        for part in key.split('.') {
            place = &mut place[part];
        }
        *place = serde_json::from_str(value).unwrap_or_else(|_| value.into());
    }
    let options: TrainOptions = serde_json::from_value(options)?;
    train(&options)?;
    Ok(())
}
