use std::ops::{Deref, DerefMut};

use bytemuck::Zeroable;
use wire::Row;

/// Floats in 64-byte lines: no vector load or store of an aligned row crosses a cache line.
#[derive(Clone, Default)]
pub(crate) struct Buffer {
    lines: Vec<Row>,
    len: usize,
}

impl Buffer {
    pub(crate) fn zeroed(len: usize) -> Self {
        let mut buffer = Self::default();
        buffer.reserve(len);
        buffer
    }

    /// Sets the length to at least `len`. New values are 0; a smaller `len` changes nothing.
    pub(crate) fn reserve(&mut self, len: usize) {
        if len > self.len {
            self.lines.resize(len.div_ceil(16), Row::zeroed());
            self.len = len;
        }
    }
}

impl Deref for Buffer {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        &bytemuck::cast_slice(&self.lines)[..self.len]
    }
}

impl DerefMut for Buffer {
    fn deref_mut(&mut self) -> &mut [f32] {
        &mut bytemuck::cast_slice_mut(&mut self.lines)[..self.len]
    }
}
