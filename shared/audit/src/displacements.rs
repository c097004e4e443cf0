//! Displacements of all agents at once, as a localisation that jumps causes them.
//!
//! Agents are followed from frame to frame by their positions. If nearly no agent is near its expected position, but one
//! displacement brings nearly all of them to a detection, the frame of the positions has moved.

use wire::{Detection, detection_flags};

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
/// Shortest and longest displacement, and distance from it.
const JUMP_M: std::ops::RangeInclusive<f64> = 1.0..=50.0;
const OFF_M: f64 = 0.5;
/// Largest distance of the first step, and from the expected position: a part and a change of the speed in a second.
const FIRST_STEP_M: f64 = 4.0;
const SLACK_M: f64 = 0.5;
const CHANGE_MPS: f64 = 3.0;
/// Agents at one velocity are displaced along it if a stamp is wrong.
const SPREAD_MPS: f64 = 1.0;

/// A detection of a frame.
#[derive(Clone, Copy, Debug)]
struct Seen {
    id: Option<u64>,
    stamp_ns: i64,
    position_m: [f64; 2],
    /// From the previous frame, if the agent was found in it.
    velocity_mps: Option<[f64; 2]>,
    is_taken: bool,
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
            self.present.push(Seen {
                id: detection.has(detection_flags::HAS_ID).then_some(detection.id),
                stamp_ns,
                position_m: [detection.x_m, detection.y_m].map(f64::from),
                velocity_mps: None,
                is_taken: false,
            });
        }
    }

    /// The detections since a displacement, until a displacement back.
    pub const fn displaced(&self) -> Tally {
        self.displaced
    }

    fn end_frame(&mut self) {
        let Self { earlier, present, .. } = self;
        let known = earlier.iter().filter(|seen| seen.velocity_mps.is_some()).count();
        let mut kept = 0;
        for seen in present.iter_mut() {
            let near = earlier.iter_mut().filter(|other| !other.is_taken);
            let near = near.filter_map(|other| Some((other.near_m(seen)?, other)));
            let Some((_, other)) = near.min_by(|(a_m, _), (b_m, _)| a_m.total_cmp(b_m)) else { continue };
            other.is_taken = true;
            kept += usize::from(other.velocity_mps.is_some());
            if other.position_m == seen.position_m {
                // Possibly a repeated detection.
                (seen.stamp_ns, seen.velocity_mps) = (other.stamp_ns, other.velocity_mps);
            } else {
                let elapsed_s = other.since_s(seen);
                seen.velocity_mps =
                    Some(difference(seen.position_m, other.position_m).map(|m| m / elapsed_s));
            }
        }
        if known >= AGENTS_MIN
            && kept as f64 <= KEPT_MAX * known as f64
            && let Some(way_m) = self.displacement(known)
        {
            self.offset_m = [0, 1].map(|axis| self.offset_m[axis] + way_m[axis]);
        }
        if length(self.offset_m) >= *JUMP_M.start() {
            self.displaced.add(self.rows, self.place);
        }
        std::mem::swap(&mut self.earlier, &mut self.present);
        self.present.clear();
        self.rows = 0;
    }

    /// The displacement that brings nearly all of the `known` agents to detections.
    fn displacement(&self, known: usize) -> Option<[f64; 2]> {
        let moving = || self.earlier.iter().filter(|seen| seen.velocity_mps.is_some());
        let brought = |way_m: [f64; 2]| {
            let is_there = |from: &&Seen| {
                self.present.iter().any(|seen| {
                    from.is_same(seen)
                        && from.off_m(seen).is_some_and(|off_m| length(difference(off_m, way_m)) <= OFF_M)
                })
            };
            moving().filter(is_there).count()
        };
        let ways = moving().take(TRIED_MAX).flat_map(|from| {
            let seen = self.present.iter().filter(|seen| from.is_same(seen));
            seen.filter_map(|seen| from.off_m(seen)).filter(|off_m| JUMP_M.contains(&length(*off_m)))
        });
        let (count, way_m) = ways.map(|way_m| (brought(way_m), way_m)).max_by_key(|(count, _)| *count)?;
        let is_found = count >= AGENTS_MIN && count as f64 >= DISPLACED_MIN * known as f64;
        (is_found && !self.is_late(way_m)).then_some(way_m)
    }

    /// Whether all agents have one velocity, and the displacement is along it.
    fn is_late(&self, way_m: [f64; 2]) -> bool {
        let mut velocities = self.earlier.iter().filter_map(|seen| seen.velocity_mps);
        let Some(first @ [x_mps, y_mps]) = velocities.next() else { return false };
        let across_m = (way_m[0] * y_mps - way_m[1] * x_mps).abs() / length(first).max(f64::MIN_POSITIVE);
        across_m < *JUMP_M.start() && velocities.all(|other| length(difference(other, first)) < SPREAD_MPS)
    }
}

impl Seen {
    fn since_s(&self, later: &Self) -> f64 {
        later.stamp_ns.saturating_sub(self.stamp_ns) as f64 * 1e-9
    }

    fn is_same(&self, later: &Self) -> bool {
        self.id == later.id
    }

    /// The way from the expected position to a later detection.
    fn off_m(&self, later: &Self) -> Option<[f64; 2]> {
        let elapsed_s = self.since_s(later);
        let [x_mps, y_mps] = self.velocity_mps.unwrap_or_default();
        let [x_m, y_m] = difference(later.position_m, self.position_m);
        let is_next = elapsed_s > 0.0 && elapsed_s <= FRAMES_MAX_S;
        is_next.then_some([x_m - x_mps * elapsed_s, y_m - y_mps * elapsed_s])
    }

    /// The distance from the expected position, if a later detection is of the same agent.
    fn near_m(&self, later: &Self) -> Option<f64> {
        let off_m = length(self.off_m(later)?);
        let most_m = match self.velocity_mps {
            Some(velocity_mps) => {
                SLACK_M + (0.5 * length(velocity_mps)).max(CHANGE_MPS) * self.since_s(later)
            }
            None => FIRST_STEP_M,
        };
        (self.is_same(later) && off_m <= most_m).then_some(off_m)
    }
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

    /// Four agents for 20 s at 10 Hz with these velocities in m/s. `offset_m` returns the displacement in a frame.
    fn displaced(identities: bool, mps: [f64; 4], offset_m: impl Fn(u64) -> [f64; 2]) -> u64 {
        let mut displacements = Displacements::new();
        for frame in 0..200 {
            for (agent, speed_mps) in (0..).zip(mps) {
                let [x_m, y_m] = offset_m(frame);
                let detection = Detection {
                    id: agent,
                    x_m: (x_m + speed_mps * frame as f64 / 10.0) as f32,
                    y_m: (y_m + 6.0 * agent as f64) as f32,
                    flags: if identities { detection_flags::HAS_ID } else { 0 },
                    ..Detection::default()
                };
                displacements.detection(frame, frame as i64 * 100_000_000, &detection, Place::default());
            }
        }
        displacements.displaced().rows
    }

    #[test]
    fn a_jump_of_all_agents_is_found_until_it_goes_back() {
        let mps = [9.0, 7.0, 4.0, 1.4];
        for identities in [false, true] {
            for jump_m in [[5.0, 0.0], [0.0, -5.0], [2.0, 1.0], [-20.0, 30.0]] {
                let once = |frame| if frame >= 100 { jump_m } else { [0.0; 2] };
                let rows = displaced(identities, mps, once);
                assert_eq!(rows, 4 * 99, "{identities} {jump_m:?}: the last frame has not ended");
                let back = |frame| if (100..110).contains(&frame) { jump_m } else { [0.0; 2] };
                assert_eq!(displaced(identities, mps, back), 40, "{identities} {jump_m:?}");
            }
        }
    }

    #[test]
    fn steady_agents_and_late_frames_are_no_jump() {
        for identities in [false, true] {
            assert_eq!(displaced(identities, [9.0, 7.0, 4.0, 1.4], |_| [0.0; 2]), 0);
            // A convoy whose frames have wrong stamps.
            let late = |frame| if frame % 20 == 10 { [3.0, 0.0] } else { [0.0; 2] };
            assert_eq!(displaced(identities, [15.0; 4], late), 0);
        }
    }
}
