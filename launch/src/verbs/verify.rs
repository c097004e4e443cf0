use std::path::PathBuf;

use clap::Args;
use config::Exit;
use evaluator::{Comparison, TOLERANCE};

use crate::failure::Failure;

/// Arguments of `stgdat verify`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Folders with scene.json, weights.safetensors and tensors.safetensors
    #[arg(required = true, value_name = "DIR")]
    folders: Vec<PathBuf>,
}

/// Recomputes the tensors of golden folders on this machine and tells which ones are off.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let mut off_len = 0;
    for folder in &arguments.folders {
        let rows = evaluator::verify(folder).map_err(Failure::data)?;
        println!("{} ({} kernels)", folder.display(), nn::kernels::active().name());
        println!("  {:<30} {:>20} {:>12} {:>10}", "tensor", "shape", "largest", "error");
        rows.iter().for_each(print);
        let off = rows.iter().filter(|row| !row.agrees()).count();
        println!("  {} of {} tensors agree to {TOLERANCE:e}\n", rows.len() - off, rows.len());
        off_len += off;
    }
    match off_len {
        0 => Ok(Exit::Done),
        _ => Err(Failure::Failed(format!("{off_len} tensors are off by more than {TOLERANCE:e}"))),
    }
}

fn print(row: &Comparison) {
    let shape: Vec<_> = row.shape.iter().map(ToString::to_string).collect();
    let verdict = if row.agrees() { "" } else { "  off" };
    let (name, shape) = (&row.name, shape.join("×"));
    println!("  {name:<30} {shape:>20} {:>12.5} {:>10.1e}{verdict}", row.largest, row.error);
}
