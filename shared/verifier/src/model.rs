//! Recomputes the tensors of a model.
//!
//! A folder contains `scene.json` (agents, states, constants), `weights.safetensors` and
//! `tensors.safetensors` (the results of an independent implementation). Sizes, widths, stems and options
//! come from the folder, because the weights contain their configuration. Each step starts from our own
//! results of the previous step, as on board. Only the scene, the map's points, the latent draws and the
//! samples of the losses come from the folder.

mod folder;
mod graphs;
mod ledger;
mod losses;
mod motion;

use std::path::Path;

use nn::{Decoder, EncodingFunction, MlpMemory};
use wire::TEMPORAL;

use super::{Comparison, VerifyError};
use folder::Folder;
use ledger::Ledger;

/// The files of a folder.
pub(super) const FILES: [&str; 3] = ["scene.json", "weights.safetensors", "tensors.safetensors"];

/// Compares every tensor of a folder, in the order of computation.
pub(super) fn verify(folder: &Path) -> Result<Vec<Comparison>, VerifyError> {
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
