//! Map files: safetensors with `map.density` \[rows, cols\], `map.velocity` \[2, rows, cols\] m/s and `map.origin_m` \[2\], f32.

use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use safetensors::tensor::{Dtype, SafeTensorError, TensorView};
use safetensors::{SafeTensors, serialize};
use thiserror::Error;

use super::{CELLS_MAX, ContextMap};

const DENSITY: &str = "map.density";
const VELOCITY: &str = "map.velocity";
const ORIGIN: &str = "map.origin_m";
/// Three numbers a cell and a generous header.
const BYTES_MAX: u64 = CELLS_MAX as u64 * 12 + (1 << 20);

/// Why a map could not be read or written.
#[derive(Debug, Error)]
pub enum MapFileError {
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Its reason.
        source: io::Error,
    },
    /// The file is no safetensors file, or lacks a tensor.
    #[error("{}: not a map: {source}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: SafeTensorError,
    },
    /// The file's tensors make no map.
    #[error("{}: not a map: {reason}", path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// What is wrong with them.
        reason: String,
    },
}

impl ContextMap {
    /// Writes the map to a file, all of it or nothing: a reader never meets half a map.
    ///
    /// # Errors
    /// [`MapFileError::Io`] where the folder can't be written.
    pub fn save(&self, path: &Path) -> Result<(), MapFileError> {
        let bytes = self.to_bytes().map_err(|source| MapFileError::Format { path: path.into(), source })?;
        let mut partial = path.as_os_str().to_owned();
        partial.push(".partial");
        let partial = PathBuf::from(partial);
        let written = File::create(&partial)
            .and_then(|mut file| file.write_all(&bytes).and_then(|()| file.sync_all()))
            .and_then(|()| std::fs::rename(&partial, path));
        written.map_err(|source| {
            // What is left of a failed attempt helps nobody; the first error is the one to tell.
            let _ = std::fs::remove_file(&partial);
            MapFileError::Io { path: path.into(), source }
        })
    }

    /// Reads a map from a file.
    ///
    /// # Errors
    /// [`MapFileError`] where the file can't be read, is no map, or holds numbers that no map has.
    pub fn load(path: &Path) -> Result<Self, MapFileError> {
        let io = |source| MapFileError::Io { path: path.into(), source };
        let len = std::fs::metadata(path).map_err(io)?.len();
        if len > BYTES_MAX {
            let reason = format!("{len} bytes, more than the largest map has");
            return Err(MapFileError::Content { path: path.into(), reason });
        }
        Self::from_bytes(&std::fs::read(path).map_err(io)?, path)
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

    fn from_bytes(bytes: &[u8], path: &Path) -> Result<Self, MapFileError> {
        let format = |source| MapFileError::Format { path: path.into(), source };
        let content = |reason| MapFileError::Content { path: path.into(), reason };
        let tensors = SafeTensors::deserialize(bytes).map_err(format)?;
        let density = tensors.tensor(DENSITY).map_err(format)?;
        let [rows, cols] = density.shape()[..] else {
            return Err(content(format!("{DENSITY} has shape {:?}, expected [rows, cols]", density.shape())));
        };
        if rows.checked_mul(cols).is_none_or(|cells| cells > CELLS_MAX) {
            return Err(content(format!("{rows} × {cols} cells, at most {CELLS_MAX} allowed")));
        }
        let density = numbers(DENSITY, &density, &[rows, cols]).map_err(content)?;
        let velocity = tensors.tensor(VELOCITY).map_err(format)?;
        let velocity = numbers(VELOCITY, &velocity, &[2, rows, cols]).map_err(content)?;
        let origin = tensors.tensor(ORIGIN).map_err(format)?;
        let origin = numbers(ORIGIN, &origin, &[2]).map_err(content)?;
        if let Some(negative) = density.iter().find(|b| **b < 0.0) {
            return Err(content(format!("{DENSITY} holds {negative}, a share can't be negative")));
        }
        let (vx, vy) = velocity.split_at(rows * cols);
        let pairs = vx.iter().zip(vy).map(|(x, y)| [*x, *y]);
        Ok(Self::new([origin[0], origin[1]], cols, density.into_iter(), pairs))
    }
}

fn numbers(name: &str, view: &TensorView<'_>, shape: &[usize]) -> Result<Vec<f32>, String> {
    if view.dtype() != Dtype::F32 || view.shape() != shape {
        return Err(format!("{name} is {:?} {:?}, expected F32 {shape:?}", view.dtype(), view.shape()));
    }
    let (words, _) = view.data().as_chunks::<4>();
    let numbers: Vec<f32> = words.iter().map(|word| f32::from_le_bytes(*word)).collect();
    match numbers.iter().position(|x| !x.is_finite()) {
        Some(at) => Err(format!("{name}[{at}] is {}", numbers[at])),
        None => Ok(numbers),
    }
}
