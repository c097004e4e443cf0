//! Recomputes the tensors of a golden folder.
//!
//! A folder holds `scene.json` (agents, states, constants), `weights.safetensors` and `tensors.safetensors` (what an
//! independent implementation computed). Sizes, widths, stems and options are those of the folder: the weights carry
//! their configuration. What is computed goes on into what follows, as on board; only the scene, the map's points, the
//! latent draws and the samples of the losses are taken from the folder.

mod compare;
mod folder;
mod graphs;
mod losses;
mod motion;

use std::path::Path;

use nn::{Decoder, EncodingFunction, MlpMemory, WeightsError};
use thiserror::Error;
use wire::TEMPORAL;

pub use compare::{Comparison, TOLERANCE};

use compare::Ledger;
use folder::Folder;

/// Why a folder can't be verified.
#[derive(Debug, Error)]
pub enum VerifyError {
    /// A file can't be read.
    #[error("{path}: {source}")]
    Unreadable {
        /// The file.
        path: String,
        /// What the system says.
        source: std::io::Error,
    },
    /// A file is not what its name says.
    #[error("{path}: {reason}")]
    Malformed {
        /// The file.
        path: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The weights can't be used.
    #[error("{path}: {source}")]
    Weights {
        /// The file.
        path: String,
        /// What is wrong with it.
        source: WeightsError,
    },
}

/// Compares every tensor of a golden folder, in the order in which they are computed.
///
/// # Errors
/// [`VerifyError`] where a file can't be read, is malformed, or the parts of the folder do not fit one another.
pub fn verify(folder: &Path) -> Result<Vec<Comparison>, VerifyError> {
    let folder = Folder::open(folder)?;
    let mut ledger = Ledger::new(&folder);
    let map = graphs::map(&folder, &mut ledger)?;
    let layers = graphs::Layers::new(&folder)?;
    let history = layers.run(&folder, graphs::Part::History, &map, &mut ledger)?;
    let future = layers.run(&folder, graphs::Part::Future, &map, &mut ledger)?;
    latent_mean(&folder, &history.temporal, &future.temporal, &mut ledger)?;
    let decoder = Decoder::new(&folder.weights).map_err(|e| folder.weights_error(e))?;
    let controls = motion::controls(&folder, &decoder, &history, &mut ledger)?;
    motion::bicycles(&folder, &controls, &mut ledger)?;
    losses::compare(&folder, &mut ledger)?;
    ledger.finish()
}

/// The posterior mean m of \[ṽ_h ‖ ṽ_f\].
fn latent_mean(
    folder: &Folder,
    history: &[[f32; TEMPORAL]],
    future: &[[f32; TEMPORAL]],
    ledger: &mut Ledger<'_>,
) -> Result<(), VerifyError> {
    let encoding = EncodingFunction::new(&folder.weights).map_err(|e| folder.weights_error(e))?;
    let mut summaries = vec![[0.0; 2 * TEMPORAL]; history.len()];
    for (row, (h, f)) in summaries.iter_mut().zip(history.iter().zip(future)) {
        row[..TEMPORAL].copy_from_slice(h);
        row[TEMPORAL..].copy_from_slice(f);
    }
    let mut means = vec![[0.0; wire::LATENT]; summaries.len()];
    encoding.means(&summaries, &mut MlpMemory::default(), &mut means);
    ledger.compare("latent.mean", means.as_flattened())
}
