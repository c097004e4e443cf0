use std::path::{Path, PathBuf};

use clap::Args;
use run::Exit;
use verifier::{Comparison, VerifyError};

use console::failure::Failure;
use console::say;

/// Arguments of `stgdat verify`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Folders with golden vectors (scene.json, weights.safetensors and tensors.safetensors, or filters,
    /// assignment, metrics and unit). If several are given, folders without vectors are skipped
    #[arg(required = true, value_name = "DIR")]
    folders: Vec<PathBuf>,
}

/// Recomputes the golden vectors of folders on this machine and reports mismatches.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let (mut off_count, mut verified_count) = (0, 0);
    for folder in &arguments.folders {
        let rows = match verifier::verify(folder) {
            // A shell's `golden/*` also matches the README beside the folders.
            Err(error) if arguments.folders.len() > 1 && holds_no_vectors(folder, &error) => {
                tracing::info!("{}: skipped, no golden vectors", folder.display());
                continue;
            }
            Err(_) if folder.is_file() => {
                let of = folder.display();
                return Err(Failure::data(format!(
                    "{of}: not a folder with golden vectors; for weights, `stgdat card {of}` prints the fingerprint"
                )));
            }
            rows => rows.map_err(Failure::data)?,
        };
        verified_count += 1;
        say!("{} ({} kernels)", folder.display(), nn::kernels::active().name());
        let width = rows.iter().map(|row| row.name.len()).max().unwrap_or(0).max(30);
        say!("  {:<width$} {:>20} {:>12} {:>10} {:>10}", "vector", "shape", "largest", "error", "tolerance");
        rows.iter().for_each(|row| print(row, width));
        let off = rows.iter().filter(|row| !row.agrees()).count();
        say!("  {} of {} vectors agree\n", rows.len() - off, rows.len());
        off_count += off;
    }
    if verified_count == 0 {
        return Err(Failure::data("none of the folders has golden vectors"));
    }
    match off_count {
        0 => Ok(Exit::Done),
        1 => Err(Failure::Failed("1 vector is off by more than its tolerance".to_owned())),
        _ => Err(Failure::Failed(format!("{off_count} vectors are off by more than their tolerance"))),
    }
}

/// Whether the path is an existing file, or a folder without golden vectors.
fn holds_no_vectors(path: &Path, error: &VerifyError) -> bool {
    path.is_file() || matches!(error, VerifyError::NoVectors { .. })
}

fn print(row: &Comparison, width: usize) {
    let join =
        |numbers: &[usize], by: &str| numbers.iter().map(ToString::to_string).collect::<Vec<_>>().join(by);
    let verdict = if row.agrees() { String::new() } else { format!("  off at [{}]", join(&row.worst, ", ")) };
    say!(
        "  {:<width$} {:>20} {:>12.5} {:>10.1e} {:>10.0e}{verdict}",
        row.name,
        join(&row.shape, "×"),
        row.largest,
        row.error,
        row.tolerance
    );
}
