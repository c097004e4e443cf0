use std::collections::BTreeSet;

use serde::Serialize;

use super::VerifyError;
use super::folder::Folder;

/// Largest error that is accepted, relative to the tensor's (or matrix's) largest magnitude.
pub const TOLERANCE: f32 = 1e-4;

/// What the folder gives and nothing computes.
const INPUTS: [&str; 5] = ["map.points", "map.velocities", "latent.z", "loss.posterior", "loss.prior"];

/// How far a tensor is off.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// The tensor's name in the folder.
    pub name: String,
    /// Its shape.
    pub shape: Vec<usize>,
    /// Its largest magnitude.
    pub largest: f32,
    /// Largest error relative to `largest`; of covariances: to the largest entry of each matrix.
    pub error: f32,
}

impl Comparison {
    /// Whether the tensor is reproduced.
    #[must_use]
    pub fn agrees(&self) -> bool {
        self.error <= TOLERANCE
    }
}

/// Collects the comparisons and notices tensors that were forgotten.
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
        let mut error = 0.0_f32;
        for (found, expected) in found.chunks(block_len).zip(expected.chunks(block_len)) {
            let largest = largest(expected).max(f32::MIN_POSITIVE);
            for (f, e) in found.iter().zip(expected) {
                // NaN must not hide behind `max`, which would prefer the number.
                let off = (f - e).abs() / largest;
                error = if off.is_nan() { f32::INFINITY } else { error.max(off) };
            }
        }
        self.left.remove(name);
        self.rows.push(Comparison { name: name.to_owned(), shape, largest: largest(&expected), error });
        Ok(())
    }

    /// All comparisons.
    pub(super) fn finish(self) -> Result<Vec<Comparison>, VerifyError> {
        match self.left.first() {
            None => Ok(self.rows),
            Some(name) => Err(self.folder.malformed(format!("{name}: no such tensor is computed"))),
        }
    }
}

fn largest(values: &[f32]) -> f32 {
    values.iter().fold(0.0, |most, value| most.max(value.abs()))
}

#[cfg(test)]
mod tests {
    use super::largest;

    #[test]
    fn the_largest_magnitude_ignores_signs() {
        assert_eq!(largest(&[1.0, -3.0, 2.0]), 3.0);
        assert_eq!(largest(&[]), 0.0);
    }
}
