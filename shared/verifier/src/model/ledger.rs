use std::collections::BTreeSet;

use super::folder::Folder;
use crate::{Comparison, VerifyError};

/// Largest accepted error, relative to the largest magnitude of the tensor or matrix.
const TOLERANCE: f64 = 1e-4;

/// The tensors that the folder provides and no code computes.
const INPUTS: [&str; 5] = ["map.points", "map.velocities", "latent.z", "loss.posterior", "loss.prior"];

/// Collects the comparisons and notices forgotten tensors.
pub(super) struct Ledger<'a> {
    folder: &'a Folder,
    rows: Vec<Comparison>,
    left: BTreeSet<String>,
}

impl<'a> Ledger<'a> {
    pub(super) fn new(folder: &'a Folder) -> Self {
        let left = folder.tensor_names().filter(|name| !INPUTS.contains(&name.as_str())).collect();
        Self { folder, rows: Vec::new(), left }
    }

    /// Compares a tensor as a whole.
    pub(super) fn compare(&mut self, name: &str, found: &[f32]) -> Result<(), VerifyError> {
        self.compare_blocks(name, found, found.len())
    }

    /// Compares blocks of `block_len` numbers, each against its own largest magnitude.
    pub(super) fn compare_blocks(
        &mut self,
        name: &str,
        found: &[f32],
        block_len: usize,
    ) -> Result<(), VerifyError> {
        let (shape, expected) = self.folder.tensor(name)?;
        if expected.len() != found.len() {
            return Err(self.folder.malformed(format!(
                "{name} has shape {shape:?}, {} numbers where the scene makes {}",
                expected.len(),
                found.len()
            )));
        }
        let block_len = block_len.max(1);
        let blocks = found.chunks(block_len).zip(expected.chunks(block_len));
        let errors = blocks.flat_map(|(found, expected)| {
            let largest = expected.iter().fold(f32::MIN_POSITIVE, |most, number| most.max(number.abs()));
            found.iter().zip(expected).map(move |(f, e)| f64::from((f - e).abs() / largest))
        });
        let numbers = expected.iter().map(|number| f64::from(*number));
        self.rows.push(Comparison::new(name.to_owned(), shape, numbers, errors, TOLERANCE));
        self.left.remove(name);
        Ok(())
    }

    pub(super) fn finish(self) -> Result<Vec<Comparison>, VerifyError> {
        match self.left.first() {
            None => Ok(self.rows),
            Some(name) => Err(self.folder.malformed(format!("{name}: no such tensor is computed"))),
        }
    }
}
