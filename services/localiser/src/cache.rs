use wire::AGENTS_MAX;

/// Cached patches per track. A history of 2.8 s at 12.5 Hz has 36 stamps; the rest allows for uneven ticks.
const STAMPS_MAX: usize = 64;

/// The patches of the newest stamps of each track.
///
/// The cache holds [`AGENTS_MAX`] tracks. When it is full, a new track replaces the least recently used one.
pub(crate) struct PatchCache {
    patch_len: usize,
    entries: Vec<Entry>,
    /// \[entry, stamp, patch\]. Parts that were never written use no physical memory.
    patches: Vec<f32>,
}

#[derive(Clone, Copy)]
struct Entry {
    id: u64,
    used_ns: i64,
    stamps_ns: [i64; STAMPS_MAX],
    /// Number of cached stamps.
    len: usize,
}

/// Index of a track's entry.
#[derive(Clone, Copy)]
pub(crate) struct Slot(usize);

impl PatchCache {
    pub(crate) fn new(patch_len: usize) -> Self {
        Self {
            patch_len,
            entries: Vec::with_capacity(AGENTS_MAX),
            patches: vec![0.0; AGENTS_MAX * STAMPS_MAX * patch_len],
        }
    }

    /// Drops all patches.
    pub(crate) fn clear(&mut self) {
        self.entries.clear();
    }

    /// Marks the tracks as used at this stamp, which protects their slots from eviction until a later stamp.
    pub(crate) fn touch(&mut self, ids: impl Iterator<Item = u64>, now_ns: i64) {
        for id in ids {
            if let Some(entry) = self.entries.iter_mut().find(|entry| entry.id == id) {
                entry.used_ns = now_ns;
            }
        }
    }

    /// The slot of a track; a new slot if the track has none.
    pub(crate) fn claim(&mut self, id: u64, now_ns: i64) -> Slot {
        let slot = match self.entries.iter().position(|entry| entry.id == id) {
            Some(slot) => slot,
            None => self.free(id),
        };
        self.entries[slot].used_ns = now_ns;
        Slot(slot)
    }

    /// An empty entry for a new track.
    fn free(&mut self, id: u64) -> usize {
        let fresh = Entry { id, used_ns: i64::MIN, stamps_ns: [0; STAMPS_MAX], len: 0 };
        if self.entries.len() < AGENTS_MAX {
            self.entries.push(fresh);
            return self.entries.len() - 1;
        }
        let oldest = (0..AGENTS_MAX).min_by_key(|slot| self.entries[*slot].used_ns).unwrap_or(0);
        self.entries[oldest] = fresh;
        oldest
    }

    /// The patch of a track at a stamp; `None` if it is not cached.
    pub(crate) fn get(&self, slot: Slot, stamp_ns: i64) -> Option<&[f32]> {
        let entry = &self.entries[slot.0];
        let held = &entry.stamps_ns[..entry.len];
        let place = held.iter().position(|held| *held == stamp_ns)?;
        let start = (slot.0 * STAMPS_MAX + place) * self.patch_len;
        Some(&self.patches[start..start + self.patch_len])
    }

    /// Stores the patch of a track at a stamp. If the slot is full, the patch replaces the one with the
    /// oldest stamp.
    pub(crate) fn put(&mut self, slot: Slot, stamp_ns: i64, patch: &[f32]) {
        let entry = &mut self.entries[slot.0];
        let place = if entry.len < STAMPS_MAX {
            entry.len += 1;
            entry.len - 1
        } else {
            (0..STAMPS_MAX).min_by_key(|place| entry.stamps_ns[*place]).unwrap_or(0)
        };
        entry.stamps_ns[place] = stamp_ns;
        let start = (slot.0 * STAMPS_MAX + place) * self.patch_len;
        self.patches[start..start + self.patch_len].copy_from_slice(patch);
    }
}
