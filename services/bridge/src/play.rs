//! Plays a recording or a generated scene to other boxes, as the detector of another box would send it.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use ports::{Stop, clock_offset_ns, monotonic_ns};
use source::{Playback, PlaybackOptions, Tick};
use wire::WorldOrigin;

use crate::frame::{Kind, TickHead, detections};
use crate::options::Protection;
use crate::publish::SendError;
use crate::sender::Sender;
use crate::socket::Address;

/// Longest sleep, so that a request to end is noticed.
const WAIT: Duration = Duration::from_millis(50);

/// What is played.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The recording; without one an intersection is generated.
    pub recording: Option<PathBuf>,
    /// Agents of the generated intersection.
    pub agents: usize,
    /// Ticks after which it ends.
    pub ticks: Option<u64>,
    /// Origin of the world in the recording's own frame.
    pub origin: WorldOrigin,
}

/// Plays a scene once, from the moment when a receiver is there. The stamps are Unix times.
///
/// # Errors
/// [`SendError`] if the scene or the address can't be used.
pub fn play(scene: &Scene, address: &Address, protection: &Protection, stop: &Stop) -> Result<(), SendError> {
    let options = source::Options {
        recording: scene.recording.clone(),
        agents: scene.agents,
        ticks: scene.ticks,
        ..source::Options::default()
    };
    let recording = source::recording(&options, scene.origin, 0);
    let recording = recording.map_err(|error| SendError::Run(error.to_string()))?;
    let playing = PlaybackOptions { run_id: 0, ticks_max: scene.ticks, lockstep: false };
    let mut playback = Playback::new(recording, playing);
    let key = protection.key(address)?;
    let mut sender = Sender::listen(address, Kind::Detections, key, protection.timeout())
        .map_err(|error| SendError::Listen(address.clone(), error))?;
    tracing::info!("detections on {}", sender.address());
    while sender.receivers() == 0 && !stop.requested() {
        std::thread::sleep(WAIT);
    }
    let begun = Instant::now();
    // A sensor's clock does not begin again when its program does: stamps that go back would be refused.
    let begun_ns = clock_offset_ns().saturating_add_unsigned(monotonic_ns());
    while let Some(Tick { header, detections, due_ns, .. }) = playback.next_tick() {
        let due = Duration::from_nanos(due_ns);
        while begun.elapsed() < due && !stop.requested() {
            std::thread::sleep(due.saturating_sub(begun.elapsed()).min(WAIT));
        }
        if stop.requested() {
            break;
        }
        let stamp_ns = begun_ns.saturating_add_unsigned(due_ns);
        let head = TickHead { stamp_ns, ..TickHead::of(&header, scene.origin) };
        sender.send(monotonic_ns(), |body| detections::write(body, &head, detections));
    }
    // The last frame is on its way.
    std::thread::sleep(WAIT.min(protection.timeout()));
    tracing::info!("{}", sender.counts());
    Ok(())
}
