//! Detectors that are slower than the frames: their detections are sent again.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use tracker::{Prior, TrackerOptions};
use wire::{AgentType, Detection, Header, Track, TrackStatus, detection_flags, flags};

use crate::support::harness::{Harness, detected_at, noise};

/// Frames of 10 Hz.
const TICK_S: f64 = 0.1;
const FRAMES: usize = 120;
const SPEEDS_MPS: [f64; 2] = [10.0, 8.0];

#[derive(Clone, Copy, Debug)]
struct Source {
    /// Frames for which each agent's detection is sent.
    held: [usize; 2],
    identities: u32,
    /// Whether detections contain heading and speed, and a deviation of their own.
    is_full: bool,
    sigma_m: f64,
}

impl Source {
    /// An agent's detection, made in that frame.
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

    /// Plays the source, each detection as often as it is held or once; root mean square error of 4.8 s at the
    /// published velocity, in the frames in which all detections are new, and how often tracks were repeated.
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
            if frame % slowest == 0 {
                for (track, speed_mps) in tracks.iter().zip(SPEEDS_MPS) {
                    assert_eq!(track.status, TrackStatus::Confirmed as u32, "{self:?}: frame {frame}");
                    sum += (4.8 * (f64::from(track.vx_mps) - speed_mps)).powi(2)
                        + (4.8 * f64::from(track.vy_mps)).powi(2);
                    len += 1;
                }
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
                    // Frames with a part of the agents count as misses of the others.
                    continue;
                }
                let (own_m, _) = source.error_m(false);
                let (again_m, repeated) = source.error_m(true);
                assert!(again_m < 1.1 * own_m + 0.01, "{source:?}: {again_m} m, at its own rate {own_m} m");
                let expected = held.map(|held| (FRAMES - FRAMES.div_ceil(held)) as u32).iter().sum::<u32>();
                assert!(repeated.abs_diff(expected) <= 2, "{source:?}: {repeated} of {expected}");
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
            // It brakes by 3 m/s² from 6 m/s, and rests from 2 s on.
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
