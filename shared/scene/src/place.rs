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

use std::collections::{HashMap, VecDeque};

use wire::HORIZON_MAX;

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
const LIKES_MAX: usize = 64;
/// A path whose moment counts for less is not told.
const LIKE_MIN: f32 = 0.01;
/// An agent that was not seen for so many steps is another one.
const GAP_STEPS: f64 = 2.0;

/// What is remembered of a moment.
#[derive(Clone, Debug)]
struct Memory {
    moment: Moment,
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
    forecast: Course,
    driven: Course,
    /// What was told of how it would depart, before skill.
    told: Departures,
}

/// A memory in its bucket, with what tells whether it matters.
#[derive(Clone, Copy, Debug)]
struct Entry {
    number: u64,
    stay: u64,
    agent: u64,
    moment: Moment,
}

/// Where an agent was seen last, and its moments that are under way.
#[derive(Clone, Debug)]
struct Trace {
    stamp_ns: i64,
    position_m: [f32; 2],
    under_way: VecDeque<UnderWay>,
}

/// How earlier agents departed from their forecasts, by place and motion.
#[derive(Clone, Debug)]
pub struct PlaceMemory {
    horizon_len: usize,
    step_ns: i64,
    memories: VecDeque<Memory>,
    /// Number of the oldest memory.
    oldest: u64,
    /// Oldest first.
    buckets: HashMap<Key, VecDeque<Entry>>,
    traces: HashMap<u64, Trace>,
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
            memories: VecDeque::new(),
            oldest: 0,
            buckets: HashMap::new(),
            traces: HashMap::new(),
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
        self.traces.clear();
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
        self.traces.retain(|_, trace| now_ns.saturating_sub(trace.stamp_ns) <= gap_ns);
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
        let fresh = || Trace { stamp_ns: now_ns, position_m, under_way: VecDeque::new() };
        let trace = self.traces.entry(agent).or_insert_with(fresh);
        let (since_ns, from_m) = (trace.stamp_ns, trace.position_m);
        (trace.stamp_ns, trace.position_m) = (now_ns, position_m);
        let (oldest, step_ns, horizon_len) = (self.oldest, self.step_ns, self.horizon_len);
        let (memories, skill) = (&mut self.memories, &mut self.skill);
        trace.under_way.retain_mut(|under_way| {
            let place = under_way.number.checked_sub(oldest).map(|place| place as usize);
            let Some(memory) = place.and_then(|place| memories.get_mut(place)) else { return false };
            let UnderWay { stamp_ns, forecast, driven, told, .. } = under_way;
            while memory.driven_len < horizon_len {
                let step = memory.driven_len;
                let due_ns = stamp_ns.saturating_add(step_ns.saturating_mul(step as i64 + 1));
                if due_ns > now_ns {
                    return true;
                }
                let share = (due_ns - since_ns) as f32 / (now_ns - since_ns).max(1) as f32;
                driven.push([0, 1].map(|axis| from_m[axis] + share * (position_m[axis] - from_m[axis])));
                memory.driven_len += 1;
                let gait = memory.moment.gait();
                let departures = path::departure(gait, forecast, driven, step, step_s);
                for (component, departure) in departures.into_iter().enumerate() {
                    if let Some((step, departure)) = departure {
                        memory.departures.tell(step, component, departure);
                        skill[gait as usize].learn(told, step, component, departure);
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
        let number = self.oldest + self.memories.len() as u64;
        let told = recalled.common.clone();
        trace.under_way.push_back(UnderWay { number, stamp_ns: self.now_ns, forecast, driven, told });
        let memory = Memory { moment: *moment, driven_len: 0, departures: Departures::default() };
        self.keep(memory, Entry { number, stay: self.stay, agent, moment: *moment });
    }

    /// Takes in a memory, for the oldest one where there are too many.
    fn keep(&mut self, memory: Memory, entry: Entry) {
        let bucket = self.buckets.entry(entry.moment.key()).or_default();
        bucket.push_back(entry);
        if bucket.len() > BUCKET_MAX[entry.moment.gait() as usize] {
            bucket.pop_front();
        }
        self.memories.push_back(memory);
        if self.memories.len() > MOMENTS_MAX {
            self.forget_oldest();
        }
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
            for entry in self.buckets.get(&key).into_iter().flatten() {
                let alike = entry.moment.alike(moment);
                let Some(alike) = alike.filter(|_| (entry.stay, entry.agent) != (self.stay, agent)) else {
                    continue;
                };
                let memory = &self.memories[(entry.number - self.oldest) as usize];
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
        let Some(memory) = self.memories.pop_front() else { return };
        let key = memory.moment.key();
        if let Some(bucket) = self.buckets.get_mut(&key) {
            if bucket.front().is_some_and(|entry| entry.number == self.oldest) {
                bucket.pop_front();
            }
            if bucket.is_empty() {
                self.buckets.remove(&key);
            }
        }
        self.oldest += 1;
    }
}
