use nn::Weights;
use source::PlaybackOptions;
use wire::detection_flags::HAS_ID;
use wire::{AgentType, TICK_NS, Truth};

use super::*;

/// Two walking pedestrians, and a third one that is observed once.
fn walkers() -> data::Recording {
    let detection = |id: u64, x_m: f32, y_m: f32| Detection {
        id,
        x_m,
        y_m,
        score: 1.0,
        agent_type: AgentType::Pedestrian as u32,
        flags: HAS_ID,
        ..Detection::default()
    };
    let frame = |number: u64| {
        let way_m = 0.1 * number as f32;
        let mut detections = vec![detection(1, way_m, 0.0), detection(2, 0.3, -way_m)];
        detections.extend((number == 60).then(|| detection(3, 9.0, 9.0)));
        data::Frame {
            stamp_ns: 5_000_000_000 + (TICK_NS * number) as i64,
            observed_types: AgentType::Pedestrian.bit(),
            detections,
            ..data::Frame::default()
        }
    };
    data::Recording {
        name: "walkers".to_owned(),
        interval_ns: TICK_NS,
        has_identities: true,
        frames: (0..200).map(frame).collect(),
        ..data::Recording::default()
    }
}

fn shots_of(wanted: &Wanted, agents: &[u64]) -> Result<Vec<Shot>, String> {
    let playback = Playback::new(walkers(), PlaybackOptions { lockstep: true, ..PlaybackOptions::default() });
    let run = Run { lockstep: true, interval_ns: TICK_NS, ..Run::default() };
    let weights = Weights::onboard();
    shots(playback, (&run, weights.config()), wanted, agents).map_err(|failure| failure.to_string())
}

#[test]
fn a_shot_is_the_nearest_tick_with_its_published_forecasts() {
    let shots = shots_of(&Wanted::At(vec![6.03, 8.0]), &[]).unwrap();
    assert_eq!(shots.iter().map(|shot| shot.tick).collect::<Vec<_>>(), [75, 100]);
    assert!((shots[1].time_s - 8.0).abs() < 1e-9);
    let mut chain_forecasts = Vec::new();
    let run = Run { lockstep: true, interval_ns: TICK_NS, ..Run::default() };
    let mut chain = Chain::new(&run, Weights::onboard().config()).unwrap();
    let mut playback =
        Playback::new(walkers(), PlaybackOptions { lockstep: true, ..PlaybackOptions::default() });
    while let Some(tick) = playback.next_tick() {
        let (_, forecasts) = chain.tick(&tick.header, tick.detections, |_| ());
        if tick.header.seq == 100 {
            chain_forecasts = forecasts.to_vec();
        }
    }
    for (drawing, published) in shots[1].agents.iter().zip(&chain_forecasts) {
        let forecast = drawing.agent.forecast.as_ref().unwrap();
        assert_eq!(forecast.best[..], published.best[..forecast.best.len()]);
        let ([x_m, y_m], truth) = (drawing.agent.position_m, drawing.truth[0].unwrap());
        assert!(((truth[0] - x_m).hypot(truth[1] - y_m) - 0.5).abs() < 0.05, "0.4 s at 1.25 m/s");
    }
    assert_eq!((shots[1].about.as_slice(), shots[1].agents.len()), (&[1, 2][..], 2));
    assert!(shots[1].errors.unwrap().best[0] < 1.0, "{:?}", shots[1].errors);
    assert!(shots[1].visits.is_some());
}

#[test]
fn shots_of_chosen_agents_and_extremes() {
    let [shot] = &shots_of(&Wanted::Middle, &[2]).unwrap()[..] else { panic!("one shot") };
    assert_eq!(shot.about, [2]);
    assert!((7.9..8.1).contains(&shot.time_s), "{} s", shot.time_s);
    let error = shots_of(&Wanted::Middle, &[3]).unwrap_err();
    assert!(
        error.contains("agent 3 has no forecast at 7.92 s, tick 99; agents with a forecast: 1, 2"),
        "{error}"
    );
    for time_s in [-1.0, 17.0, f64::NAN] {
        let error = shots_of(&Wanted::At(vec![time_s]), &[]).unwrap_err();
        assert!(error.contains("the ticks are from 0 s to 15.92 s"), "{error}");
    }
    let extremes = shots_of(&Wanted::Extremes(1), &[]).unwrap();
    let [best, worst] = &extremes[..] else { panic!("{} shots", extremes.len()) };
    assert_ne!(best.about, worst.about, "no agent is shown twice");
    let ade_m = |shot: &Shot| shot.errors.unwrap().best[0];
    assert!(ade_m(best) <= ade_m(worst));
}

#[test]
fn agents_without_identities_get_the_truth_that_is_nearest() {
    let mut recording = walkers();
    recording.has_identities = false;
    for frame in &mut recording.frames {
        for detection in &mut frame.detections {
            let Detection { id, x_m, y_m, agent_type, .. } = *detection;
            frame.truth.push(Truth { id, x_m, y_m, agent_type, ..bytemuck::Zeroable::zeroed() });
            (detection.id, detection.flags) = (0, 0);
        }
    }
    let playback = Playback::new(recording, PlaybackOptions { lockstep: true, ..PlaybackOptions::default() });
    let run = Run { lockstep: true, interval_ns: TICK_NS, ..Run::default() };
    let weights = Weights::onboard();
    let shots = shots(playback, (&run, weights.config()), &Wanted::At(vec![8.0]), &[]).unwrap();
    let agents = &shots[0].agents;
    assert_eq!(agents.len(), 2);
    for AgentDrawing { agent, truth } in agents {
        let ([x_m, y_m], next) = (agent.position_m, truth[0].unwrap());
        assert!(((next[0] - x_m).hypot(next[1] - y_m) - 0.5).abs() < 0.2, "0.4 s at 1.25 m/s");
    }
}
