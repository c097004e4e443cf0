//! The tracker's prior after a tick that a stage has refused.
#![expect(clippy::unwrap_used, reason = "a test ends at what it can't do")]

use data::{GeneratedScene, SceneOptions};
use nn::Weights;
use onboard::{Chain, OwnFrame, Stages};
use run::Run;
use source::{Playback, PlaybackOptions};
use wire::{Topic, flags};

/// The tick without forecasts.
const VOID: u64 = 30;
const TICKS: usize = 36;

fn bytes<T: Topic>(frame: &OwnFrame<T>) -> &[u8] {
    bytemuck::cast_slice(&frame.elements)
}

/// The tracks of a chain and of the stages one by one. In the tick [`VOID`] the detections are impossible, or the
/// source has sent a VOID frame. The stages take the forecasts of the previous tick, as a process does in lockstep;
/// if these are VOID, they take the ones that they had.
#[test]
fn the_tracker_keeps_the_older_forecasts_after_a_void_frame() {
    for is_refused in [true, false] {
        let scene = GeneratedScene::new(SceneOptions { agents: 6, ..SceneOptions::default() }).unwrap();
        let recording = scene.recording(TICKS);
        let mut playback =
            Playback::new(recording, PlaybackOptions { lockstep: true, ..PlaybackOptions::default() });
        let run = Run { lockstep: true, interval_ns: playback.interval_ns(), ..Run::default() };
        let weights = Weights::onboard();
        let mut chain = Chain::new(&run, weights.config()).unwrap();
        let mut stages = Stages::new(&run, weights).unwrap();
        let (mut prior, mut forecasts) = (None, None);
        while let Some(tick) = playback.next_tick() {
            let (mut header, mut detections) = (tick.header, tick.detections.to_vec());
            if header.seq == VOID && is_refused {
                detections[0].x_m = f32::NAN;
            } else if header.seq == VOID {
                header.flags |= flags::VOID;
            }
            if !header.has(flags::VOID) {
                prior = forecasts.take().or(prior);
            }
            let tracks = stages.track(&header, &detections, prior.as_ref());
            let context = stages.locate(&tracks);
            let features = stages.extract(&context, ports::Allowance::All);
            let encodings = stages.encode(&features, ports::Allowance::All);
            let controls = stages.decode(&encodings, ports::Allowance::All);
            let made = stages.sample(&tracks, Some(&controls));
            let of_chain = chain.tick(&header, &detections, |_| ()).0;
            let is_void = header.seq == VOID;
            assert_eq!((of_chain.has(flags::VOID), made.is_void()), (is_void, is_void));
            assert_eq!(of_chain, made.header, "tick {}", header.seq);
            let (of_tracks, of_forecasts) = chain.frames();
            assert!(bytes(of_tracks) == bytes(&tracks), "the tracks of tick {}", header.seq);
            assert!(bytes(of_forecasts) == bytes(&made), "the forecasts of tick {}", header.seq);
            forecasts = Some(made).filter(|made| !made.is_void());
        }
    }
}
