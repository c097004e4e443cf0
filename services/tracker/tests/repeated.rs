//! Detectors that are slower than the frames: their detections are sent again.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use tracker::{Prior, TrackerOptions};
use wire::{AgentType, Detection, Header, Track, TrackStatus, detection_flags, flags};

use crate::support::harness::{Harness, detected_at, noise};

/// Interval of frames at 10 Hz.
const TICK_S: f64 = 0.1;
const FRAMES: usize = 120;
const SPEEDS_MPS: [f64; 2] = [10.0, 8.0];

#[derive(Clone, Copy, Debug)]
struct Source {
    /// Number of frames for which each agent's detection is sent.
    held: [usize; 2],
    identities: u32,
    /// Whether detections contain heading, speed and standard deviation.
    is_full: bool,
    sigma_m: f64,
}

impl Source {
    /// An agent's detection, made in this frame.
    fn detect(&self, agent: usize, frame: usize, rng: &mut ChaCha8Rng) -> Detection {
        let x_m = SPEEDS_MPS[agent] * TICK_S * frame as f64 + noise(rng, self.sigma_m);
        let y_m = 6.0 * agent as f64 + noise(rng, self.sigma_m);
        let position = detected_at(AgentType::Vehicle, agent as u64 + 1, x_m, y_m);
        if !self.is_full {
            return position;
        }
        let flags = position.flags | detection_flags::HAS_SPEED | detection_flags::HAS_HEADING;
        let speed_mps = (SPEEDS_MPS[agent] + noise(rng, 0.1)) as f32;
        Detection { speed_mps, sigma_m: self.sigma_m as f32, flags, ..position }
    }

    /// Plays the source and sends each detection once or for as long as it is held. Returns the root mean
    /// square error of the positions predicted 4.8 s ahead with the published velocity, over all frames, and
    /// the number of repetitions.
    fn error_m(&self, is_sent_again: bool) -> (f64, u32) {
        let options = TrackerOptions { prior: Prior::Kinematic, ..TrackerOptions::default() };
        let mut run = Harness::new(options, self.identities);
        run.tick_ns = 100_000_000;
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        let mut last: [Option<Detection>; 2] = [None; 2];
        let (mut sum, mut len) = (0.0, 0);
        let slowest = self.held[0].max(self.held[1]);
        for frame in 0..FRAMES {
            let mut seen = Vec::new();
            for (agent, last) in last.iter_mut().enumerate() {
                let is_new = frame % self.held[agent] == 0;
                if is_new {
                    *last = Some(self.detect(agent, frame, &mut rng));
                }
                seen.extend(last.filter(|_| is_new || is_sent_again));
            }
            // At its own rate the source sends no other frames.
            if seen.is_empty() {
                run.stamp_ns += run.tick_ns;
                continue;
            }
            let tracks: Vec<Track> = run.step(&seen).to_vec();
            if frame < 40 {
                continue;
            }
            assert_eq!(tracks.len(), 2, "{self:?}: frame {frame}");
            // If each detection is sent once, only the slower agent's frames count. It is missed in the
            // others.
            if !is_sent_again && frame % slowest != 0 {
                continue;
            }
            for ((agent, track), speed_mps) in (0..).zip(&tracks).zip(SPEEDS_MPS) {
                assert_eq!(track.status, TrackStatus::Confirmed as u32, "{self:?}: frame {frame}");
                let ahead_m = [(track.x_m, track.vx_mps), (track.y_m, track.vy_mps)]
                    .map(|(position_m, velocity_mps)| f64::from(position_m) + 4.8 * f64::from(velocity_mps));
                let x_m = speed_mps * (TICK_S * frame as f64 + 4.8);
                sum += (ahead_m[0] - x_m).powi(2) + (ahead_m[1] - 6.0 * f64::from(agent)).powi(2);
                len += 1;
            }
        }
        ((sum / f64::from(len)).sqrt(), run.tracker.header(&Header::new(1, 0, 0)).input.repeated)
    }
}

#[test]
fn a_detector_that_is_sent_again_is_as_good_as_at_its_own_rate() {
    for held in [[2, 2], [3, 3], [4, 4], [1, 2], [1, 4]] {
        for identities in [0, flags::HAS_IDENTITIES] {
            for (is_full, sigma_m) in [(false, 0.03), (true, 0.03), (true, 0.2), (false, 0.1)] {
                let source = Source { held, identities, is_full, sigma_m };
                if held[0] != held[1] && identities == 0 {
                    // Frames with only some agents count as misses of the others.
                    continue;
                }
                let (own_m, _) = source.error_m(false);
                let (again_m, repeated) = source.error_m(true);
                assert!(again_m < 1.2 * own_m + 0.05, "{source:?}: {again_m} m, at its own rate {own_m} m");
                let expected = held.map(|held| (FRAMES - FRAMES.div_ceil(held)) as u32).iter().sum::<u32>();
                assert!(repeated.abs_diff(expected) <= 2, "{source:?}: {repeated} of {expected}");
            }
        }
    }
}

/// Root mean square error of the positions predicted 4.8 s ahead with the published velocity, over all
/// frames. The car is either parked or drives at 8 m/s on a circle of 40 m.
fn error_of(is_parked: bool, held: usize, is_sent_again: bool, identities: u32) -> f64 {
    let options = TrackerOptions { prior: Prior::Kinematic, ..TrackerOptions::default() };
    let mut run = Harness::new(options, identities);
    run.tick_ns = 100_000_000;
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let (mut last, mut sum, mut len) = (None, 0.0, 0);
    for frame in 0..300 {
        let angle = if is_parked { 0.0 } else { 0.2 * TICK_S * frame as f64 };
        let (sin, cos) = angle.sin_cos();
        if frame % held == 0 {
            let (x_m, y_m) = (40.0 * sin + noise(&mut rng, 0.03), 40.0 * (1.0 - cos) + noise(&mut rng, 0.03));
            last = Some(detected_at(AgentType::Vehicle, 1, x_m, y_m));
        } else if !is_sent_again {
            run.stamp_ns += run.tick_ns;
            continue;
        }
        let tracks = run.step(last.as_slice());
        if frame >= 100 {
            let [track] = tracks else { panic!("frame {frame}: {} tracks", tracks.len()) };
            let velocity_mps = if is_parked { [0.0; 2] } else { [8.0 * cos, 8.0 * sin] };
            let off_mps = [track.vx_mps, track.vy_mps].map(f64::from);
            sum += (4.8 * (off_mps[0] - velocity_mps[0])).powi(2)
                + (4.8 * (off_mps[1] - velocity_mps[1])).powi(2);
            len += 1;
        }
    }
    (sum / f64::from(len)).sqrt()
}

#[test]
fn a_turn_goes_on_and_a_parked_agent_rests_between_measurements() {
    for is_parked in [false, true] {
        for held in [2, 3, 4] {
            for identities in [0, flags::HAS_IDENTITIES] {
                let error_m = |is_sent_again| error_of(is_parked, held, is_sent_again, identities);
                let (own_m, again_m) = (error_m(false), error_m(true));
                let what = format!("parked {is_parked}, held {held}, {identities}");
                assert!(again_m < 1.2 * own_m + 0.05, "{what}: {again_m} m, at its own rate {own_m} m");
            }
        }
    }
}

#[test]
fn a_parked_agent_may_repeat_itself_and_one_that_stops_is_followed() {
    for identities in [0, flags::HAS_IDENTITIES] {
        let mut run = Harness::new(TrackerOptions::default(), identities);
        run.tick_ns = 100_000_000;
        for frame in 0..80 {
            let parked = detected_at(AgentType::Vehicle, 1, 20.0, 9.0);
            // It brakes at 3 m/s² from 6 m/s and rests from 2 s on.
            let t_s = (TICK_S * f64::from(frame)).min(2.0);
            let x_m = 6.0 * t_s - 1.5 * t_s * t_s;
            let tracks = run.step(&[parked, detected_at(AgentType::Vehicle, 2, x_m, 0.0)]);
            if frame < 8 {
                continue;
            }
            assert_eq!(tracks.len(), 2, "frame {frame}");
            for track in tracks {
                assert_eq!(track.status, TrackStatus::Confirmed as u32, "frame {frame}");
                let at_m = if track.y_m > 5.0 { 20.0 } else { x_m };
                assert!((f64::from(track.x_m) - at_m).abs() < 0.3, "frame {frame}: {track:?}");
            }
        }
        assert!(run.published().iter().all(|track| track.speed_mps.abs() < 0.05));
    }
}
