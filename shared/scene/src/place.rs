//! The memory of a place: how those who came by earlier went on otherwise than forecast.
//!
//! A model that never saw a place knows nothing of its stop lines, its bends and where people slow down. Whoever was
//! forecast a moment ago shows it: the difference between the path that was forecast and the one that was taken
//! is remembered with the moment that it began at, and told to those who come to the same place in the same motion: what all
//! had in common, and how each of the likeliest went on ([`Choice`] lets them stand in for modes). Every step of it is known only once
//! it was taken, so that nothing of the future is in it.

mod choice;
mod file;
mod moment;
mod path;

use std::collections::{HashMap, VecDeque, hash_map};

use wire::{AGENTS_MAX, HORIZON_MAX};

pub use choice::Choice;
use moment::Key;
pub use moment::{Driving, Gait, Moment, Walking};
pub use path::Departures;
use path::{Course, Evidence, Skill};

/// Newest moments of a bucket that are kept, of those who drive and of those who walk: a bucket of walkers is larger.
const BUCKET_MAX: [usize; 2] = [128, 512];
/// Newest moments that are kept at all.
const MOMENTS_MAX: usize = 131_072;
/// Share of what is to be expected that modes depart by.
const MODES_SHARE: f32 = 0.5;
/// Most paths of others that are told: the likeliest.
pub const LIKES_MAX: usize = 64;
/// A path whose moment counts for less is not told.
const LIKE_MIN: f32 = 0.01;
/// An agent that was not seen for so many steps is another one.
const GAP_STEPS: f64 = 2.0;
/// Agents that are followed at a time; of others nothing is remembered.
const TRACES_MAX: usize = 4 * AGENTS_MAX;

/// What is remembered of a moment.
#[derive(Clone, Debug)]
struct Memory {
    agent: u64,
    stay: u64,
    /// Steps that were driven since.
    driven_len: usize,
    /// How they departed.
    departures: Departures,
}

/// A moment whose steps are not all driven yet.
#[derive(Clone, Debug)]
struct UnderWay {
    /// That of the memory.
    number: u64,
    stamp_ns: i64,
    gait: Gait,
    forecast: Course,
    driven: Course,
    /// What was told of how it would depart, before skill.
    told: Departures,
}

/// What tells whether a memory matters: kept apart from the rest, of which most is not looked at.
#[derive(Clone, Copy, Debug)]
struct Entry {
    moment: Moment,
    /// How many numbers before it the last memory of its bucket was kept; 0 where it is the first.
    back: u32,
}

/// Where an agent was seen last, and its moments that are under way.
#[derive(Clone, Debug)]
struct Trace {
    stamp_ns: i64,
    position_m: [f32; 2],
    under_way: VecDeque<UnderWay>,
}

/// How earlier agents departed from their forecasts, by place and motion.
///
/// A new one takes address space for all that it may remember, and no more later.
#[derive(Clone, Debug)]
pub struct PlaceMemory {
    horizon_len: usize,
    step_ns: i64,
    memories: VecDeque<Memory>,
    /// Those of the memories.
    entries: VecDeque<Entry>,
    /// Number of the oldest memory.
    oldest: u64,
    /// Numbers of the newest memories.
    buckets: HashMap<Key, u64>,
    traces: HashMap<u64, Trace>,
    /// Room for the moments under way of agents who are still to come.
    spare: Vec<VecDeque<UnderWay>>,
    /// By gait.
    skill: [Skill; 2],
    /// How often the memory left before.
    stay: u64,
    now_ns: i64,
}

/// What is remembered of others for an agent.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recall {
    /// What is to be expected.
    pub expected: Departures,
    /// How those went on whose moments were the most alike, each by itself, to the end of the horizon; in no order.
    pub likes: Vec<Like>,
    /// Which of them was the least alike.
    least: usize,
    /// What the others had in common.
    common: Departures,
}

/// One who came by earlier.
#[derive(Clone, Debug, PartialEq)]
pub struct Like {
    /// How much alike the moments were: 1 where they were the same.
    pub weight: f32,
    /// How its path departed from its forecast.
    pub departures: Departures,
}

impl Recall {
    /// Nothing yet, with room for all that may be told.
    #[must_use]
    pub fn with_room() -> Self {
        Self { likes: Vec::with_capacity(LIKES_MAX), ..Self::default() }
    }

    /// Whether nothing is told.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.likes.is_empty() && self.expected.is_empty()
    }

    /// What the modes of a forecast are to depart by: half of what is to be expected, since some of them say so already.
    #[must_use]
    pub fn expected_of_modes(&self) -> Departures {
        self.expected.scaled(MODES_SHARE)
    }

    /// Tells of one more, unless that many are more alike.
    fn tell_of(&mut self, weight: f32, departures: &Departures) {
        if self.likes.len() < LIKES_MAX {
            self.likes.push(Like { weight, departures: departures.clone() });
        } else if weight > self.likes[self.least].weight {
            self.likes[self.least] = Like { weight, departures: departures.clone() };
        } else {
            return;
        }
        let weights = self.likes.iter().map(|like| like.weight).enumerate();
        self.least = weights
            .reduce(|least, other| if other.1 < least.1 { other } else { least })
            .unwrap_or_default()
            .0;
    }
}

impl PlaceMemory {
    /// A memory of nothing, for forecasts of so many steps.
    ///
    /// # Panics
    /// If a forecast has more steps than a payload holds.
    #[must_use]
    pub fn new(horizon_len: usize, step_ns: u64) -> Self {
        assert!(horizon_len <= HORIZON_MAX, "horizon of {horizon_len} steps");
        Self {
            horizon_len,
            step_ns: step_ns.cast_signed().max(1),
            memories: VecDeque::with_capacity(MOMENTS_MAX),
            entries: VecDeque::with_capacity(MOMENTS_MAX),
            oldest: 0,
            // Half full at most, a table makes room for keys that come and go without taking memory.
            buckets: HashMap::with_capacity(2 * MOMENTS_MAX),
            traces: HashMap::with_capacity(2 * TRACES_MAX),
            spare: (0..TRACES_MAX).map(|_| VecDeque::with_capacity(horizon_len + 1)).collect(),
            skill: Default::default(),
            stay: 0,
            now_ns: i64::MIN,
        }
    }

    /// Moments that are remembered.
    #[must_use]
    pub fn moments_len(&self) -> usize {
        self.memories.len()
    }

    /// Ends a stay: what is remembered lasts, but time begins anew and nobody who comes is one of those who were there.
    pub fn leave(&mut self) {
        self.keep_traces(|_| false);
        self.stay += 1;
        self.now_ns = i64::MIN;
    }

    /// Goes on to a time; returns whether it is newer than the last.
    pub fn advance(&mut self, now_ns: i64) -> bool {
        if now_ns <= self.now_ns {
            return false;
        }
        self.now_ns = now_ns;
        let gap_ns = (self.step_ns as f64 * GAP_STEPS) as i64;
        self.keep_traces(|trace| now_ns.saturating_sub(trace.stamp_ns) <= gap_ns);
        true
    }

    /// Whether that is the time to which it went on last: what is remembered belongs to it.
    #[must_use]
    pub const fn is_at(&self, stamp_ns: i64) -> bool {
        self.now_ns == stamp_ns
    }

    /// Takes in where an agent is now, at the end of what it drove since it was seen last.
    pub fn observe(&mut self, agent: u64, position_m: [f32; 2]) {
        let (now_ns, step_s) = (self.now_ns, self.step_s());
        let trace = match self.traces.entry(agent) {
            hash_map::Entry::Occupied(known) => known.into_mut(),
            hash_map::Entry::Vacant(new) => {
                let Some(under_way) = self.spare.pop() else { return };
                new.insert(Trace { stamp_ns: now_ns, position_m, under_way })
            }
        };
        let (since_ns, from_m) = (trace.stamp_ns, trace.position_m);
        (trace.stamp_ns, trace.position_m) = (now_ns, position_m);
        let (oldest, step_ns, horizon_len) = (self.oldest, self.step_ns, self.horizon_len);
        let (memories, skill) = (&mut self.memories, &mut self.skill);
        trace.under_way.retain_mut(|under_way| {
            let place = under_way.number.checked_sub(oldest).map(|place| place as usize);
            let Some(memory) = place.and_then(|place| memories.get_mut(place)) else { return false };
            let UnderWay { stamp_ns, gait, forecast, driven, told, .. } = under_way;
            while memory.driven_len < horizon_len {
                let step = memory.driven_len;
                let due_ns = stamp_ns.saturating_add(step_ns.saturating_mul(step as i64 + 1));
                if due_ns > now_ns {
                    return true;
                }
                let share = (due_ns - since_ns) as f32 / (now_ns - since_ns).max(1) as f32;
                driven.push([0, 1].map(|axis| from_m[axis] + share * (position_m[axis] - from_m[axis])));
                memory.driven_len += 1;
                let departures = path::departure(*gait, forecast, driven, step, step_s);
                for (component, departure) in departures.into_iter().enumerate() {
                    if let Some((step, departure)) = departure {
                        memory.departures.tell(step, component, departure);
                        skill[*gait as usize].learn(told, step, component, departure);
                    }
                }
            }
            false
        });
    }

    /// Remembers a moment of an agent that was observed now, and the path that was forecast for it, of which what is remembered
    /// was no part. An agent is remembered once a step.
    pub fn remember(&mut self, agent: u64, moment: &Moment, forecast_m: &[[f32; 2]], recalled: &Recall) {
        let Some(trace) = self.traces.get_mut(&agent).filter(|trace| trace.stamp_ns == self.now_ns) else {
            return;
        };
        let last_ns = trace.under_way.back().map(|under_way| under_way.stamp_ns);
        if last_ns.is_some_and(|last_ns| self.now_ns - last_ns < self.step_ns) {
            return;
        }
        let driven = Course::new(moment.position_m());
        let mut forecast = driven.clone();
        forecast_m.iter().take(self.horizon_len).for_each(|&position_m| forecast.push(position_m));
        let (stamp_ns, told) = (self.now_ns, recalled.common.clone());
        trace.under_way.push_back(UnderWay {
            number: self.oldest + self.memories.len() as u64,
            stamp_ns,
            gait: moment.gait(),
            forecast,
            driven,
            told,
        });
        let (stay, departures) = (self.stay, Departures::default());
        self.keep(*moment, Memory { agent, stay, driven_len: 0, departures });
    }

    /// Takes in the memory of a moment, for the oldest one where there are too many.
    fn keep(&mut self, moment: Moment, memory: Memory) {
        if self.memories.len() == MOMENTS_MAX {
            self.forget_oldest();
        }
        let number = self.oldest + self.memories.len() as u64;
        let before = self.buckets.insert(moment.key(), number);
        self.entries.push_back(Entry { moment, back: before.map_or(0, |before| (number - before) as u32) });
        self.memories.push_back(memory);
    }

    /// The places of a bucket's memories, the newest first.
    fn bucket(&self, key: &Key) -> impl Iterator<Item = usize> {
        let newest = self.buckets.get(key).map(|number| (number - self.oldest) as usize);
        let before = |place: &usize| match self.entries[*place].back as usize {
            0 => None,
            back => place.checked_sub(back),
        };
        std::iter::successors(newest, before).take(BUCKET_MAX[key.0 as usize])
    }

    /// How others departed who were where the agent is now and moved alike, into `recall`.
    ///
    /// Each moment whose step was driven counts by how much alike it is to this one.
    pub fn recall(&self, agent: u64, moment: &Moment, recall: &mut Recall) {
        let gait = moment.gait();
        let mut evidence = Evidence::default();
        recall.likes.clear();
        recall.least = 0;
        for key in moment.keys_around() {
            for place in self.bucket(&key) {
                let Some(alike) = self.entries[place].moment.alike(moment) else { continue };
                let memory = &self.memories[place];
                if (memory.stay, memory.agent) == (self.stay, agent) {
                    continue;
                }
                if alike.in_common > 0.0 {
                    evidence.add(alike.in_common, &memory.departures);
                }
                if alike.path >= LIKE_MIN && memory.driven_len == self.horizon_len {
                    recall.tell_of(alike.path, &memory.departures);
                }
            }
        }
        recall.common = evidence.means(gait);
        recall.expected = self.skill[gait as usize].of(gait, &recall.common);
    }

    fn step_s(&self) -> f32 {
        self.step_ns as f32 * 1e-9
    }

    fn forget_oldest(&mut self) {
        self.memories.pop_front();
        let Some(entry) = self.entries.pop_front() else { return };
        let key = entry.moment.key();
        if self.buckets.get(&key) == Some(&self.oldest) {
            self.buckets.remove(&key);
        }
        self.oldest += 1;
    }

    /// Keeps some traces; what the others were under way with is forgotten, its room is not.
    fn keep_traces(&mut self, mut keeps: impl FnMut(&Trace) -> bool) {
        let spare = &mut self.spare;
        self.traces.retain(|_, trace| {
            let kept = keeps(trace);
            if !kept {
                let mut under_way = std::mem::take(&mut trace.under_way);
                under_way.clear();
                spare.push(under_way);
            }
            kept
        });
    }
}
