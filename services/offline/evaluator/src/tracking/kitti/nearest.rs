use data::Recording;
use filters::{ConstantVelocity, Gaussian, Observation};
use wire::{AgentType, Detection};

use super::{ByClass, CLASSES, Published, PublishedTrack};
use crate::matching::nearest_pairs;

/// Standard deviation of a detection's position per axis, m.
const SIGMA_M: f64 = 0.25;
/// Standard deviation of a velocity before any measurement, m/s, by class.
const SPEED_MPS: ByClass<f64> = [10.0, 2.0, 5.0];
/// Density of the acceleration, m²/s³, by class.
const DENSITY: ByClass<f64> = [4.0, 0.5, 2.0];
/// Maximum distance between a track and its detection, m, by class.
const NEAR_M: ByClass<f64> = [3.0, 1.0, 2.0];
/// Detections that confirm a track.
const HITS_TO_CONFIRM: u32 = 3;
/// A track ends with its third frame in a row without a detection.
const MISSES_MAX: u32 = 2;

struct Target {
    id: u64,
    state: Gaussian<4>,
    hit_count: u32,
    miss_count: u32,
}

/// The baseline: a constant-velocity Kalman filter per track, nearest-neighbour assignment starting with the
/// nearest pairs, and fixed numbers of hits and misses.
pub(crate) fn nearest_neighbours(recording: &Recording) -> Published {
    let mut published = vec![Vec::new(); recording.frames.len()];
    let mut next_id = 1;
    for (class, agent_type) in CLASSES.into_iter().enumerate() {
        let process = ConstantVelocity { density: DENSITY[class] };
        let mut targets: Vec<Target> = Vec::new();
        let mut last_ns = None;
        for (frame, tracks) in recording.frames.iter().zip(&mut published) {
            let elapsed_ns = last_ns.replace(frame.stamp_ns).map_or(0, |last_ns| frame.stamp_ns - last_ns);
            // A target whose prediction fails is dropped. This can't happen within a recording's duration.
            targets.retain_mut(|target| target.state.predict(elapsed_ns.unsigned_abs(), &process).is_ok());
            let of_class = |detection: &&Detection| detection.agent_type == agent_type as u32;
            let seen: Vec<Observation> = frame.detections.iter().filter(of_class).map(observation).collect();
            let apart_m = |t: usize, d: usize| {
                let ([x, y], [seen_x, seen_y]) = (targets[t].position_m(), seen[d].position_m);
                Some((seen_x - x).hypot(seen_y - y)).filter(|apart_m| *apart_m <= NEAR_M[class])
            };
            let paired = nearest_pairs([targets.len(), seen.len()], apart_m);
            for (t, target) in targets.iter_mut().enumerate() {
                match paired.iter().find(|pair| pair.0 == t) {
                    Some(&(_, d)) => target.take(&seen[d], &process),
                    None => target.miss_count += 1,
                }
            }
            targets.retain(|target| target.miss_count <= MISSES_MAX);
            let alone = (0..seen.len()).filter(|&d| paired.iter().all(|pair| pair.1 != d));
            for (id, d) in (next_id..).zip(alone) {
                targets.push(Target::new(id, &seen[d], SPEED_MPS[class]));
                next_id = id + 1;
            }
            let confirmed = targets.iter().filter(|target| target.hit_count >= HITS_TO_CONFIRM);
            tracks.extend(confirmed.map(|target| target.published(agent_type)));
        }
    }
    published
}

fn observation(detection: &Detection) -> Observation {
    Observation::of_position([detection.x_m, detection.y_m].map(f64::from), SIGMA_M * SIGMA_M)
}

impl Target {
    fn new(id: u64, seen: &Observation, speed_mps: f64) -> Self {
        let [x, y] = seen.position_m;
        let [place, motion] = [seen.position_variance, speed_mps * speed_mps];
        let state = Gaussian::new([x, y, 0.0, 0.0], [place, place, motion, motion]);
        Self { id, state, hit_count: 1, miss_count: 0 }
    }

    fn take(&mut self, seen: &Observation, process: &ConstantVelocity) {
        self.miss_count = 0;
        // If the filter can't use a detection, the prediction remains.
        self.hit_count += u32::from(self.state.update(seen, process).is_ok());
    }

    fn position_m(&self) -> [f64; 2] {
        [self.state.mean[0], self.state.mean[1]]
    }

    fn published(&self, agent_type: AgentType) -> PublishedTrack {
        PublishedTrack { id: self.id, agent_type, position_m: self.position_m() }
    }
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;
    use data::Frame;

    use super::*;

    const INTERVAL_NS: i64 = 100_000_000;

    /// Two cars that drive side by side, 4 m apart. `seen` selects the cars that a frame contains.
    fn recording(frames_len: i64, seen: impl Fn(i64, u32) -> bool) -> Recording {
        let car = |frame: i64, lane: u32| Detection {
            x_m: frame as f32,
            y_m: 4.0 * lane as f32,
            agent_type: AgentType::Vehicle as u32,
            ..Detection::zeroed()
        };
        let frames = (0..frames_len).map(|frame| Frame {
            stamp_ns: frame * INTERVAL_NS,
            detections: (0..2).filter(|&lane| seen(frame, lane)).map(|lane| car(frame, lane)).collect(),
            ..Frame::default()
        });
        Recording {
            interval_ns: INTERVAL_NS.unsigned_abs(),
            frames: frames.collect(),
            ..Recording::default()
        }
    }

    fn ids(tracks: &[PublishedTrack]) -> Vec<u64> {
        tracks.iter().map(|track| track.id).collect()
    }

    #[test]
    fn three_hits_confirm_a_track_and_it_bridges_two_misses() {
        let published =
            nearest_neighbours(&recording(20, |frame, lane| lane == 0 || ![8, 9].contains(&frame)));
        assert!(published[1].is_empty());
        assert!(published[2..].iter().all(|tracks| ids(tracks) == [1, 2]), "{published:?}");
        let error_m = published[19][0].position_m[0] - 19.0;
        assert!(error_m.abs() < 0.1, "{error_m}");
    }

    #[test]
    fn a_third_miss_ends_a_track_and_its_id_is_not_reused() {
        let published =
            nearest_neighbours(&recording(20, |frame, lane| lane == 0 || !(8..11).contains(&frame)));
        assert_eq!(ids(&published[9]), [1, 2]);
        assert_eq!(ids(&published[10]), [1]);
        assert_eq!(ids(&published[19]), [1, 3]);
    }
}
