//! The retrieval memory: entries of key and residuals, and the agents whose paths are filling them.

use std::collections::{HashMap, VecDeque, hash_map};

use kinematics::MotionKind;
use wire::{AGENTS_MAX, HORIZON_MAX};

use crate::expectation::{KernelMean, Shrinkage};
use crate::index::{KeyIndex, RUN_LEN};
use crate::residuals::{StepPath, residual};
use crate::{Bucket, Key, RETRIEVED_MAX, Residuals};

/// Newest entries of a bucket that are searched, by kind of motion. Buckets of displacements are larger.
const BUCKET_MAX: [usize; 2] = [128, 512];
/// Maximum number of entries; the newest are kept.
pub(crate) const ENTRIES_MAX: usize = 131_072;
/// Share of the expected residuals that is applied to modes.
const MODES_SHARE: f32 = 0.5;
/// Neighbours with less similarity are not retrieved.
const SIMILARITY_MIN: f32 = 0.01;
/// An agent that was not observed for this many steps counts as a new agent.
const GAP_STEPS: f64 = 2.0;
/// Maximum number of agents that are followed at a time; others are not stored.
const TRACES_MAX: usize = 4 * AGENTS_MAX;
/// Maximum number of entries that change between two observations: the agents of a frame fill entries, and
/// add new ones.
pub const CHANGED_MAX: usize = AGENTS_MAX * (HORIZON_MAX + 2);

/// The value of an entry.
#[derive(Clone, Debug)]
pub(crate) struct Value {
    pub(crate) agent: u64,
    pub(crate) session: u64,
    /// Number of steps taken since.
    pub(crate) taken_count: usize,
    pub(crate) residuals: Residuals,
}

/// An entry whose steps are not all taken yet.
#[derive(Clone, Debug)]
struct Pending {
    /// The entry's number.
    number: u64,
    stamp_ns: i64,
    kind: MotionKind,
    forecast: StepPath,
    taken: StepPath,
    /// The residuals predicted for it, before shrinkage.
    predicted: Residuals,
}

/// The last observation of an agent, and its pending entries.
#[derive(Clone, Debug)]
struct Trace {
    stamp_ns: i64,
    position_m: [f32; 2],
    pending: VecDeque<Pending>,
}

/// Residuals of earlier agents' forecasts by place and motion; see the [crate](crate). A new memory reserves
/// the address space of all entries at once.
#[derive(Clone, Debug)]
pub struct RetrievalMemory {
    pub(crate) horizon_len: usize,
    pub(crate) step_ns: i64,
    pub(crate) values: VecDeque<Value>,
    /// The keys of the values. Most searches read only the keys.
    pub(crate) index: KeyIndex,
    /// Number of the oldest entry.
    pub(crate) oldest: u64,
    traces: HashMap<u64, Trace>,
    /// Free buffers for the pending entries of new agents.
    spare: Vec<VecDeque<Pending>>,
    /// Shrinkage by kind of motion.
    pub(crate) shrinkage: [Shrinkage; 2],
    /// Number of the session: the count of ended sessions.
    pub(crate) session: u64,
    pub(crate) now_ns: i64,
    /// Numbers of the entries that have changed since the start of the last observation.
    pub(crate) changed: Vec<u64>,
}

/// An agent for which residuals are retrieved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Query {
    /// Time of validity.
    pub stamp_ns: i64,
    /// The agent's number, the same throughout a session.
    pub agent: u64,
    /// Position and motion at that time.
    pub key: Key,
}

/// An agent with its forecast, to be stored.
#[derive(Clone, Debug)]
pub struct Unstored {
    query: Query,
    /// The forecast path before any change by retrieval; steps after the horizon are left out.
    forecast_m: [[f32; 2]; HORIZON_MAX],
    /// The residuals retrieved for it, before shrinkage.
    predicted: Residuals,
}

/// The result of a retrieval for an agent.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Retrieved {
    /// The expected residuals: the kernel mean after shrinkage.
    pub expected: Residuals,
    /// The nearest neighbours with complete paths, in no order.
    pub neighbours: Vec<Neighbour>,
    /// Index of the least similar neighbour.
    least: usize,
    /// The kernel mean.
    mean: Residuals,
}

/// An earlier agent with a similar key.
#[derive(Clone, Debug, PartialEq)]
pub struct Neighbour {
    /// Similarity of the keys; 1 if they are equal.
    pub weight: f32,
    /// Residuals of its path.
    pub residuals: Residuals,
}

impl Unstored {
    /// An agent, its forecast path before any change by retrieval, and its retrieved residuals.
    ///
    /// # Panics
    /// If the path has more steps than a payload holds.
    #[must_use]
    pub fn new(query: &Query, forecast_m: &[[f32; 2]], retrieved: &Retrieved) -> Self {
        let mut path_m = [[0.0; 2]; HORIZON_MAX];
        path_m[..forecast_m.len()].copy_from_slice(forecast_m);
        Self { query: *query, forecast_m: path_m, predicted: retrieved.mean.clone() }
    }
}

impl Retrieved {
    /// An empty result with space for the largest one.
    #[must_use]
    pub fn with_room() -> Self {
        Self { neighbours: Vec::with_capacity(RETRIEVED_MAX), ..Self::default() }
    }

    /// Whether nothing was found.
    pub fn is_empty(&self) -> bool {
        self.neighbours.is_empty() && self.expected.is_empty()
    }

    /// The residuals applied to the modes of a forecast: half of the expected ones, because some modes
    /// already contain them.
    pub fn expected_of_modes(&self) -> Residuals {
        self.expected.scaled(MODES_SHARE)
    }

    /// Adds a neighbour, unless [`RETRIEVED_MAX`](crate::RETRIEVED_MAX) are more similar.
    fn add(&mut self, weight: f32, residuals: &Residuals) {
        if self.neighbours.len() < RETRIEVED_MAX {
            self.neighbours.push(Neighbour { weight, residuals: residuals.clone() });
        } else if weight > self.neighbours[self.least].weight {
            self.neighbours[self.least] = Neighbour { weight, residuals: residuals.clone() };
        } else {
            return;
        }
        let weights = self.neighbours.iter().map(|neighbour| neighbour.weight).enumerate();
        self.least = weights
            .reduce(|least, other| if other.1 < least.1 { other } else { least })
            .unwrap_or_default()
            .0;
    }
}

impl RetrievalMemory {
    /// An empty memory for forecasts of `horizon_len` steps of `step_ns`.
    ///
    /// # Panics
    /// If a forecast has more steps than a payload holds.
    #[must_use]
    pub fn new(horizon_len: usize, step_ns: u64) -> Self {
        assert!(horizon_len <= HORIZON_MAX, "horizon of {horizon_len} steps");
        Self {
            horizon_len,
            step_ns: step_ns.cast_signed().max(1),
            values: VecDeque::with_capacity(ENTRIES_MAX),
            index: KeyIndex::with_room(ENTRIES_MAX),
            oldest: 0,
            traces: HashMap::with_capacity(2 * TRACES_MAX),
            spare: (0..TRACES_MAX).map(|_| VecDeque::with_capacity(horizon_len + 1)).collect(),
            shrinkage: Default::default(),
            session: 0,
            now_ns: i64::MIN,
            changed: Vec::with_capacity(CHANGED_MAX),
        }
    }

    /// Number of stored entries.
    pub fn entry_count(&self) -> usize {
        self.values.len()
    }

    /// Ends a session. Entries remain, time restarts, and all later agents are new.
    pub fn end_session(&mut self) {
        self.keep_traces(|_| false);
        self.session += 1;
        self.now_ns = i64::MIN;
    }

    /// Records the positions of agents at a time, and fills the pending entries with the steps taken since
    /// the agents' last observation. Returns whether the time is newer than the last one; otherwise nothing
    /// is recorded.
    pub fn observe(&mut self, now_ns: i64, agents: impl IntoIterator<Item = (u64, [f32; 2])>) -> bool {
        if now_ns <= self.now_ns {
            return false;
        }
        self.now_ns = now_ns;
        self.changed.clear();
        let gap_ns = (self.step_ns as f64 * GAP_STEPS) as i64;
        self.keep_traces(|trace| now_ns.saturating_sub(trace.stamp_ns) <= gap_ns);
        agents.into_iter().for_each(|(agent, position_m)| self.observe_one(agent, position_m));
        true
    }

    fn observe_one(&mut self, agent: u64, position_m: [f32; 2]) {
        let (now_ns, step_s) = (self.now_ns, self.step_s());
        let trace = match self.traces.entry(agent) {
            hash_map::Entry::Occupied(known) => known.into_mut(),
            hash_map::Entry::Vacant(new) => {
                let Some(pending) = self.spare.pop() else { return };
                new.insert(Trace { stamp_ns: now_ns, position_m, pending })
            }
        };
        let (since_ns, from_m) = (trace.stamp_ns, trace.position_m);
        (trace.stamp_ns, trace.position_m) = (now_ns, position_m);
        let (oldest, step_ns, horizon_len) = (self.oldest, self.step_ns, self.horizon_len);
        let (values, shrinkage, changed) = (&mut self.values, &mut self.shrinkage, &mut self.changed);
        trace.pending.retain_mut(|pending| {
            let place = pending.number.checked_sub(oldest).map(|place| place as usize);
            let Some(value) = place.and_then(|place| values.get_mut(place)) else { return false };
            let Pending { number, stamp_ns, kind, forecast, taken, predicted } = pending;
            let taken_before = value.taken_count;
            while value.taken_count < horizon_len {
                let step = value.taken_count;
                let due_ns = stamp_ns.saturating_add(step_ns.saturating_mul(step as i64 + 1));
                if due_ns > now_ns {
                    break;
                }
                let share = (due_ns - since_ns) as f32 / (now_ns - since_ns).max(1) as f32;
                taken.push([0, 1].map(|axis| from_m[axis] + share * (position_m[axis] - from_m[axis])));
                value.taken_count += 1;
                let residuals = residual(*kind, forecast, taken, step, step_s);
                for (component, residual) in residuals.into_iter().enumerate() {
                    if let Some((step, residual)) = residual {
                        value.residuals.set(step, component, residual);
                        shrinkage[*kind as usize].learn(predicted, step, component, residual);
                    }
                }
            }
            if value.taken_count > taken_before {
                changed.push(*number);
            }
            value.taken_count < horizon_len
        });
    }

    /// Retrieves for an agent into `retrieved`. Then stores the agent with its forecast path before any
    /// change by retrieval.
    pub fn retrieve_and_store(&mut self, query: &Query, forecast_m: &[[f32; 2]], retrieved: &mut Retrieved) {
        self.retrieve(query.agent, &query.key, retrieved);
        self.store(&Unstored::new(query, forecast_m, retrieved));
    }

    /// Writes the residuals of other agents with similar keys to `retrieved`. Each entry is weighted by the
    /// similarity of its key, and its taken steps count.
    pub fn retrieve(&self, agent: u64, key: &Key, retrieved: &mut Retrieved) {
        self.retrieve_behind(&[], agent, key, retrieved);
    }

    /// As [`RetrievalMemory::retrieve`], if several agents of a frame are retrieved for at the same time.
    /// `ahead` has the buckets of the frame's earlier agents. The result is the same as if these agents had
    /// been stored: they have no residuals yet, but they push out older entries.
    pub fn retrieve_behind(&self, ahead: &[Bucket], agent: u64, key: &Key, retrieved: &mut Retrieved) {
        let kind = key.kind();
        let dropped = (self.values.len() + ahead.len()).saturating_sub(ENTRIES_MAX);
        let oldest = self.oldest + dropped as u64;
        let mut mean = KernelMean::default();
        retrieved.neighbours.clear();
        retrieved.least = 0;
        for bucket in key.buckets_around() {
            let ahead_count = ahead.iter().filter(|ahead| **ahead == bucket).count();
            let mut left = BUCKET_MAX[kind as usize].saturating_sub(ahead_count);
            for (numbers, keys) in self.index.runs(&bucket, oldest) {
                // First all keys of the run, and then the values of the similar ones: the values are far
                // apart in memory.
                let mut similar = [None; RUN_LEN];
                similar.iter_mut().zip(keys).for_each(|(similar, own)| *similar = own.similarity(key));
                let found = similar[..numbers.len()].iter().zip(numbers);
                for (similar, &number) in found.rev().take(left) {
                    let Some(similarity) = similar else { continue };
                    let value = &self.values[(number - self.oldest) as usize];
                    if (value.session, value.agent) == (self.session, agent) {
                        continue;
                    }
                    if similarity.in_mean > 0.0 {
                        mean.add(similarity.in_mean, &value.residuals);
                    }
                    if similarity.as_neighbour >= SIMILARITY_MIN && value.taken_count == self.horizon_len {
                        retrieved.add(similarity.as_neighbour, &value.residuals);
                    }
                }
                left = left.saturating_sub(numbers.len());
                if left == 0 {
                    break;
                }
            }
        }
        retrieved.mean = mean.residuals(kind);
        retrieved.expected = self.shrinkage[kind as usize].shrink(kind, &retrieved.mean);
    }

    /// Whether an agent would be stored. It must have been observed at the query's time, which must be the
    /// newest time. An agent is stored at most once per step.
    #[must_use]
    pub fn would_store(&self, stamp_ns: i64, agent: u64) -> bool {
        stamp_ns == self.now_ns
            && self.traces.get(&agent).is_some_and(|trace| {
                let last_ns = trace.pending.back().map(|pending| pending.stamp_ns);
                trace.stamp_ns == stamp_ns && last_ns.is_none_or(|last_ns| stamp_ns - last_ns >= self.step_ns)
            })
    }

    /// Stores an agent with its forecast path and its retrieved residuals, if it [would be
    /// stored](Self::would_store).
    pub fn store(&mut self, new: &Unstored) {
        let Query { stamp_ns, agent, key } = new.query;
        if !self.would_store(stamp_ns, agent) {
            return;
        }
        let Some(trace) = self.traces.get_mut(&agent) else { return };
        let taken = StepPath::new(key.position_m());
        let mut forecast = taken.clone();
        new.forecast_m.iter().take(self.horizon_len).for_each(|&position_m| forecast.push(position_m));
        // If the oldest entry is dropped, the numbers still continue.
        let number = self.oldest + self.values.len() as u64;
        self.changed.push(number);
        trace.pending.push_back(Pending {
            number,
            stamp_ns,
            kind: key.kind(),
            forecast,
            taken,
            predicted: new.predicted.clone(),
        });
        let (session, residuals) = (self.session, Residuals::default());
        self.push(key, Value { agent, session, taken_count: 0, residuals });
    }

    /// Adds an entry; if there are [`ENTRIES_MAX`], it replaces the oldest.
    pub(crate) fn push(&mut self, key: Key, value: Value) {
        if self.values.len() == ENTRIES_MAX {
            self.drop_oldest();
        }
        self.index.push(self.oldest + self.values.len() as u64, key);
        self.values.push_back(value);
    }

    /// The places of a bucket's searched entries, newest first.
    pub(crate) fn bucket(&self, bucket: &Bucket) -> impl Iterator<Item = usize> {
        let numbers = self.index.runs(bucket, self.oldest).flat_map(|(numbers, _)| numbers.iter().rev());
        numbers.map(|number| (number - self.oldest) as usize).take(BUCKET_MAX[bucket.kind as usize])
    }

    /// The key of the entry at a place.
    pub(crate) fn key(&self, place: usize) -> Option<&Key> {
        self.index.key(place, self.oldest + place as u64)
    }

    fn step_s(&self) -> f32 {
        self.step_ns as f32 * 1e-9
    }

    fn drop_oldest(&mut self) {
        self.values.pop_front();
        self.index.drop_oldest(self.oldest);
        self.oldest += 1;
    }

    /// Keeps the traces that `keeps` selects. The pending entries of the others are not filled any further,
    /// and their buffers are reused.
    fn keep_traces(&mut self, mut keeps: impl FnMut(&Trace) -> bool) {
        let spare = &mut self.spare;
        self.traces.retain(|_, trace| {
            let kept = keeps(trace);
            if !kept {
                let mut pending = std::mem::take(&mut trace.pending);
                pending.clear();
                spare.push(pending);
            }
            kept
        });
    }
}
