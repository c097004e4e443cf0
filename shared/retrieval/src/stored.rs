//! The memory as flat records, for storage that outlives the process and is updated entry by entry.

use bytemuck::{Pod, Zeroable};
use kinematics::MotionKind;
use wire::{HORIZON_MAX, POSITION_MAX_M};

use crate::expectation::Shrinkage;
use crate::key::COMPONENTS;
use crate::memory::{ENTRIES_MAX, Value};
use crate::residuals::RESIDUAL_MAX;
use crate::{Key, Residuals, RetrievalMemory};

/// An entry.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub struct StoredEntry {
    /// Number, counted from the first entry.
    pub number: u64,
    agent: u64,
    session: u64,
    key: [f32; COMPONENTS],
    residuals: [[f32; 2]; HORIZON_MAX],
    kind: u32,
    taken_count: u32,
}

/// The state besides the entries. Agents whose paths are filling entries are left out.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub struct StoredState {
    /// Number of the oldest entry.
    pub oldest: u64,
    /// Number of the next entry.
    pub next: u64,
    session: u64,
    now_ns: i64,
    step_ns: i64,
    horizon_len: u64,
    /// Sums of the shrinkage, by kind of motion.
    shrinkage: [[[[f32; 2]; 2]; HORIZON_MAX]; 2],
}

impl RetrievalMemory {
    /// Maximum number of entries at a time.
    pub const ENTRIES_MAX: usize = ENTRIES_MAX;

    /// The state without the entries.
    pub fn state(&self) -> StoredState {
        let mut shrinkage = [[[[0.0; 2]; 2]; HORIZON_MAX]; 2];
        for (own, stored) in self.shrinkage.iter().zip(&mut shrinkage) {
            let stored = stored.as_flattened_mut().as_flattened_mut();
            stored.iter_mut().zip(own.numbers(HORIZON_MAX)).for_each(|(stored, own)| *stored = own);
        }
        StoredState {
            oldest: self.oldest,
            next: self.oldest + self.entry_count() as u64,
            session: self.session,
            now_ns: self.now_ns,
            step_ns: self.step_ns,
            horizon_len: self.horizon_len as u64,
            shrinkage,
        }
    }

    /// An entry by its number; `None` if it is no longer stored.
    #[must_use]
    pub fn entry(&self, number: u64) -> Option<StoredEntry> {
        let place = usize::try_from(number.checked_sub(self.oldest)?).ok()?;
        let (key, value) = (self.key(place)?, self.values.get(place)?);
        Some(StoredEntry {
            number,
            agent: value.agent,
            session: value.session,
            key: key.components(),
            residuals: *value.residuals.steps(),
            kind: key.kind() as u32,
            taken_count: value.taken_count as u32,
        })
    }

    /// Numbers of the entries that were stored or filled at the newest time. A number may occur twice.
    pub fn changed(&self) -> impl Iterator<Item = u64> {
        self.changed.iter().copied()
    }

    /// A memory with this state. Incomplete paths keep the steps that they have.
    ///
    /// # Errors
    /// A description of the first impossible value; none of the state can be used then.
    pub fn of_stored(
        state: &StoredState,
        entries: impl Iterator<Item = StoredEntry>,
    ) -> Result<Self, &'static str> {
        let StoredState { oldest, next, step_ns, horizon_len, .. } = *state;
        let len = next.checked_sub(oldest).and_then(|len| usize::try_from(len).ok());
        let (Some(len), Ok(horizon_len)) = (len, usize::try_from(horizon_len)) else { return Err("sizes") };
        if len > ENTRIES_MAX || !(1..=HORIZON_MAX).contains(&horizon_len) || step_ns < 1 {
            return Err("sizes");
        }
        let sums = state.shrinkage.as_flattened().as_flattened().iter();
        if sums.clone().any(|[product, square]| !product.is_finite() || !square.is_finite() || *square < 0.0)
        {
            return Err("shrinkage");
        }
        let mut memory = Self::new(horizon_len, step_ns.unsigned_abs());
        for (own, stored) in memory.shrinkage.iter_mut().zip(&state.shrinkage) {
            *own = Shrinkage::of_numbers(stored.as_flattened().as_flattened());
        }
        (memory.oldest, memory.session, memory.now_ns) = (oldest, state.session, state.now_ns);
        for (place, entry) in entries.take(len).enumerate() {
            if entry.number != oldest + place as u64 {
                return Err("order of the entries");
            }
            memory.push(entry.key()?, entry.value(horizon_len)?);
        }
        if memory.entry_count() == len { Ok(memory) } else { Err("number of the entries") }
    }
}

impl StoredEntry {
    fn kind(&self) -> Result<MotionKind, &'static str> {
        [MotionKind::Bicycle, MotionKind::Displacement]
            .into_iter()
            .find(|kind| *kind as u32 == self.kind)
            .ok_or("kind of motion")
    }

    fn key(&self) -> Result<Key, &'static str> {
        let is_finite = self.key.iter().all(|component| component.is_finite());
        if !is_finite || self.key[..2].iter().any(|x| x.abs() > POSITION_MAX_M) {
            return Err("key");
        }
        Ok(Key::of_components(self.kind()?, &self.key))
    }

    fn value(&self, horizon_len: usize) -> Result<Value, &'static str> {
        let most = RESIDUAL_MAX[self.kind()? as usize];
        let is_possible = |(place, x): (usize, &f32)| x.is_nan() || x.abs() <= most[place % 2];
        let taken_count = self.taken_count as usize;
        if taken_count > horizon_len || !self.residuals.as_flattened().iter().enumerate().all(is_possible) {
            return Err("residuals");
        }
        let residuals = Residuals::of_numbers(self.residuals.as_flattened());
        Ok(Value { agent: self.agent, session: self.session, taken_count, residuals })
    }
}
