//! Map files: safetensors with `map.density` \[rows, cols\], `map.velocity` \[2, rows, cols\] m/s and
//! `map.origin_m` \[2\], f32.

use std::path::Path;

use safetensors::tensor::{Dtype, SafeTensorError, TensorView};
use safetensors::{SafeTensors, serialize};

use super::{CELLS_MAX, ContextMap};
use crate::FileError;
use crate::file::{Target, finite_numbers};

const DENSITY: &str = "map.density";
const VELOCITY: &str = "map.velocity";
const ORIGIN: &str = "map.origin_m";
/// Three numbers per cell and a generous header.
const BYTES_MAX: u64 = CELLS_MAX as u64 * 12 + (1 << 20);

impl ContextMap {
    /// Writes the map to a file atomically: a reader never sees half a map.
    ///
    /// # Errors
    /// [`FileError::Io`] if the folder cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), FileError> {
        let target = target(path);
        let bytes = self.to_bytes().map_err(|source| target.format(source))?;
        target.write(&bytes)
    }

    /// Reads a map from a file.
    ///
    /// # Errors
    /// [`FileError`] if the file cannot be read, is not a map, or contains invalid numbers.
    pub fn load(path: &Path) -> Result<Self, FileError> {
        let target = target(path);
        Self::from_bytes(&target.read(BYTES_MAX)?, target)
    }

    fn to_bytes(&self) -> Result<Vec<u8>, SafeTensorError> {
        let bytes =
            |numbers: &mut dyn Iterator<Item = f32>| numbers.flat_map(f32::to_le_bytes).collect::<Vec<u8>>();
        let density = bytes(&mut self.density());
        let along = |axis: usize| self.velocity_mps().map(move |v| v[axis]);
        let velocity = bytes(&mut along(0).chain(along(1)));
        let origin = bytes(&mut self.origin_m.into_iter());
        let (rows, cols) = (self.rows, self.cols);
        serialize(
            [
                (DENSITY, TensorView::new(Dtype::F32, vec![rows, cols], &density)?),
                (VELOCITY, TensorView::new(Dtype::F32, vec![2, rows, cols], &velocity)?),
                (ORIGIN, TensorView::new(Dtype::F32, vec![2], &origin)?),
            ],
            None,
        )
    }

    fn from_bytes(bytes: &[u8], target: Target<'_>) -> Result<Self, FileError> {
        let (format, content) = (|source| target.format(source), |reason| target.content(reason));
        let tensors = SafeTensors::deserialize(bytes).map_err(format)?;
        let density = tensors.tensor(DENSITY).map_err(format)?;
        let [rows, cols] = density.shape()[..] else {
            return Err(content(format!("{DENSITY} has shape {:?}, expected [rows, cols]", density.shape())));
        };
        if rows.checked_mul(cols).is_none_or(|cells| cells > CELLS_MAX) {
            return Err(content(format!("{rows} × {cols} cells, at most {CELLS_MAX} allowed")));
        }
        let density = finite_numbers(DENSITY, &density, &[rows, cols]).map_err(content)?;
        let velocity = tensors.tensor(VELOCITY).map_err(format)?;
        let velocity = finite_numbers(VELOCITY, &velocity, &[2, rows, cols]).map_err(content)?;
        let origin = tensors.tensor(ORIGIN).map_err(format)?;
        let origin = finite_numbers(ORIGIN, &origin, &[2]).map_err(content)?;
        if let Some(negative) = density.iter().find(|b| **b < 0.0) {
            return Err(content(format!("{DENSITY} holds {negative}, a share can't be negative")));
        }
        let (vx, vy) = velocity.split_at(rows * cols);
        let pairs = vx.iter().zip(vy).map(|(x, y)| [*x, *y]);
        Ok(Self::new([origin[0], origin[1]], cols, density.into_iter(), pairs))
    }
}

const fn target(path: &Path) -> Target<'_> {
    Target { path, what: "map" }
}
