use std::path::PathBuf;

use clap::Args;
use evaluator::Comparison;
use run::Exit;

use crate::failure::Failure;

/// Arguments of `stgdat verify`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Folders with scene.json, weights.safetensors and tensors.safetensors, or with filters, assignment, metrics and unit
    #[arg(required = true, value_name = "DIR")]
    folders: Vec<PathBuf>,
}

/// Recomputes the golden vectors of folders on this machine and tells which ones are off.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let mut off_len = 0;
    for folder in &arguments.folders {
        let rows = evaluator::verify(folder).map_err(Failure::data)?;
        println!("{} ({} kernels)", folder.display(), nn::kernels::active().name());
        let width = rows.iter().map(|row| row.name.len()).max().unwrap_or(0).max(30);
        println!(
            "  {:<width$} {:>20} {:>12} {:>10} {:>10}",
            "vector", "shape", "largest", "error", "tolerance"
        );
        rows.iter().for_each(|row| print(row, width));
        let off = rows.iter().filter(|row| !row.agrees()).count();
        println!("  {} of {} vectors agree\n", rows.len() - off, rows.len());
        off_len += off;
    }
    match off_len {
        0 => Ok(Exit::Done),
        1 => Err(Failure::Failed("1 vector is off by more than its tolerance".to_owned())),
        _ => Err(Failure::Failed(format!("{off_len} vectors are off by more than their tolerance"))),
    }
}

fn print(row: &Comparison, width: usize) {
    let join =
        |numbers: &[usize], by: &str| numbers.iter().map(ToString::to_string).collect::<Vec<_>>().join(by);
    let verdict = if row.agrees() { String::new() } else { format!("  off at [{}]", join(&row.worst, ", ")) };
    println!(
        "  {:<width$} {:>20} {:>12.5} {:>10.1e} {:>10.0e}{verdict}",
        row.name,
        join(&row.shape, "×"),
        row.largest,
        row.error,
        row.tolerance
    );
}
