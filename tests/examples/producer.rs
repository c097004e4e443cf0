//! A detector in the source's place: `command = ["target/release/examples/producer"]` in its table of
//! pipeline.toml.
//!
//! Positions are metres in the world frame (right-handed, z up, fixed to the ground), headings
//! counter-clockwise from +x. The header of each frame contains the ego pose in that frame and the stamp: the
//! time at which the detections are valid, on the sensor's clock, different in every frame. Put your detector
//! in the place of [`detect`].

use std::process::ExitCode;

use bytemuck::Zeroable;
use ports::{Stage, StageError, monotonic_ns, stage_main};
use run::{Declaration, Run};
use serde::Deserialize;
use wire::detection_flags::{HAS_HEADING, HAS_SIZE, HAS_SPEED};
use wire::{AgentType, Detection, DetectionsTopic, Header, StageId, StampSource, Topic, TruthTopic, flags};

/// The stage that it replaces, with the topics that it writes.
const STAGE: Declaration<Options> =
    Declaration::new(StageId::Source, &[], &[DetectionsTopic::NAME, TruthTopic::NAME]);

/// Options of its own: `options = { ticks = 60 }` in its table of pipeline.toml, or `--set source.ticks=60`.
#[derive(Deserialize)]
#[serde(default)]
struct Options {
    ticks: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self { ticks: 125 }
    }
}

/// Detections at `t_s`: a car that passes, and a pedestrian.
fn detect(t_s: f32) -> [Detection; 2] {
    let car = Detection {
        agent_type: AgentType::Vehicle as u32,
        flags: HAS_HEADING | HAS_SPEED | HAS_SIZE,
        x_m: -20.0 + 6.0 * t_s,
        y_m: 2.0,
        speed_mps: 6.0,
        length_m: 4.5,
        width_m: 1.8,
        score: 0.9,
        ..Detection::zeroed()
    };
    let agent_type = AgentType::Pedestrian as u32;
    let pedestrian =
        Detection { agent_type, x_m: 5.0, y_m: -8.0 + 1.4 * t_s, score: 0.8, ..Detection::zeroed() };
    [car, pedestrian]
}

fn run(run: &Run) -> Result<(), StageError> {
    let Options { ticks } = STAGE.options(run)?;
    let mut stage = Stage::open(run, &STAGE)?;
    let detections = stage.publish::<DetectionsTopic>()?;
    // A sensor has no truth: that topic carries only the frames that link the run.
    let truth = stage.publish::<TruthTopic>()?;
    let mut peers = stage.peers(run)?;
    let observed_types = AgentType::Vehicle.bit() | AgentType::Pedestrian.bit();
    let header = |seq: u64, flags: u32| Header {
        flags,
        interval_ns: run.interval_ns,
        stamp_source: StampSource::SensorClock as u32,
        observed_types,
        ..Header::new(run.id, seq, (seq * run.interval_ns) as i64)
    };

    // Frames reach a reader once it has mapped the connection: warm-up frames pass until every stage has had
    // one.
    while !peers.unlinked().is_empty() {
        truth.send_copy(&[], header(0, flags::WARM_UP))?;
        stage.pass_empty(stage.release(header(0, flags::WARM_UP)), &detections)?;
        if !stage.sleep_on(peers.heartbeats(), monotonic_ns() + 25_000_000)? {
            return Ok(());
        }
        peers.listen()?;
    }

    let begin_ns = monotonic_ns();
    for seq in 0..ticks {
        if !stage.sleep_until(begin_ns + seq * run.interval_ns)? {
            return Ok(());
        }
        // The sensor is at the origin, where the header places the ego; agents can occlude one another.
        let mut passage = stage.release(header(seq, flags::SEEN_FROM_EGO));
        let detected = detect((seq * run.interval_ns) as f32 / 1e9);
        passage.header.counts.agents_len = detected.len() as u32;
        let loan = detections.copy(&detected)?;
        stage.finish(passage, &detections, Ok(loan))?;
    }
    stage.sleep_until(begin_ns + ticks * run.interval_ns)?;
    Ok(stage.pass_empty(stage.release(header(ticks, flags::END)), &detections)?)
}

fn main() -> ExitCode {
    stage_main(run)
}
