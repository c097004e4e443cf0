//! Median and 99th percentile of the time of a tracker tick with association by position, by the number of
//! agents. The time is processor time, which excludes other programs on the machine.
//!
//! `cargo bench -p stgdat-tracker --bench tick -- --csv FOLDER` also writes the detections, one file per
//! scene. They are the input of `tick_in_filterpy.py` beside this file, which is run by hand.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use bytemuck::Zeroable;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rustix::time::{ClockId, clock_gettime};
use tracker::{Prior, Tracker, TrackerOptions};
use wire::{
    AGENTS_MAX, AgentType, DETECTIONS_MAX, Detection, Forecast, Header, MODES_MAX, Steering, Track,
    detection_flags,
};

/// Number of frames in a scene: the time of one turn of each agent.
const FRAMES: usize = 400;
const WARM_UP: usize = 100;
const TICKS: usize = 2_000;
const TICK_NS: i64 = 80_000_000;
const STEP_NS: u64 = 400_000_000;
const TRACKS_MAX: usize = 1_200;

/// Agents on circles, frame by frame.
struct Scene {
    name: String,
    agents_len: usize,
    frames: Vec<Vec<Detection>>,
}

impl Scene {
    /// Vehicles at 5 m/s, one per 100 m².
    fn of_density(agents_len: usize) -> Self {
        let side_m = 10.0 * (agents_len as f32).sqrt();
        Self::new(format!("{agents_len}"), agents_len, side_m, 0.4, AgentType::Vehicle)
    }

    /// Pedestrians of one crowd at 0.25 m/s, one per m².
    fn of_crowd(agents_len: usize) -> Self {
        let side_m = (agents_len as f32).sqrt();
        Self::new(format!("{agents_len}_crowd"), agents_len, side_m, 0.02, AgentType::Pedestrian)
    }

    /// Agents on separate circles, spread evenly over a square.
    fn new(name: String, agents_len: usize, side_m: f32, step_m: f32, agent_type: AgentType) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let turn = std::f32::consts::TAU / FRAMES as f32;
        let radius_m = step_m / turn;
        let centres: Vec<[f32; 3]> = (0..agents_len)
            .map(|_| {
                let mut place = || rng.random_range(-0.5..0.5_f32) * side_m;
                [place(), place(), rng.random_range(-3.0..3.0)]
            })
            .collect();
        // A frame has at most `DETECTIONS_MAX` detections. If there are more agents, each frame detects only
        // a share of them, in turn.
        let share = agents_len.div_ceil(DETECTIONS_MAX);
        let mut frame = |number: usize| {
            let detected = centres.iter().skip(number % share).step_by(share);
            detected
                .map(|&[x, y, first]| {
                    let heading = first + turn * number as f32;
                    let mut noise = || rng.random_range(-0.1..0.1_f32);
                    Detection {
                        x_m: x + radius_m * heading.sin() + noise(),
                        y_m: y - radius_m * heading.cos() + noise(),
                        heading_rad: heading + noise(),
                        agent_type: agent_type as u32,
                        flags: detection_flags::HAS_HEADING,
                        ..Detection::zeroed()
                    }
                })
                .collect()
        };
        let frames = (0..FRAMES).map(&mut frame).collect();
        Self { name, agents_len, frames }
    }

    fn frame(&self, tick: usize) -> &[Detection] {
        &self.frames[tick % FRAMES]
    }

    fn write(&self, folder: &Path) -> std::io::Result<()> {
        let mut rows = String::from("tick,x_m,y_m,heading_rad\n");
        for tick in 0..FRAMES {
            for detection in self.frame(tick) {
                let Detection { x_m, y_m, heading_rad, .. } = detection;
                let _ = writeln!(rows, "{tick},{x_m},{y_m},{heading_rad}");
            }
        }
        std::fs::write(folder.join(format!("{}.csv", self.name)), rows)
    }

    /// Duration of each tick in seconds, sorted, and the number of tracks at the end.
    fn run(&self, prior: Prior) -> (Vec<f64>, usize) {
        let options = TrackerOptions { prior, tracks_max: TRACKS_MAX, ..TrackerOptions::default() };
        let mut tracker = Tracker::new(options);
        let mut out = vec![Track::zeroed(); AGENTS_MAX];
        let mut forecasts = Vec::new();
        let (mut forecast_header, mut held_count) = (Header::new(1, 0, 0), 0);
        let mut times = Vec::with_capacity(TICKS);
        for tick in 0..WARM_UP + TICKS {
            let stamp_ns = tick as i64 * TICK_NS;
            let header = Header { observed_types: 0b111, ..Header::new(1, tick as u64, stamp_ns) };
            let given = (prior == Prior::Learned).then_some((&forecast_header, &forecasts[..]));
            let begin_s = processor_s();
            let tracked = tracker.step(&header, self.frame(tick), given, &mut out);
            let time_s = processor_s() - begin_s;
            if tick >= WARM_UP {
                times.push(time_s);
            }
            let Ok(tracked) = tracked else { continue };
            held_count = tracked.held_count;
            forecasts.clear();
            if prior == Prior::Learned {
                forecasts.extend(out[..tracked.track_count].iter().map(forecast));
            }
            forecast_header = Header { step_ns: STEP_NS, ..header };
            forecast_header.counts.horizon_len = 12;
        }
        times.sort_unstable_by(f64::total_cmp);
        (times, held_count)
    }
}

/// Twenty modes with different controls.
fn forecast(track: &Track) -> Forecast {
    let bicycle = track.state_len == 5;
    let mut forecast = Forecast {
        id: track.id,
        agent_type: track.agent_type,
        modes_len: MODES_MAX as u32,
        steering: if bicycle { Steering::Bicycle } else { Steering::Displacement } as u32,
        frame_heading_rad: track.heading_rad,
        probability: [1.0 / MODES_MAX as f32; MODES_MAX],
        ..Forecast::zeroed()
    };
    for (mode, steps) in forecast.controls.iter_mut().enumerate() {
        let along = 0.05 * (mode as f32 - 9.5);
        for control in steps {
            control.mean = if bicycle { [along, 0.002 * along] } else { [0.02 * along, 0.0] };
            control.cholesky = [0.2, 0.0, 0.02];
        }
    }
    forecast
}

/// Processor time of this thread.
fn processor_s() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 / 1e9
}

fn csv_folder() -> Option<PathBuf> {
    let mut arguments = std::env::args().skip_while(|argument| argument != "--csv");
    arguments.next()?;
    arguments.next().map(PathBuf::from)
}

fn main() -> std::io::Result<()> {
    let csv_folder = csv_folder();
    println!(
        "| agents | detections per frame | tracks held | prior | median ms | p99 ms | median µs per track |"
    );
    println!("|---|---|---|---|---|---|---|");
    let scenes = [10, 30, 100, 300, 500, 1_000].map(Scene::of_density);
    for scene in scenes.iter().chain([&Scene::of_crowd(500)]) {
        if let Some(folder) = &csv_folder {
            scene.write(folder)?;
        }
        for prior in [Prior::Kinematic, Prior::Learned] {
            let (times, held_count) = scene.run(prior);
            let ms = |rank: usize| times[rank] * 1e3;
            let (median_ms, p99_ms) = (ms(TICKS / 2), ms(TICKS * 99 / 100));
            let each_us = median_ms * 1e3 / scene.agents_len as f64;
            let (name, detected_len) = (&scene.name, scene.frames[0].len());
            println!(
                "| {name} | {detected_len} | {held_count} | {prior:?} | {median_ms:.3} | {p99_ms:.3} | {each_us:.2} |"
            );
        }
    }
    Ok(())
}
