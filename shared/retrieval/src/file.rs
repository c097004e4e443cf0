//! Memory files: N entries, oldest first, as safetensors.
//!
//! | tensor | type and shape | content |
//! |---|---|---|
//! | `memory.gait` | u8 \[N\] | kind of motion: 0 bicycle, 1 displacement |
//! | `memory.moment` | f32 \[N, 6\] | keys, see below |
//! | `memory.driven` | u8 \[N\] | steps taken since |
//! | `memory.departure` | f32 \[N, steps, 2\] | residuals; NaN if unknown |
//! | `memory.skill` | f32 \[2 kinds, steps, 2, 2\] | sums of the shrinkage |
//! | `memory.step_ns` | i64 \[1\] | length of a step |
//!
//! A key has x, y, heading, speed, acceleration and turn rate for a bicycle; x, y and velocity (x, y) for
//! displacements. The metadata key `weights` contains the SHA-256 of the weights that computed the forecasts.
//! The tensors have the names of the file's first version, so that every version reads all files.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use kinematics::MotionKind;
use safetensors::tensor::{Dtype, SafeTensorError, TensorView};
use safetensors::{SafeTensors, serialize};
use scene::FileError;
use scene::file::{Target, finite_numbers, numbers};
use thiserror::Error;
use wire::{HORIZON_MAX, POSITION_MAX_M};

use crate::expectation::Shrinkage;
use crate::key::COMPONENTS;
use crate::memory::{ENTRIES_MAX, Value};
use crate::residuals::RESIDUAL_MAX;
use crate::{Key, Residuals, RetrievalMemory};

const KIND: &str = "memory.gait";
const KEY: &str = "memory.moment";
const TAKEN: &str = "memory.driven";
const RESIDUAL: &str = "memory.departure";
const SHRINKAGE: &str = "memory.skill";
const STEP_NS: &str = "memory.step_ns";
const WEIGHTS: &str = "weights";
/// Size of the largest memory with a generous header.
const BYTES_MAX: u64 = (ENTRIES_MAX * (2 + 4 * (COMPONENTS + 2 * HORIZON_MAX)) + (1 << 20)) as u64;

/// Why a memory file could not be read or written.
#[derive(Debug, Error)]
pub enum MemoryError {
    /// The file can't be read or written, or is not a memory file.
    #[error(transparent)]
    File(#[from] FileError),
    /// The memory is for the forecasts of other weights.
    #[error("{}: a retrieval memory of the weights {found}, not of {expected}", path.display())]
    OtherWeights {
        /// The file.
        path: PathBuf,
        /// Start of their SHA-256.
        found: String,
        /// Start of the SHA-256 of the weights in use.
        expected: String,
    },
}

impl RetrievalMemory {
    /// Writes the entries to a file, as a whole or not at all. The entries are for forecasts of these
    /// weights.
    ///
    /// # Errors
    /// [`MemoryError::File`] if the folder can't be written.
    pub fn save(&self, path: &Path, weights_sha256: &str) -> Result<(), MemoryError> {
        let target = target(path);
        let bytes = self.to_bytes(weights_sha256).map_err(|source| target.format(source))?;
        Ok(target.write(&bytes)?)
    }

    /// Reads the entries of earlier sessions. They must be for forecasts of these weights, with this number
    /// and length of steps.
    ///
    /// # Errors
    /// [`MemoryError`] if the file can't be read, is not a memory file, belongs to other weights, or contains
    /// impossible numbers.
    pub fn load(
        path: &Path,
        weights_sha256: &str,
        (horizon_len, step_ns): (usize, u64),
    ) -> Result<Self, MemoryError> {
        let target = target(path);
        let memory = Self::from_bytes(&target.read(BYTES_MAX)?, weights_sha256, target)?;
        if (memory.horizon_len, memory.step_ns) == (horizon_len, step_ns.cast_signed()) {
            return Ok(memory);
        }
        let (found_count, found_ns) = (memory.horizon_len, memory.step_ns);
        let expected = format!("expected {horizon_len} of {step_ns} ns");
        Err(target
            .content(format!("its forecasts have {found_count} steps of {found_ns} ns, {expected}"))
            .into())
    }

    fn to_bytes(&self, weights_sha256: &str) -> Result<Vec<u8>, SafeTensorError> {
        // Entries that no bucket reaches any more are never retrieved, so they are not written.
        let kept: BTreeSet<usize> = self.index.buckets().flat_map(|bucket| self.bucket(bucket)).collect();
        let keys = || kept.iter().filter_map(|place| self.key(*place));
        let values = || kept.iter().map(|place| &self.values[*place]);
        let (len, step_count) = (kept.len(), self.horizon_len);
        let bytes =
            |numbers: &mut dyn Iterator<Item = f32>| numbers.flat_map(f32::to_le_bytes).collect::<Vec<u8>>();
        let residuals = |value: &Value| value.residuals.steps()[..step_count].as_flattened().to_vec();
        let kind: Vec<u8> = keys().map(|key| key.kind() as u8).collect();
        let key = bytes(&mut keys().flat_map(Key::components));
        let taken: Vec<u8> = values().map(|value| value.taken_count as u8).collect();
        let residual = bytes(&mut values().flat_map(residuals));
        let shrinkage = bytes(&mut self.shrinkage.iter().flat_map(|shrinkage| shrinkage.numbers(step_count)));
        let step = self.step_ns.to_le_bytes();
        serialize(
            [
                (KIND, TensorView::new(Dtype::U8, vec![len], &kind)?),
                (KEY, TensorView::new(Dtype::F32, vec![len, COMPONENTS], &key)?),
                (TAKEN, TensorView::new(Dtype::U8, vec![len], &taken)?),
                (RESIDUAL, TensorView::new(Dtype::F32, vec![len, step_count, 2], &residual)?),
                (SHRINKAGE, TensorView::new(Dtype::F32, vec![2, step_count, 2, 2], &shrinkage)?),
                (STEP_NS, TensorView::new(Dtype::I64, vec![1], &step)?),
            ],
            Some([(WEIGHTS.to_owned(), weights_sha256.to_owned())].into()),
        )
    }

    fn from_bytes(bytes: &[u8], weights_sha256: &str, target: Target<'_>) -> Result<Self, MemoryError> {
        let (format, content) = (|source| target.format(source), |reason| target.content(reason));
        let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(format)?;
        let tensors = SafeTensors::deserialize(bytes).map_err(format)?;
        let weights = metadata.metadata().as_ref().and_then(|metadata| metadata.get(WEIGHTS));
        check_weights(weights.map(String::as_str), weights_sha256, target)?;
        let tensor = |name| tensors.tensor(name).map_err(format);
        let step_ns = step_ns(&tensor(STEP_NS)?).map_err(content)?;
        let residual = tensor(RESIDUAL)?;
        let [len, step_count, 2] = residual.shape()[..] else {
            let shape = residual.shape();
            return Err(
                content(format!("{RESIDUAL} has shape {shape:?}, expected [entries, steps, 2]")).into()
            );
        };
        if len > ENTRIES_MAX || !(1..=HORIZON_MAX).contains(&step_count) {
            let most = format!("at most {ENTRIES_MAX} of 1 to {HORIZON_MAX} allowed");
            return Err(content(format!("{len} entries of {step_count} steps, {most}")).into());
        }
        let kind = small(KIND, &tensor(KIND)?, len, 1).map_err(content)?;
        let taken = small(TAKEN, &tensor(TAKEN)?, len, step_count as u8).map_err(content)?;
        let key = finite_numbers(KEY, &tensor(KEY)?, &[len, COMPONENTS]).map_err(content)?;
        let residual = numbers(RESIDUAL, &residual, &[len, step_count, 2]).map_err(content)?;
        let shrinkage =
            finite_numbers(SHRINKAGE, &tensor(SHRINKAGE)?, &[2, step_count, 2, 2]).map_err(content)?;

        // The order is Σ predicted · actual, Σ predicted².
        if let Some(negative) = shrinkage.iter().skip(1).step_by(2).find(|square| **square < 0.0) {
            let why = format!("{SHRINKAGE} holds {negative}, a sum of squares can't be negative");
            return Err(content(why).into());
        }

        let mut memory = Self::new(step_count, step_ns);
        for (shrinkage, numbers) in memory.shrinkage.iter_mut().zip(shrinkage.chunks_exact(4 * step_count)) {
            *shrinkage = Shrinkage::of_numbers(numbers);
        }
        let entries = key.as_chunks::<COMPONENTS>().0.iter().zip(residual.chunks_exact(2 * step_count));
        for (number, (components, residual)) in entries.enumerate() {
            let kind = if kind[number] == 0 { MotionKind::Bicycle } else { MotionKind::Displacement };
            if let Some(beyond) = components[..2].iter().find(|x| x.abs() > POSITION_MAX_M) {
                let why = format!("{KEY}[{number}] is at {beyond} m, outside the world");
                return Err(content(why).into());
            }
            let most = RESIDUAL_MAX[kind as usize];
            let impossible =
                |(place, x): (usize, &f32)| (x.is_infinite() || x.abs() > most[place % 2]).then_some(*x);
            if let Some(residual) = residual.iter().enumerate().find_map(impossible) {
                return Err(content(format!("{RESIDUAL}[{number}] holds {residual}")).into());
            }
            let (taken_count, residuals) = (usize::from(taken[number]), Residuals::of_numbers(residual));
            let value = Value { agent: 0, session: 0, taken_count, residuals };
            memory.push(Key::of_components(kind, components), value);
        }
        memory.end_session();
        Ok(memory)
    }
}

/// Refuses a file for other weights, or without the fingerprint of its weights.
fn check_weights(weights: Option<&str>, weights_sha256: &str, target: Target<'_>) -> Result<(), MemoryError> {
    let Some(weights) = weights else {
        return Err(target.content(format!("its metadata lack `{WEIGHTS}`")).into());
    };
    if weights == weights_sha256 {
        return Ok(());
    }
    let [found, expected] =
        [weights, weights_sha256].map(|sha256| sha256.chars().take(12).collect::<String>());
    Err(MemoryError::OtherWeights { path: target.path.into(), found, expected })
}

/// The single number of a tensor, checked to be a valid step length.
fn step_ns(view: &TensorView<'_>) -> Result<u64, String> {
    let (Dtype::I64, Ok(bytes)) = (view.dtype(), view.data().try_into()) else {
        return Err(format!("{STEP_NS} is {:?} {:?}, expected I64 [1]", view.dtype(), view.shape()));
    };
    let step_ns = i64::from_le_bytes(bytes);
    if step_ns < 1 {
        return Err(format!("{STEP_NS} is {step_ns}, expected 1 or more"));
    }
    Ok(step_ns.cast_unsigned())
}

/// Bytes with a maximum value.
fn small(name: &str, view: &TensorView<'_>, len: usize, most: u8) -> Result<Vec<u8>, String> {
    if view.dtype() != Dtype::U8 || view.shape() != [len] {
        return Err(format!("{name} is {:?} {:?}, expected U8 [{len}]", view.dtype(), view.shape()));
    }
    match view.data().iter().position(|x| *x > most) {
        Some(at) => Err(format!("{name}[{at}] is {}, at most {most} allowed", view.data()[at])),
        None => Ok(view.data().to_vec()),
    }
}

const fn target(path: &Path) -> Target<'_> {
    Target { path, what: "retrieval memory" }
}
