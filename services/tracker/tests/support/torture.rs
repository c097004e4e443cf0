//! A tracker under random frames that no sensor should send and random forecasts that no model should make.

use std::collections::BTreeMap;

use bytemuck::Zeroable;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tracker::{Association, Prior, Tracker, TrackerOptions};
use wire::{AGENTS_MAX, DETECTIONS_MAX, Detection, Forecast, Header, Quality, SENSORS_MAX, Track, flags};

const AGENTS: usize = 30;
const TICK_NS: i64 = 80_000_000;
/// Numbers that must never get from a frame into a track.
const BAD: [f32; 6] = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, 1e12, -1e9];
/// Extreme but possible numbers.
const EXTREME: [f32; 6] = [0.0, 1e-38, 1e-12, 1e-3, 1e3, 1e6];

/// Results of a tracker under random frames.
#[derive(Debug, Default)]
pub struct Survived {
    pub published_count: usize,
    /// Published tracks with a forecast as the prior.
    pub learned_count: usize,
    pub fault_count: usize,
    /// Out-of-sequence frames that were processed.
    pub out_of_sequence_count: u64,
    /// Number of refused frames, by reason.
    pub refused: BTreeMap<String, usize>,
    /// Memory of the process in KiB at each fifth of the frames, if the system reports it.
    pub resident_kib: Vec<usize>,
}

/// Steps a tracker through random frames and forecasts. Asserts that every published track is sound.
pub fn torture(prior: Prior, association: Association, seed: u64, tick_count: usize) -> Survived {
    let mut torture = Torture::new(seed);
    let options = TrackerOptions { prior, association, ..TrackerOptions::default() };
    let mut tracker = Tracker::new(options);
    let mut out = vec![Track::zeroed(); AGENTS_MAX];
    let mut track_count = 0;
    let mut survived = Survived::default();
    for tick in 0..tick_count {
        if tick % (tick_count / 5) == 0 {
            survived.resident_kib.extend(resident_kib());
        }
        let forecast = torture.forecast(&out[..track_count]);
        let header = torture.frame();
        let given = Some((&forecast, &torture.forecasts[..]));
        let tracked = match tracker.step(&header, &torture.detections, given, &mut out) {
            Ok(tracked) => tracked,
            Err(rejected) => {
                let reason = format!("{rejected:?}");
                let name = reason.split([' ', '{']).next().unwrap_or_default();
                *survived.refused.entry(name.into()).or_default() += 1;
                continue;
            }
        };
        assert!(
            tracked.replayed_count == 0 || tracked.track_count == 0,
            "{prior:?}, tick {tick}: {tracked:?}"
        );
        track_count = tracked.track_count;
        assert!(tracked.held_count <= options.tracks_max, "{prior:?}, tick {tick}: {tracked:?}");
        for track in &out[..track_count] {
            assert_eq!(track.check(), Ok(()), "{prior:?}, tick {tick}: {track:?}");
            assert_eq!(fault(track), None, "{prior:?}, tick {tick}: {track:?}");
            survived.learned_count += usize::from(track.prior == Quality::Learned as u32);
        }
        survived.fault_count += tracked.fault_count;
        survived.published_count += track_count;
    }
    survived.out_of_sequence_count = tracker.tally().out_of_sequence_count;
    survived
}

fn resident_kib() -> Option<usize> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmRSS:"))?;
    line.split_ascii_whitespace().nth(1)?.parse().ok()
}

/// A sensor and a forecaster with arbitrary output.
struct Torture {
    rng: ChaCha8Rng,
    stamp_ns: i64,
    agents: Vec<Detection>,
    detections: Vec<Detection>,
    forecasts: Vec<Forecast>,
}

impl Torture {
    fn new(seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let agents = (0..AGENTS as u64).map(|id| Detection { id, ..any(&mut rng) }).collect();
        Self { rng, stamp_ns: 0, agents, detections: Vec::new(), forecasts: Vec::new() }
    }

    /// Makes the detections of the next frame and returns its header.
    fn frame(&mut self) -> Header {
        let rng = &mut self.rng;
        let mut late_ns = 0;
        self.stamp_ns += match rng.random_range(0..100) {
            0..80 => TICK_NS,
            80..84 => 0,
            84..90 => {
                late_ns = rng.random_range(1..1_000_000_000);
                0
            }
            90..91 => -rng.random_range(1..2_000_000_000),
            91..95 => rng.random_range(1..1_000),
            95..99 => rng.random_range(1..10_000_000_000),
            _ => rng.random_range(1..10_000_000_000_000),
        };
        for agent in &mut self.agents {
            if rng.random_ratio(1, 100) {
                *agent = Detection { id: agent.id, ..any(rng) };
            }
            agent.x_m += agent.heading_rad.cos() * 0.5 + rng.random_range(-0.1..0.1);
            agent.y_m += agent.heading_rad.sin() * 0.5 + rng.random_range(-0.1..0.1);
        }
        self.detections.clear();
        match rng.random_range(0..100) {
            0..5 => {}
            5..10 => {
                let point = any(rng);
                let apart = *[0.0, 1e-3, 0.3].choose(rng).expect("some");
                self.detections.extend((0..500).map(|id| Detection {
                    id,
                    x_m: point.x_m + apart * rng.random_range(-1.0..1.0_f32),
                    y_m: point.y_m + apart * rng.random_range(-1.0..1.0_f32),
                    ..point
                }));
            }
            10..12 => self.detections.resize_with(rng.random_range(0..DETECTIONS_MAX + 9), || any(rng)),
            _ => self.detections.extend(self.agents.iter().filter(|_| rng.random_ratio(9, 10))),
        }
        if rng.random_ratio(1, 20)
            && let Some(detection) = self.detections.first_mut()
        {
            spoil(detection, rng);
        }
        if rng.random_ratio(1, 20)
            && let Some(&twice) = self.detections.first()
        {
            self.detections.push(twice);
        }
        Header {
            flags: [0, flags::HAS_IDENTITIES, flags::SEEN_FROM_EGO, flags::SEEN_FROM_EGO, 0]
                [rng.random_range(0..5)],
            observed_types: if rng.random_ratio(9, 10) { 0b111 } else { rng.random_range(0..8) },
            ego_m: match rng.random_range(0..100) {
                0 => [0.0, f32::NAN],
                1..30 => self.agents.choose(rng).map_or([0.0; 2], |agent| [agent.x_m, agent.y_m]),
                _ => [0.0; 2],
            },
            ..Header::new(1, 0, self.stamp_ns - late_ns)
        }
    }

    /// Makes forecasts of some tracks, and of some that never existed. Returns their header.
    fn forecast(&mut self, tracks: &[Track]) -> Header {
        let rng = &mut self.rng;
        self.forecasts.clear();
        for track in tracks {
            if rng.random_ratio(1, 10) {
                continue;
            }
            let mut forecast = Forecast {
                id: track.id,
                agent_type: track.agent_type,
                age_ns: if rng.random_ratio(1, 10) { rng.random() } else { 0 },
                modes_len: if rng.random_ratio(1, 50) { rng.random() } else { rng.random_range(0..=20) },
                steering: if track.state_len == 5 { 1 } else { 2 },
                frame_heading_rad: track.heading_rad,
                probability: std::array::from_fn(|_| rng.random_range(0.0..1.0)),
                ..Forecast::zeroed()
            };
            let scale = if rng.random_ratio(1, 20) { 1e3 } else { 1.0 };
            for control in forecast.controls.as_flattened_mut() {
                control.mean = std::array::from_fn(|_| scale * rng.random_range(-0.5..0.5));
                control.cholesky =
                    [scale * rng.random_range(0.0..0.3), 0.0, scale * rng.random_range(0.0..0.3)];
            }
            if rng.random_ratio(1, 20) {
                forecast.controls[0][0].mean[0] = *BAD.choose(rng).expect("some");
            }
            if rng.random_ratio(1, 20) {
                forecast.id = rng.random();
                forecast.steering = rng.random_range(0..9);
            }
            self.forecasts.push(forecast);
        }
        let mut header = Header { step_ns: 400_000_000, ..Header::new(1, 0, self.stamp_ns) };
        header.counts.horizon_len = 12;
        header
    }
}

/// Any possible detection, usually near the origin.
fn any(rng: &mut ChaCha8Rng) -> Detection {
    let side = if rng.random_ratio(1, 20) { 32_000.0 } else { 40.0 };
    let id = rng.random_range(0..100);
    Detection {
        id,
        sensor: (id % (SENSORS_MAX as u64 + 1)) as u8,
        x_m: rng.random_range(-side..side),
        y_m: rng.random_range(-side..side),
        heading_rad: rng.random_range(-4.0..4.0),
        speed_mps: rng.random_range(-120.0..120.0),
        length_m: rng.random_range(0.0..20.0),
        width_m: rng.random_range(0.0..3.0),
        score: 1.0,
        sigma_m: if rng.random_ratio(1, 2) { 0.0 } else { *EXTREME.choose(rng).expect("some") },
        agent_type: rng.random_range(0..3),
        flags: rng.random_range(0..16),
        ..Detection::default()
    }
}

/// Makes one number of a detection impossible, or extreme.
fn spoil(detection: &mut Detection, rng: &mut ChaCha8Rng) {
    let value = *BAD.choose(rng).expect("some");
    match rng.random_range(0..7) {
        0 => detection.x_m = value,
        1 => detection.y_m = value,
        2 => detection.heading_rad = value,
        3 => detection.speed_mps = value,
        4 => detection.length_m = value,
        5 => detection.sigma_m = value,
        _ => detection.agent_type = rng.random(),
    }
}

/// The fault of a track's covariance. It must be symmetric to the bit, and positive up to the rounding of an
/// f32.
fn fault(track: &Track) -> Option<&'static str> {
    let n = track.state_len as usize;
    let entry = |i: usize, j: usize| f64::from(track.covariance[i * 5 + j]);
    let entry =
        |i: usize, j: usize| if n == 5 { entry(i, j) } else { f64::from(track.covariance[i * 4 + j]) };
    let mut factor = [[0.0; 5]; 5];
    for i in 0..n {
        if entry(i, i) <= 0.0 {
            return Some("a variance that is not positive");
        }
        for j in 0..=i {
            if entry(i, j).to_bits() != entry(j, i).to_bits() {
                return Some("not symmetric");
            }
            let scaled = entry(i, j) / (entry(i, i) * entry(j, j)).sqrt() + if i == j { 1e-4 } else { 0.0 };
            let known: f64 = (0..j).map(|k| factor[i][k] * factor[j][k]).sum();
            if i == j && scaled - known <= 0.0 {
                return Some("not positive");
            }
            factor[i][j] = if i == j { (scaled - known).sqrt() } else { (scaled - known) / factor[j][j] };
        }
    }
    None
}
