use bytemuck::Zeroable;
use wire::{Counts, Hop};

use super::*;

const MS: u64 = 1_000_000;

fn view() -> LiveView {
    let budgets_ms = StageId::ALL[..7].iter().map(|&stage| (stage, 8.0)).collect();
    LiveView::new(LiveOptions {
        title: "intersection, 32 agents".to_owned(),
        budgets_ms,
        ticks_limit: Some(500),
        ..LiveOptions::default()
    })
}

/// A tick whose stages differ slightly in compute. The decoder takes longest.
fn tick(seq: u64) -> Header {
    let released_ns = 1_000 * MS + seq * 80 * MS;
    let counts = Counts { agents_len: 3, ..Counts::default() };
    let mut header =
        Header { counts, released_ns, interval_ns: 80 * MS, ..Header::new(1, seq, (seq * 80 * MS) as i64) };
    let mut now_ns = released_ns;
    for stage in &StageId::ALL[..7] {
        let compute_ns = if *stage == StageId::Decoder { 9 * MS } else { (1 + seq % 5) * MS / 2 };
        header.push_hop(Hop {
            stage: stage.number(),
            incarnation: 0,
            received_ns: now_ns,
            started_ns: now_ns,
            finished_ns: now_ns + compute_ns,
            sent_ns: now_ns + compute_ns,
        });
        now_ns += compute_ns;
    }
    header
}

fn running() -> LiveView {
    let mut view = view();
    let held = Forecast { quality: Quality::Held as u32, ..Forecast::zeroed() };
    for seq in 0..155 {
        view.forecasts(&tick(seq), &[Forecast::zeroed(), Forecast::zeroed(), held]);
    }
    for stage in [StageId::Source, StageId::Tracker] {
        let sent_ns = if stage == StageId::Source { 13_390 * MS } else { 13_000 * MS };
        view.heartbeat(&Heartbeat { stage: stage.number(), frames_len: 155, sent_ns, ..Heartbeat::zeroed() });
    }
    view.heartbeat(&Heartbeat {
        stage: StageId::Encoder.number(),
        incarnation: 1,
        dropped_len: 2,
        sent_ns: 13_390 * MS,
        ..Heartbeat::zeroed()
    });
    view.errors(Some(Errors {
        forecasts: 700,
        held_50: Some(0.56),
        held_90: Some(0.89),
        single_ade_m: Some(0.482),
        cv_ade_m: Some(0.611),
        ..Errors::default()
    }));
    view.clock(13_400 * MS);
    view
}

fn drawn(view: &LiveView, width: usize, height: usize) -> String {
    let lines = lines(view, width, height);
    assert!(lines.len() <= height);
    lines.iter().map(|line| line.paint(width, false).trim_end().to_owned() + "\n").collect()
}

#[test]
fn the_table_has_latencies_losses_and_restarts() {
    insta::assert_snapshot!(drawn(&running(), 104, 20));
}

#[test]
fn stages_have_rows_before_the_first_tick() {
    insta::assert_snapshot!(drawn(&view(), 80, 14));
}

#[test]
fn what_is_shed_stands_in_the_table_and_in_the_plain_line() {
    let mut view = running();
    let shed =
        Forecast { quality: Quality::Held as u32, cause: wire::Cause::Shed as u32, ..Forecast::zeroed() };
    let late = Forecast { cause: wire::Cause::Late as u32, ..shed };
    view.forecasts(&tick(155), &[shed, shed, late]);
    let line = view.plain_line();
    assert!(line.contains("0 learned, 3 held, 0 kinematic, shed 2 (2 so far)  late 0"), "{line}");
    let table = drawn(&view, 104, 20);
    assert!(table.contains("0 learned   3 held   0 kinematic   2 shed, 0.4 % so far"), "{table}");
}

#[test]
fn the_table_has_the_share_of_constant_velocity() {
    let mut view = view();
    let quality = Quality::Kinematic as u32;
    let outdone = Forecast { quality, cause: wire::Cause::Outdone as u32, ..Forecast::zeroed() };
    let young = Forecast { quality, cause: wire::Cause::Young as u32, ..Forecast::zeroed() };
    (0..10).for_each(|seq| view.forecasts(&tick(seq), &[outdone, outdone, young, Forecast::zeroed()]));
    let table = drawn(&view, 104, 20);
    let expected = "1 learned   0 held   3 kinematic   40 so far, 25 % learned, 50 % constant velocity";
    assert!(table.contains(expected), "{table}");
}

#[test]
fn any_terminal_size_can_be_drawn() {
    let view = running();
    for (width, height) in [(1, 1), (5, 40), (20, 3), (200, 60)] {
        drawn(&view, width, height);
    }
}

#[test]
fn the_plain_line_has_the_same_numbers() {
    assert_eq!(
        running().plain_line(),
        "tick 155/500  12.4 s  end to end p50 18.0 ms, p99 24.0 ms  forecasts 2 learned, 1 held, 0 kinematic  \
         late 0, lost 2"
    );
}

#[test]
fn the_window_is_bounded() {
    let mut view = view();
    for seq in 0..10_000 {
        view.forecasts(&tick(seq), &[]);
    }
    assert_eq!((view.window.len(), view.ticks()), (WINDOW_LEN, 10_000));
}

#[test]
fn silent_stages_are_marked() {
    let alive = |stage| running().stages().into_iter().find(|(s, _)| *s == stage).map(|(_, row)| row.alive);
    assert_eq!(alive(StageId::Source), Some(Some(true)));
    assert_eq!(alive(StageId::Tracker), Some(Some(false)));
    assert_eq!(alive(StageId::Decoder), Some(None));
}
