//! A detector that replaces the source: `command = ["target/release/examples/producer"]` in the source's
//! table of pipeline.toml.
//!
//! Positions are in metres in the world frame (right-handed, z up, fixed to the ground). A detector with UTM
//! or MGRS coordinates subtracts the run's origin (`stgdat run --origin X,Y`) in f64. Headings are
//! counter-clockwise from +x.
//!
//! The header of each frame contains the ego pose in that frame and the stamp. The stamp is a time on the
//! sensor's clock and differs in every frame. Each detection contains its own measurement time as an offset
//! from the stamp. Two sensors that are merged into one frame can therefore measure at different times.
//!
//! Replace [`detect`] by your detectors, or play your own recording.

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::SystemTime;

use bytemuck::Zeroable;
use data::{Ego, Frame, OpenOptions, Recording};
use ports::{Stage, StageError, monotonic_ns, stage_main};
use run::{Declaration, Run};
use serde::Deserialize;
use wire::detection_flags::{HAS_HEADING, HAS_SIZE, HAS_SPEED};
use wire::{
    AgentType, Detection, DetectionsTopic, Header, StageId, StampSource, Topic, TruthTopic, WorldOrigin,
    flags,
};

/// The stage that this program replaces, with the topics that it writes.
const STAGE: Declaration<Options> =
    Declaration::new(StageId::Source, &[], &[DetectionsTopic::NAME, TruthTopic::NAME]);

/// The program's options: `options = { ticks = 60, offsets_ms = [0, -30] }` in its table of pipeline.toml, or
/// `--set source.ticks=60`.
#[derive(Deserialize)]
#[serde(default)]
struct Options {
    ticks: u64,
    /// Measurement times of the car's and the pedestrian's sensor, from the frame's stamp.
    offsets_ms: [f64; 2],
    /// A recording whose frames are sent instead, at most at 12.5 Hz.
    play: Option<PathBuf>,
    /// `[frame, s]`: nothing is sent for this time before this frame.
    pause: Option<(u64, f64)>,
    /// `[frame, s]`: the sensor's clock is set forward by this time before this frame, or back if negative.
    set_clock: Option<(u64, f64)>,
    /// Whether the stamps are the computer's time of day.
    wall_clock: bool,
    /// How often the frames are played. The stamps begin again each time, as in a bag that is played in a loop.
    rounds: u64,
}

impl Default for Options {
    fn default() -> Self {
        let offsets_ms = [0.0; 2];
        Self {
            ticks: 125,
            offsets_ms,
            play: None,
            pause: None,
            set_clock: None,
            wall_clock: false,
            rounds: 1,
        }
    }
}

/// Detections of two sensors, each at its own time: a passing car, and a pedestrian.
fn detect(stamp_ns: i64, offsets_ns: [i64; 2]) -> Vec<Detection> {
    let [car_s, pedestrian_s] = offsets_ns.map(|offset_ns| (stamp_ns + offset_ns) as f32 / 1e9);
    let car = Detection {
        agent_type: AgentType::Vehicle as u32,
        flags: HAS_HEADING | HAS_SPEED | HAS_SIZE,
        x_m: -20.0 + 6.0 * car_s,
        y_m: 2.0,
        speed_mps: 6.0,
        length_m: 4.5,
        width_m: 1.8,
        score: 0.9,
        offset_ns: offsets_ns[0],
        ..Detection::zeroed()
    };
    let pedestrian = Detection {
        agent_type: AgentType::Pedestrian as u32,
        x_m: 5.0,
        y_m: -8.0 + 1.4 * pedestrian_s,
        score: 0.8,
        offset_ns: offsets_ns[1],
        ..Detection::zeroed()
    };
    vec![car, pedestrian]
}

/// The frames to send.
fn scene(options: &Options, origin: WorldOrigin, interval_ns: u64) -> Result<Recording, StageError> {
    if let Some(path) = &options.play {
        // The run's origin is subtracted in f64, before a position becomes the wire's f32.
        let options = OpenOptions { origin, ..OpenOptions::default() };
        return data::open_with(path, options).map_err(StageError::data);
    }
    let frame = |seq: u64| {
        let stamp_ns = (seq * interval_ns) as i64;
        Frame {
            stamp_ns,
            observed_types: AgentType::Vehicle.bit() | AgentType::Pedestrian.bit(),
            // The sensor is at the origin; agents can occlude one another.
            ego: Ego { is_sensor: true, ..Ego::default() },
            detections: detect(stamp_ns, options.offsets_ms.map(|ms| (ms * 1e6) as i64)),
            ..Frame::default()
        }
    };
    Ok(Recording { interval_ns, frames: (0..options.ticks).map(frame).collect(), ..Recording::default() })
}

fn run(run: &Run) -> Result<(), StageError> {
    let options = STAGE.options(run)?;
    let scene = scene(&options, run.origin(), run.interval_ns)?;
    let frames = &scene.frames[..scene.frames.len().min(options.ticks as usize)];
    let mut stage = Stage::open(run, &STAGE)?;
    let detections = stage.publish::<DetectionsTopic>()?;
    // A sensor has no truth. Its truth topic carries only the frames that link the run.
    let truth = stage.publish::<TruthTopic>()?;
    let mut peers = stage.peers(run)?;
    let header = |seq: u64, stamp_ns: i64, flags: u32| Header {
        flags: flags | if scene.has_identities { flags::HAS_IDENTITIES } else { 0 },
        interval_ns: scene.interval_ns,
        stamp_source: StampSource::SensorClock as u32,
        ..Header::new(run.id, seq, stamp_ns)
    };

    // A frame reaches a reader only after the reader has mapped the connection. So warm-up frames are sent
    // until every stage has received one.
    while !peers.unlinked().is_empty() {
        truth.send_copy(&[], header(0, 0, flags::WARM_UP))?;
        stage.pass_empty(stage.release(header(0, 0, flags::WARM_UP)), &detections)?;
        if !stage.sleep_on(peers.heartbeats(), monotonic_ns() + 25_000_000)? {
            return Ok(());
        }
        peers.listen()?;
    }

    let mut begin_ns = monotonic_ns();
    let first_ns = frames.first().map_or(0, |frame| frame.stamp_ns);
    let (mut end_ns, mut clock_ns) = (first_ns, 0);
    for (seq, frame) in (0..).zip((0..options.rounds).flat_map(|_| frames)) {
        if let Some((_, pause_s)) = options.pause.filter(|(at, _)| *at == seq) {
            begin_ns += (pause_s * 1e9) as u64;
            clock_ns += (pause_s * 1e9) as i64;
        }
        if let Some((_, step_s)) = options.set_clock.filter(|(at, _)| *at == seq) {
            clock_ns += (step_s * 1e9) as i64;
        }
        let round = seq / frames.len() as u64;
        let round_ns =
            round * (frames.last().map_or(0, |last| last.stamp_ns.abs_diff(first_ns)) + scene.interval_ns);
        if !stage.sleep_until(begin_ns + round_ns + frame.stamp_ns.abs_diff(first_ns))? {
            return Ok(());
        }
        let stamp_ns = if options.wall_clock {
            SystemTime::UNIX_EPOCH.elapsed().map_or(0, |since| since.as_nanos() as i64)
        } else {
            frame.stamp_ns + clock_ns
        };
        let seen_from_ego = if frame.ego.is_sensor { flags::SEEN_FROM_EGO } else { 0 };
        let mut passage = stage.release(Header {
            observed_types: frame.observed_types,
            ego_m: frame.ego.position_m,
            ego_heading_rad: frame.ego.heading_rad,
            ..header(seq, stamp_ns, seen_from_ego)
        });
        // As a detector would send them, so the tracker's audit sees the file's content.
        let measured: Vec<Detection> =
            (0..frame.detections.len()).filter_map(|place| frame.written(place)).collect();
        passage.header.counts.agents_len = measured.len() as u32;
        let loan = detections.copy(&measured)?;
        stage.finish(passage, &detections, Ok(loan))?;
        end_ns = stamp_ns + scene.interval_ns as i64;
    }
    stage.sleep_until(monotonic_ns() + scene.interval_ns)?;
    let seq = options.rounds * frames.len() as u64;
    Ok(stage.pass_empty(stage.release(header(seq, end_ns, flags::END)), &detections)?)
}

fn main() -> ExitCode {
    stage_main(run)
}
