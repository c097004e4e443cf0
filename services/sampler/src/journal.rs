//! The learned state of the sampler in memory that outlives its process: the retrieval memory and the
//! evidence.
//!
//! After each tick the sampler *commits* a *record*: all small state, and the entries of the retrieval memory
//! that the tick has changed. Two records are stored side by side and written alternately. The check value of
//! a record is its *commit mark*. If a process is killed while it writes one record, the other one remains.
//!
//! The *slots* are a ring for all entries. A record's entries are copied to their slots when the next commit
//! begins, and always before the record is overwritten. The slots and the newest whole record together are
//! the state after exactly one tick. Until the next commit begins, the slots and the other whole record are
//! the state after the previous tick. Copying is idempotent, so an interrupted copy can be repeated.
//!
//! Forecasts that wait for their truth are not kept. An entry with an incomplete path keeps the steps that it
//! has at the tick, and gets no further steps.

use std::mem::size_of;
use std::sync::atomic::{Ordering, compiler_fence};

use bytemuck::{Pod, Zeroable, bytes_of, cast_slice, cast_slice_mut, from_bytes, from_bytes_mut};
use evidence::{Evidence, NUMBERS_LEN};
use retrieval::{CHANGED_MAX, RetrievalMemory, StoredEntry, StoredState};
use wire::crc64;

use crate::SamplerOptions;

/// The first bytes, which contain the version of the format.
const MAGIC: [u8; 8] = *b"stgdatJ2";
const RECORDS_AT: usize = 4096;
/// Size of a record with the maximum number of changed entries.
const RECORD_BYTES: usize =
    (size_of::<Record>() + NUMBERS_LEN * size_of::<f64>() + CHANGED_MAX * size_of::<StoredEntry>())
        .next_multiple_of(4096);
const SLOTS_AT: usize = RECORDS_AT + 2 * RECORD_BYTES;
/// Number of slots by which the memory grows, ahead of need: about 1 MiB.
const GROWTH_SLOTS: usize = 8192;

/// Size of the largest journal.
pub(crate) const BYTES_MAX: usize =
    SLOTS_AT + (RetrievalMemory::ENTRIES_MAX + GROWTH_SLOTS) * size_of::<Slot>();

/// Bytes as aligned numbers, filled up with zeros.
pub(crate) fn words(bytes: &[u8]) -> Vec<u64> {
    let mut words = vec![0; bytes.len().div_ceil(size_of::<u64>())];
    cast_slice_mut(&mut words)[..bytes.len()].copy_from_slice(bytes);
    words
}

/// Bytes that outlive their writer.
pub trait Storage {
    /// All bytes, aligned for 64-bit numbers.
    fn bytes(&mut self) -> &mut [u8];

    /// Adds zeros up to this length.
    ///
    /// # Errors
    /// The reason, if no space is available.
    fn grow_to(&mut self, len: usize) -> Result<(), String>;
}

impl Storage for Box<dyn Storage + Send> {
    fn bytes(&mut self) -> &mut [u8] {
        (**self).bytes()
    }

    fn grow_to(&mut self, len: usize) -> Result<(), String> {
        (**self).grow_to(len)
    }
}

/// Storage within this process only.
impl Storage for Vec<u64> {
    fn bytes(&mut self) -> &mut [u8] {
        cast_slice_mut(self)
    }

    fn grow_to(&mut self, len: usize) -> Result<(), String> {
        let len = len.div_ceil(size_of::<u64>()).max(self.len());
        self.resize(len, 0);
        Ok(())
    }
}

/// Identifies the owner of the state. The state of another owner is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Identity {
    /// Number of the run, or of the weights for state that is saved for later runs.
    run_id: u64,
    /// Steps of a forecast.
    horizon_len: u32,
    /// The parts of the state, as bits of [`MEMORY`] and [`EVIDENCE`].
    parts: u32,
}

#[derive(Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
struct Head {
    magic: [u8; 8],
    identity: Identity,
    check: u64,
}

/// The head of a record. The numbers of the evidence and the entries follow.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Record {
    check: u64,
    /// Counts the records.
    generation: u64,
    /// Number of ticks of the run that the state includes.
    ticks: u64,
    /// Spacing of the forecasts' steps.
    step_ns: u64,
    /// As in [`Identity::parts`].
    parts: u64,
    entry_count: u64,
    memory: StoredState,
}

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Slot {
    entry: StoredEntry,
    check: u64,
}

/// The stored state of a sampler.
pub struct Resumed {
    /// Number of ticks of the run that the state includes.
    pub ticks: u64,
    pub(crate) step_ns: u64,
    pub(crate) memory: Option<RetrievalMemory>,
    pub(crate) evidence: Option<Vec<f64>>,
}

/// Memory with the state of one sampler.
pub struct Journal<S> {
    storage: S,
    identity: Identity,
    /// Generation of the newest record; 0 before the first.
    generation: u64,
}

impl Journal<Vec<u64>> {
    /// Wraps a copy of a journal, whoever owns it, and returns its identity.
    ///
    /// # Errors
    /// The reason why the bytes are not a journal.
    pub(crate) fn belonging_to_any(words: Vec<u64>) -> Result<(Self, Identity), &'static str> {
        let head = cast_slice::<u64, u8>(&words).get(..size_of::<Head>()).ok_or("of another version")?;
        let Head { identity, .. } = *from_bytes(head);
        Ok((Self::over(words, identity), identity))
    }

    /// The bytes of the journal for another owner.
    pub(crate) fn into_bytes_for(self, identity: Identity) -> Vec<u8> {
        let mut bytes = cast_slice::<u64, u8>(&self.storage).to_vec();
        bytes[..size_of::<Head>()].copy_from_slice(bytes_of(&Head::new(identity)));
        bytes
    }
}

impl<S: Storage> Journal<S> {
    /// Wraps storage with existing or future state. Call [`Journal::resume`] or [`Journal::clear`] next.
    pub const fn over(storage: S, identity: Identity) -> Self {
        Self { storage, identity, generation: 0 }
    }

    /// Empties the memory and reserves space for the next commits.
    ///
    /// # Errors
    /// The reason, if no space is available.
    pub fn clear(&mut self) -> Result<(), String> {
        self.storage.grow_to(SLOTS_AT + GROWTH_SLOTS * size_of::<Slot>())?;
        self.generation = 0;
        let bytes = self.storage.bytes();
        for generation in [1, 2] {
            record(bytes, generation)[..size_of::<Record>()].fill(0);
        }
        bytes[..size_of::<Head>()].copy_from_slice(bytes_of(&Head::new(self.identity)));
        Ok(())
    }

    /// The memory.
    pub fn into_storage(self) -> S {
        self.storage
    }

    /// Returns the newest state, or the state after `ticks`; `None` if there is none.
    ///
    /// # Errors
    /// The reason why the stored state cannot be used.
    pub fn resume(&mut self, ticks: Option<u64>) -> Result<Option<Resumed>, &'static str> {
        let bytes = self.storage.bytes();
        if bytes.is_empty() {
            return Ok(None);
        }
        let head = bytes.get(..size_of::<Head>()).filter(|_| bytes.len() >= SLOTS_AT);
        let head: Head = *from_bytes(head.ok_or("of another version")?);
        match head {
            Head { magic, .. } if magic != MAGIC => return Err("of another version"),
            head if head != Head::new(head.identity) => return Err("damaged"),
            Head { identity: Identity { run_id, .. }, .. } if run_id != self.identity.run_id => {
                return Err("of another run");
            }
            Head { identity, .. } if identity != self.identity => {
                return Err("of a sampler with other options");
            }
            _ => {}
        }
        let mut whole: Vec<Record> = [1, 2].into_iter().filter_map(|place| whole(bytes, place)).collect();
        whole.sort_by_key(|record| record.generation);
        if let [older, newer] = whole[..]
            && newer.generation != older.generation + 1
        {
            return Err("damaged");
        }
        let newest = whole.iter().rposition(|record| ticks.is_none_or(|ticks| record.ticks == ticks));
        let Some(newest) = newest else { return Ok(None) };
        for record in &whole[..=newest] {
            self.generation = record.generation;
            self.copy_to_slots().map_err(|_| "too short")?;
        }
        self.read(&whole[newest]).map(Some)
    }

    /// Commits the state after `ticks` ticks.
    ///
    /// # Errors
    /// The reason, if no space is available or a tick has changed more than [`CHANGED_MAX`] entries. The
    /// stored state is then invalid, and the caller must not commit again.
    pub fn commit(
        &mut self,
        ticks: u64,
        memory: Option<&RetrievalMemory>,
        evidence: Option<&mut Evidence>,
    ) -> Result<(), String> {
        let committed = self.try_commit(ticks, memory, evidence);
        if committed.is_err() {
            self.storage.bytes()[..size_of::<Head>()].fill(0);
        }
        committed
    }

    fn try_commit(
        &mut self,
        ticks: u64,
        memory: Option<&RetrievalMemory>,
        evidence: Option<&mut Evidence>,
    ) -> Result<(), String> {
        match memory {
            _ if self.generation > 0 => self.copy_to_slots()?,
            // Entries from before the first commit are in no record.
            Some(memory) => {
                let StoredState { oldest, next, .. } = memory.state();
                (oldest..next).filter_map(|number| memory.entry(number)).try_for_each(|e| self.put(e))?;
            }
            None => {}
        }
        // The slots are written first, then the record that is no longer needed.
        compiler_fence(Ordering::SeqCst);
        let generation = self.generation + 1;
        let record = record(self.storage.bytes(), generation);
        let (head, numbers, entries) = parts(record);
        *head = Record { generation, ticks, parts: 0, entry_count: 0, ..Record::zeroed() };
        if let Some(evidence) = evidence {
            head.parts |= EVIDENCE;
            head.step_ns = evidence.step_ns();
            evidence.write_numbers(numbers);
        }
        if let Some(memory) = memory {
            head.parts |= MEMORY;
            head.memory = memory.state();
            let changed = memory.changed().filter_map(|number| memory.entry(number));
            for entry in changed {
                let place = entries.get_mut(head.entry_count as usize);
                *place.ok_or_else(|| format!("more than {CHANGED_MAX} entries in a tick"))? = entry;
                head.entry_count += 1;
            }
        }
        head.check = check(head, numbers, &entries[..head.entry_count as usize]);
        self.generation = generation;
        Ok(())
    }

    /// Copies the entries of the newest record to their slots.
    fn copy_to_slots(&mut self) -> Result<(), String> {
        let (head, _, entries) = parts(record(self.storage.bytes(), self.generation));
        let len = head.entry_count as usize;
        let slot_end = entries[..len].iter().map(|entry| slot_at(entry.number) + size_of::<Slot>()).max();
        self.reserve(slot_end.unwrap_or(SLOTS_AT))?;
        let (records, slots) = self.storage.bytes().split_at_mut(SLOTS_AT);
        let (.., entries) = parts(record(records, self.generation));
        for entry in &entries[..len] {
            let at = slot_at(entry.number) - SLOTS_AT;
            slots[at..at + size_of::<Slot>()].copy_from_slice(bytes_of(&Slot::new(*entry)));
        }
        Ok(())
    }

    fn put(&mut self, entry: StoredEntry) -> Result<(), String> {
        let at = slot_at(entry.number);
        self.reserve(at + size_of::<Slot>())?;
        self.storage.bytes()[at..at + size_of::<Slot>()].copy_from_slice(bytes_of(&Slot::new(entry)));
        Ok(())
    }

    fn reserve(&mut self, len: usize) -> Result<(), String> {
        let growth = GROWTH_SLOTS * size_of::<Slot>();
        if len <= self.storage.bytes().len() {
            return Ok(());
        }
        self.storage.grow_to(SLOTS_AT + (len - SLOTS_AT).next_multiple_of(growth))
    }

    /// Reads the state of a record whose entries are in their slots.
    fn read(&mut self, head: &Record) -> Result<Resumed, &'static str> {
        let bytes = self.storage.bytes();
        let (_, numbers, _) = parts(record(bytes, head.generation));
        let evidence = (head.parts & EVIDENCE != 0).then(|| numbers.to_vec());
        let StoredState { oldest, next, .. } = head.memory;
        let slot = |number: u64| {
            let at = slot_at(number);
            let slot: &Slot = from_bytes(bytes.get(at..at + size_of::<Slot>())?);
            (slot.check == Slot::new(slot.entry).check).then_some(slot.entry)
        };
        let memory = match head.parts & MEMORY {
            0 => None,
            _ => Some(RetrievalMemory::of_stored(&head.memory, (oldest..next).map_while(slot))?),
        };
        Ok(Resumed { ticks: head.ticks, step_ns: head.step_ns, memory, evidence })
    }
}

/// Bits of [`Record::parts`].
const MEMORY: u64 = 1;
const EVIDENCE: u64 = 2;

impl Identity {
    /// The identity of a run's sampler; `None` if it does not learn.
    #[must_use]
    pub fn of(run_id: u64, options: &SamplerOptions) -> Option<Self> {
        let parts = u64::from(options.retrieval) * MEMORY + u64::from(options.evidence) * EVIDENCE;
        let horizon_len = options.horizon_len as u32;
        (parts != 0).then_some(Self { run_id, horizon_len, parts: parts as u32 })
    }

    /// The same identity with another owner.
    pub(crate) const fn with_owner(self, owner: u64) -> Self {
        Self { run_id: owner, ..self }
    }
}

impl Head {
    fn new(identity: Identity) -> Self {
        let check = crc64(&[&MAGIC, bytes_of(&identity)]);
        Self { magic: MAGIC, identity, check }
    }
}

impl Slot {
    fn new(entry: StoredEntry) -> Self {
        Self { entry, check: crc64(&[bytes_of(&entry)]) }
    }
}

fn slot_at(number: u64) -> usize {
    SLOTS_AT + (number % RetrievalMemory::ENTRIES_MAX as u64) as usize * size_of::<Slot>()
}

fn record(bytes: &mut [u8], generation: u64) -> &mut [u8] {
    &mut bytes[RECORDS_AT + (generation % 2) as usize * RECORD_BYTES..][..RECORD_BYTES]
}

/// Head, numbers and entries in the bytes of a record.
fn parts(record: &mut [u8]) -> (&mut Record, &mut [f64], &mut [StoredEntry]) {
    let (head, rest) = record.split_at_mut(size_of::<Record>());
    let (numbers, entries) = rest.split_at_mut(NUMBERS_LEN * size_of::<f64>());
    let entries = &mut entries[..CHANGED_MAX * size_of::<StoredEntry>()];
    (from_bytes_mut(head), cast_slice_mut(numbers), cast_slice_mut(entries))
}

/// Returns the record at the place of a generation, if it is whole.
fn whole(bytes: &mut [u8], place: u64) -> Option<Record> {
    let (head, numbers, entries) = parts(record(bytes, place));
    let entries = entries.get(..usize::try_from(head.entry_count).ok()?)?;
    let is_whole = head.generation > 0 && head.generation % 2 == place % 2;
    (is_whole && head.check == check(head, numbers, entries)).then_some(*head)
}

fn check(head: &Record, numbers: &[f64], entries: &[StoredEntry]) -> u64 {
    crc64(&[&bytes_of(head)[size_of::<u64>()..], cast_slice(numbers), cast_slice(entries)])
}
