use bytemuck::Zeroable;
use wire::{Forecast, Header, Hop, Quality, StageId};

use super::*;
use crate::passage::Timeline;

const MS: u64 = 1_000_000;

/// A run with ticks 80 ms apart and a millisecond of compute in each stage.
#[derive(Default)]
struct Ticks {
    timeline: Timeline,
    worst: Worst,
}

/// The unusual properties of a tick.
#[derive(Clone, Copy, Default)]
struct Odd {
    slow: Option<(StageId, u64)>,
    late: Option<(StageId, u64)>,
    restarted: Option<StageId>,
    lacks_controls: bool,
    gap: u64,
}

impl Ticks {
    fn tick(&mut self, seq: u64, odd: Odd) {
        let released_ns = 1_000 * MS + seq * 80 * MS;
        let mut header = Header { released_ns, ..Header::new(1, seq, 7) };
        let mut now_ns = released_ns;
        for stage in &StageId::ALL[..7] {
            let is_link = (StageId::Localiser..StageId::Sampler).contains(stage);
            if odd.lacks_controls && is_link {
                continue;
            }
            let of =
                |what: Option<(StageId, u64)>| what.filter(|(of, _)| of == stage).map_or(0, |(_, ms)| ms);
            let received_ns = now_ns + of(odd.late) * MS;
            let finished_ns = received_ns + (1 + of(odd.slow)) * MS;
            header.push_hop(Hop {
                stage: stage.number(),
                incarnation: u32::from(odd.restarted == Some(*stage)),
                received_ns,
                started_ns: received_ns,
                finished_ns,
                sent_ns: finished_ns,
            });
            now_ns = finished_ns;
        }
        let late =
            Forecast { quality: Quality::Held as u32, cause: Cause::Late as u32, ..Forecast::zeroed() };
        let forecast = if odd.lacks_controls { late } else { Forecast::zeroed() };
        let tick = Tick::new(&mut self.timeline, &header, &[forecast]);
        self.worst.take(&tick, header.stamp_ns, odd.restarted, odd.gap, Some(3));
    }

    fn list(&self) -> Vec<WorstTick> {
        let phases_ns = [[0, 0, MS, 0]; StageId::PLACES_LEN];
        self.worst.list(&Usual { phases_ns, agents: 1.0 })
    }
}

fn causes(list: &[WorstTick]) -> Vec<(u64, &str)> {
    list.iter().map(|tick| (tick.tick, tick.cause.as_str())).collect()
}

#[test]
fn the_phase_beyond_its_median_is_the_cause() {
    let mut ticks = Ticks::default();
    ticks.tick(0, Odd::default());
    ticks.tick(1, Odd { slow: Some((StageId::Decoder, 40)), ..Odd::default() });
    ticks.tick(2, Odd { late: Some((StageId::Encoder, 12)), ..Odd::default() });
    let list = ticks.list();
    let expected = [
        (1, "the decoder computed 41.0 ms (usually 1.00)"),
        (2, "the encoder woke 12.0 ms after its input was sent (usually 0.000)"),
        (0, "no phase took longer than usual"),
    ];
    assert_eq!(causes(&list), expected);
    assert_eq!((list[0].stage.as_deref(), list[0].phase.as_deref()), (Some("decoder"), Some("compute")));
    assert_eq!(list[0].end_to_end_ms, Some(47.0));
}

#[test]
fn the_next_whole_tick_tells_why_controls_did_not_come() {
    let mut ticks = Ticks::default();
    let lacking = Odd { lacks_controls: true, slow: Some((StageId::Sampler, 60)), ..Odd::default() };
    ticks.tick(0, lacking);
    ticks.tick(1, Odd { restarted: Some(StageId::Decoder), ..Odd::default() });
    let mut behind = Ticks::default();
    behind.tick(0, lacking);
    behind.tick(1, Odd { late: Some((StageId::Extractor, 30)), ..Odd::default() });
    let mut lost = Ticks::default();
    lost.tick(0, lacking);
    lost.tick(1, Odd::default());
    let causes = [&ticks, &behind, &lost].map(|ticks| ticks.list()[0].cause.clone());
    let tail = "; 1 of 1 forecasts not learned (late)";
    assert_eq!(
        causes,
        [
            format!("its controls did not arrive: the decoder was restarted{tail}"),
            format!("its controls did not arrive: the extractor took its next frame 30.0 ms late{tail}"),
            format!("its controls arrived too late or were lost; no stage was behind at the next tick{tail}"),
        ]
    );
}

#[test]
fn ticks_without_forecasts_are_the_worst() {
    let mut ticks = Ticks::default();
    ticks.tick(0, Odd { slow: Some((StageId::Tracker, 500)), ..Odd::default() });
    ticks.tick(4, Odd { gap: 3, restarted: Some(StageId::Tracker), ..Odd::default() });
    let list = ticks.list();
    assert_eq!(list[0].cause, "3 ticks without forecasts: the tracker was restarted");
    assert_eq!((list[0].tick, list[0].ticks_lost, list[0].end_to_end_ms), (1, 3, None));
    assert_eq!(list[1].tick, 0);
}

#[test]
fn the_list_is_bounded_sorted_and_keeps_the_worst() {
    let mut ticks = Ticks::default();
    for seq in 0..500 {
        ticks.tick(seq, Odd { slow: Some((StageId::Tracker, seq * 7919 % 501)), ..Odd::default() });
    }
    let list = ticks.list();
    assert_eq!(list.len(), WORST_LEN);
    assert!(list.is_sorted_by(|a, b| a.end_to_end_ms >= b.end_to_end_ms));
    let mut slowest: Vec<u64> = (0..500).map(|seq| seq * 7919 % 501).collect();
    slowest.sort_unstable();
    let least = slowest[500 - WORST_LEN] as f64 + 7.0;
    assert_eq!(list.last().unwrap().end_to_end_ms, Some(least));
    assert!(
        ticks.worst.ticks.capacity() <= WORST_LEN + 1,
        "nothing is allocated beyond the room of the start"
    );
}

#[test]
fn the_tick_that_is_asked_for_is_explained_however_good_it_is() {
    let mut ticks = Ticks::default();
    for seq in 0..50 {
        ticks.tick(
            seq,
            Odd { slow: Some((StageId::Tracker, if seq == 3 { 2 } else { 9 })), ..Odd::default() },
        );
    }
    assert!(ticks.list().iter().all(|tick| tick.tick != 3));
    let explained = ticks.worst.explained(&Usual::default()).unwrap();
    assert_eq!((explained.tick, explained.end_to_end_ms), (3, Some(9.0)));
}

#[test]
fn what_was_kept_goes_on_with_room() {
    let mut ticks = Ticks::default();
    ticks.tick(0, Odd::default());
    let json = serde_json::to_string(&ticks.worst).unwrap();
    let kept: Worst = serde_json::from_str::<Worst>(&json).unwrap().with_room();
    assert!(kept.ticks.capacity() > WORST_LEN);
    assert_eq!(kept.list(&Usual::default()), ticks.worst.list(&Usual::default()));
}
