//! Displacements of all agents at once, as a localisation that jumps causes them.
//!
//! Agents are followed from frame to frame by their positions. If nearly no agent is near its expected position, but one
//! displacement brings nearly all of them to a detection, the frame of the positions has moved.

use wire::{Detection, detection_flags};

use crate::motion::Motion;
use crate::tally::{Place, Tally};

/// Longest time between two frames.
const FRAMES_MAX_S: f64 = 1.0;
/// Smallest number of agents, and shares of them that are found without and with a displacement.
const AGENTS_MIN: usize = 3;
const KEPT_MAX: f64 = 0.2;
const DISPLACED_MIN: f64 = 0.8;
/// Largest number of detections of a frame that are examined, and number of agents whose displacements are tried.
const EXAMINED_MAX: usize = 64;
const TRIED_MAX: usize = 8;
/// Shortest and longest displacement. It is also twice as long as the largest distance below: the places that agents
/// should have reached with and without it differ.
const JUMP_M: std::ops::RangeInclusive<f64> = 1.0..=50.0;
/// A displacement is at least this multiple of the usual distance from the expected position. That is the root of a
/// running mean of squares, in which the newest one has the weight below.
const OFF_RATIO: f64 = 4.0;
const OFF_WEIGHT: f64 = 0.02;
/// Distance from a place that an agent should have reached: a part and a change of the speed in a second.
const OFF_M: f64 = 0.5;
const OFF_MPS: f64 = 1.0;
/// Largest distance of the first step, largest speed of the first step of an identity, and largest distance from the
/// expected position: a part and a change of the speed in a second.
const FIRST_STEP_M: f64 = 4.0;
const FIRST_STEP_MPS: f64 = 50.0;
const SLACK_M: f64 = 0.5;
const CHANGE_MPS: f64 = 3.0;

/// A detection of a frame.
#[derive(Clone, Copy, Debug)]
struct Seen {
    id: Option<u64>,
    stamp_ns: i64,
    position_m: [f64; 2],
    motion: Motion,
    /// The distance from the expected position at which the next frame has found the agent, if it has.
    found_off_m: Option<f64>,
}

/// Follows the agents of two frames.
#[derive(Clone, Debug)]
pub(crate) struct Displacements {
    frame: u64,
    place: Place,
    earlier: Vec<Seen>,
    present: Vec<Seen>,
    /// Number of the present frame's detections.
    rows: u64,
    /// Mean square of the distances from the expected positions.
    off_m2: f64,
    /// Sum of the displacements so far.
    offset_m: [f64; 2],
    /// Detections in a displaced frame.
    displaced: Tally,
}

impl Displacements {
    pub fn new() -> Self {
        let [earlier, present] = [0, 1].map(|_| Vec::with_capacity(EXAMINED_MAX));
        Self {
            frame: 0,
            place: Place::default(),
            earlier,
            present,
            rows: 0,
            off_m2: 0.0,
            offset_m: [0.0; 2],
            displaced: Tally::default(),
        }
    }

    /// Discards the count. The present place counts as the first one.
    pub fn clear(&mut self) {
        (self.offset_m, self.displaced) = ([0.0; 2], Tally::default());
    }

    /// Forgets the agents.
    pub fn end_session(&mut self) {
        self.earlier.clear();
        self.present.clear();
        (self.rows, self.offset_m) = (0, [0.0; 2]);
    }

    /// Adds a detection of a frame. The first [`EXAMINED_MAX`] of a frame are examined.
    pub fn detection(&mut self, frame: u64, stamp_ns: i64, detection: &Detection, place: Place) {
        if frame != self.frame {
            self.end_frame();
            (self.frame, self.place) = (frame, place);
        }
        self.rows += 1;
        if self.present.len() < EXAMINED_MAX {
            let position_m = [detection.x_m, detection.y_m].map(f64::from);
            self.present.push(Seen {
                id: detection.has(detection_flags::HAS_ID).then_some(detection.id),
                stamp_ns,
                position_m,
                motion: Motion::new(position_m),
                found_off_m: None,
            });
        }
    }

    /// The detections since a displacement, until a displacement back.
    pub const fn displaced(&self) -> Tally {
        self.displaced
    }

    fn end_frame(&mut self) {
        let Self { earlier, present, off_m2, .. } = self;
        let known = earlier.iter().filter(|seen| seen.motion.is_sure).count();
        let mut kept = 0;
        for seen in present.iter_mut() {
            let near = earlier.iter_mut().filter(|other| other.found_off_m.is_none());
            let near = near.filter_map(|other| Some((other.near_m(seen)?, other)));
            let Some((off_m, other)) = near.min_by(|(a_m, _), (b_m, _)| a_m.total_cmp(b_m)) else { continue };
            other.found_off_m = Some(off_m);
            kept += usize::from(other.motion.is_sure && off_m <= other.most_off_m(seen));
            if other.motion.is_sure {
                *off_m2 += OFF_WEIGHT * (off_m * off_m - *off_m2);
            }
            seen.motion = other.motion;
            if other.position_m == seen.position_m {
                // Possibly a repeated detection.
                seen.stamp_ns = other.stamp_ns;
            } else {
                seen.motion.advance(seen.position_m, other.since_s(seen));
            }
        }
        if known >= AGENTS_MIN
            && kept as f64 <= KEPT_MAX * known as f64
            && let Some(way_m) = self.displacement(known)
        {
            self.offset_m = [0, 1].map(|axis| self.offset_m[axis] + way_m[axis]);
            self.present.iter_mut().for_each(|seen| seen.motion = Motion::new(seen.position_m));
        }
        if length(self.offset_m) >= *JUMP_M.start() {
            self.displaced.add(self.rows, self.place);
        }
        std::mem::swap(&mut self.earlier, &mut self.present);
        self.present.clear();
        self.rows = 0;
    }

    /// The displacement that brings nearly all of the `known` agents to detections, if they are not only late.
    fn displacement(&self, known: usize) -> Option<[f64; 2]> {
        let moving = || self.earlier.iter().filter(|seen| seen.motion.is_sure);
        // Number of agents that these displacements bring to a detection.
        let brought = |way_m: &dyn Fn(&Seen) -> [f64; 2]| {
            let is_there = |from: &&Seen| {
                self.present.iter().any(|seen| {
                    let off_m = from.off_m(seen).map(|off_m| length(difference(off_m, way_m(from))));
                    off_m.is_some_and(|off_m| off_m <= from.most_off_m(seen))
                })
            };
            moving().filter(is_there).count()
        };
        let ways = moving().take(TRIED_MAX).flat_map(|from| {
            self.present.iter().filter_map(move |seen| {
                let off_m = from.off_m(seen)?;
                let least_m = (2.0 * from.most_off_m(seen)).max(OFF_RATIO * self.off_m2.sqrt());
                let is_jump = JUMP_M.contains(&length(off_m)) && length(off_m) >= least_m;
                is_jump.then_some((off_m, from))
            })
        });
        let counted = ways.clone().map(|(way_m, _)| (brought(&|_| way_m), way_m));
        let (count, way_m) = counted.max_by_key(|(count, _)| *count)?;
        let are_most = |count: usize| count >= AGENTS_MIN && count as f64 >= DISPLACED_MIN * known as f64;
        let is_kept = |seen: &&Seen| seen.found_off_m.is_some_and(|off_m| off_m <= 0.5 * length(way_m));
        let are_kept = moving().filter(is_kept).count() as f64 > KEPT_MAX * known as f64;
        // If the frame has a wrong stamp, each agent is displaced along its own velocity.
        let are_late = |(way_m, from): ([f64; 2], &Seen)| {
            let velocity_mps = from.motion.velocity_mps.unwrap_or_default();
            let late_s = dot(way_m, velocity_mps) / dot(velocity_mps, velocity_mps).max(f64::MIN_POSITIVE);
            let late_m = |seen: &Seen| seen.motion.velocity_mps.unwrap_or_default().map(|mps| mps * late_s);
            are_most(brought(&late_m))
        };
        (are_most(count) && !are_kept && !ways.clone().any(are_late)).then_some(way_m)
    }
}

impl Seen {
    fn since_s(&self, later: &Self) -> f64 {
        later.stamp_ns.saturating_sub(self.stamp_ns) as f64 * 1e-9
    }

    /// The way from the expected position to a later detection, if it may be of the same agent.
    fn off_m(&self, later: &Self) -> Option<[f64; 2]> {
        let elapsed_s = self.since_s(later);
        let is_next = self.id == later.id && elapsed_s > 0.0 && elapsed_s <= FRAMES_MAX_S;
        is_next.then(|| self.motion.off_m(later.position_m, elapsed_s))
    }

    /// The largest distance from a place that the agent should have reached by then.
    fn most_off_m(&self, later: &Self) -> f64 {
        OFF_M + OFF_MPS * self.since_s(later)
    }

    /// The distance from the expected position, if a later detection is of the same agent.
    fn near_m(&self, later: &Self) -> Option<f64> {
        let off_m = length(self.off_m(later)?);
        let most_m = match self.motion.velocity_mps {
            Some(velocity_mps) => {
                SLACK_M + (0.5 * length(velocity_mps)).max(CHANGE_MPS) * self.since_s(later)
            }
            None if self.id.is_some() => FIRST_STEP_MPS * self.since_s(later),
            None => FIRST_STEP_M,
        };
        (off_m <= most_m).then_some(off_m)
    }
}

fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

fn difference(to: [f64; 2], from: [f64; 2]) -> [f64; 2] {
    [to[0] - from[0], to[1] - from[1]]
}

fn length([x, y]: [f64; 2]) -> f64 {
    x.hypot(y)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Agents on lines 6 m apart for 20 s with these velocities in m/s. `offset_m` returns the displacement in a frame.
    fn displaced(rate_hz: u64, identities: bool, mps: &[f64], offset_m: impl Fn(u64) -> [f64; 2]) -> u64 {
        displaced_of((rate_hz, identities, 20), mps, |_| 0.15, offset_m)
    }

    /// The same for a number of seconds, with the noise of each frame.
    fn displaced_of(
        (rate_hz, identities, seconds): (u64, bool, u64),
        mps: &[f64],
        sigma_m: impl Fn(u64) -> f64,
        offset_m: impl Fn(u64) -> [f64; 2],
    ) -> u64 {
        let mut displacements = Displacements::new();
        for frame in 0..seconds * rate_hz {
            for (agent, speed_mps) in (0..).zip(mps) {
                let [x_m, y_m] = offset_m(frame);
                let noise_m = |axis: u64| sigma_m(frame) * normal(frame * 100 + agent * 2 + axis);
                let detection = Detection {
                    id: agent,
                    x_m: (x_m + speed_mps * frame as f64 / rate_hz as f64 + noise_m(0)) as f32,
                    y_m: (y_m + 6.0 * agent as f64 + noise_m(1)) as f32,
                    flags: if identities { detection_flags::HAS_ID } else { 0 },
                    ..Detection::default()
                };
                let stamp_ns = (frame * 1_000_000_000 / rate_hz) as i64;
                displacements.detection(frame, stamp_ns, &detection, Place::default());
            }
        }
        displacements.displaced().rows
    }

    /// A number with mean 0 and variance 1: the sum of twelve numbers between -0.5 and 0.5.
    fn normal(seed: u64) -> f64 {
        let uniform = |nth: u64| {
            let bits = (seed * 12 + nth + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            let bits = (bits ^ (bits >> 31)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            (bits >> 40) as f64 / (1_u64 << 24) as f64 - 0.5
        };
        (0..12).map(uniform).sum()
    }

    #[test]
    fn a_jump_of_all_agents_is_found_until_it_goes_back() {
        let mps = [9.0, 7.0, 4.0, 1.4];
        for (rate_hz, identities) in [(10, false), (10, true), (2, false), (2, true)] {
            for jump_m in [[5.0, 0.0], [0.0, -5.0], [3.0, 2.0], [-20.0, 30.0]] {
                let name = format!("{rate_hz} Hz, {identities}, {jump_m:?}");
                let once = |frame| if frame >= 10 * rate_hz { jump_m } else { [0.0; 2] };
                let rows = displaced(rate_hz, identities, &mps, once);
                assert_eq!(rows, 4 * (10 * rate_hz - 1), "{name}: the last frame has not ended");
                let there = 10 * rate_hz..14 * rate_hz;
                let back = |frame| if there.contains(&frame) { jump_m } else { [0.0; 2] };
                assert_eq!(displaced(rate_hz, identities, &mps, back), 16 * rate_hz, "{name}");
            }
        }
        // At 2 Hz, only identities join places 10 m apart.
        let fast = [20.0, 15.0, 12.0, -13.0];
        assert_eq!(displaced(2, true, &fast, |frame| if frame >= 20 { [3.0, 4.0] } else { [0.0; 2] }), 76);
    }

    #[test]
    fn steady_agents_and_late_frames_are_no_jump() {
        for identities in [false, true] {
            for rate_hz in [2, 10] {
                assert_eq!(displaced(rate_hz, identities, &[9.0, 7.0, 4.0, 1.4], |_| [0.0; 2]), 0);
            }
            // A convoy whose frames have wrong stamps.
            let late = |frame| if frame % 20 == 10 { [3.0, 0.0] } else { [0.0; 2] };
            assert_eq!(displaced(10, identities, &[15.0; 4], late), 0);
        }
    }
    #[test]
    fn noise_is_no_jump() {
        for (name, sigma_m) in [
            ("one sensor", (|_| 0.5) as fn(u64) -> f64),
            ("a good and a bad sensor in turn", |frame| if frame % 2 == 0 { 0.05 } else { 0.5 }),
        ] {
            for mps in [&[9.0, 7.0, 4.0][..], &[8.0; 5]] {
                let rows = displaced_of((10, true, 300), mps, sigma_m, |_| [0.0; 2]);
                assert_eq!(rows, 0, "{name}, {mps:?}");
            }
        }
    }
}
