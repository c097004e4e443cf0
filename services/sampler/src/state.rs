//! The learned state in a file that outlives the run: retrieval memory and evidence.
//!
//! The file is a [journal](crate::journal) that belongs to weights instead of a run. The launcher copies the journal
//! of the run from shared memory, so saving costs the sampler nothing.

use std::mem::size_of;
use std::path::Path;
use std::time::Duration;

use nn::Weights;
use ports::{KeptMemory, OUTPUT_TARGET};
use run::Run;
use scene::file::Target;

use crate::journal::{BYTES_MAX, Identity, Journal, words};
use crate::memory::KEPT;
use crate::{Options, STAGE, Sampler};

/// Most attempts to copy a journal that the sampler is changing.
const ATTEMPTS_MAX: usize = 5;
/// Pause between two attempts: a quarter of a tick.
const PAUSE: Duration = Duration::from_millis(20);

/// Number of the weights in the [`Identity`] of a saved state.
fn number_of(weights_sha256: &str) -> u64 {
    let start = weights_sha256.get(..16).unwrap_or_default();
    u64::from_str_radix(start, 16).unwrap_or_default()
}

/// Returns the learned state of a running sampler as the bytes of a file; `None` if there is none.
///
/// # Errors
/// The reason why the state can't be read.
pub fn snapshot(run: &Run, weights_sha256: &str) -> Result<Option<Vec<u8>>, String> {
    let path = KeptMemory::path_of(run, KEPT);
    let mut why = "damaged";
    for _ in 0..ATTEMPTS_MAX {
        let bytes = match std::fs::read(&path) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(format!("{}: {error}", path.display())),
        };
        match Journal::belonging_to_any(words(&bytes)) {
            Ok((mut journal, identity)) => match journal.resume(None) {
                Ok(Some(_)) => {
                    return Ok(Some(journal.into_bytes_for(identity.with_owner(number_of(weights_sha256)))));
                }
                Ok(None) => return Ok(None),
                Err(reason) => why = reason,
            },
            Err(reason) => why = reason,
        }
        std::thread::sleep(PAUSE);
    }
    Err(format!("{}: {why}", path.display()))
}

/// Starts a sampler from the state that the run's options name, if the file exists. A file that can't be used is
/// logged and ignored. Returns whether it was used.
pub(crate) fn load(run: &Run, sampler: &mut Sampler) -> bool {
    let Ok(Options { state: Some(path), .. }) = STAGE.options(run) else { return false };
    if !path.exists() {
        return false;
    }
    match read(run, sampler, &path) {
        Ok(()) => {
            let entries = sampler.memory().map_or(0, retrieval::RetrievalMemory::entry_count);
            let matured = sampler.evidence().map_or(0.0, evidence::Evidence::matured_count);
            tracing::info!(
                target: OUTPUT_TARGET,
                "started with {entries} entries of the retrieval memory and the evidence of {matured:.0} forecasts \
                 from {}",
                path.display()
            );
            true
        }
        Err(why) => {
            tracing::warn!("{}: the saved state is {why}, so it is ignored", path.display());
            false
        }
    }
}

fn read(run: &Run, sampler: &mut Sampler, path: &Path) -> Result<(), String> {
    let weights = Weights::open_or_onboard(run.weights.as_deref()).map_err(|error| error.to_string())?;
    let owner = number_of(weights.sha256());
    let identity = Identity::of(owner, sampler.options()).ok_or("of a sampler that learns")?;
    let bytes =
        Target { path, what: "saved state" }.read(BYTES_MAX as u64).map_err(|error| error.to_string())?;
    if bytes.len() < size_of::<u64>() {
        return Err("damaged".to_owned());
    }
    let resumed = Journal::over(words(&bytes), identity).resume(None).map_err(|why| match why {
        "of another run" => "of other weights",
        why => why,
    })?;
    sampler.start_from(resumed.ok_or("empty")?).map_err(|why| format!("damaged: {why}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_owner_of_a_state_is_the_start_of_the_sha_256_of_the_weights() {
        assert_eq!(number_of("ae48321c623f0011ffff"), 0xae48_321c_623f_0011);
        assert_eq!(number_of(""), 0);
    }
}
