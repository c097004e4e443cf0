use console::screen::{Color, Line};
use recorder::report::{
    ForecastCounts, RefusedFrames, Report, Shed, StageDrops, StageReport, Status, Verdict, WorstTick,
};
use recorder::status::{Newest, ProcessStatus, StatusEvent};
use recorder::{Errors, report::Percentiles};

use super::*;

fn times(p50: f64) -> Percentiles {
    Percentiles { p50: Some(p50), p99: Some(2.0 * p50), p999: None, max: Some(3.0 * p50) }
}

fn stage(name: &str, compute_ms: f64, cpu: f64) -> (StageStatus, StageReport) {
    let process = ProcessStatus {
        state: "running".to_owned(),
        pid: Some(4_211),
        restarts: u32::from(name == "decoder"),
        cpu_s: Some(3.0),
        cpu: Some(cpu),
        memory_bytes: Some((compute_ms * 1e7) as u64),
        shared_bytes: Some(12 << 20),
        spare: (name == "decoder").then(|| "ready".to_owned()),
        promotions: u32::from(name == "decoder"),
    };
    let status = StageStatus {
        name: name.to_owned(),
        alive: Some(name != "encoder"),
        behind_ticks: Some(if name == "encoder" { 7 } else { 1 }),
        budget_ms: (name != "recorder").then_some(8.0),
        recent_waiting_ms: times(0.01),
        recent_wake_up_ms: times(0.05),
        recent_compute_ms: times(compute_ms),
        recent_publish_ms: times(0.004),
        process,
    };
    let report = StageReport {
        name: name.to_owned(),
        compute_ms: times(compute_ms),
        ticks: 412,
        late_ticks: u64::from(compute_ms > 4.0) * 3,
        drops: StageDrops { gap: u64::from(name == "encoder") * 2, ..StageDrops::default() },
        ..StageReport::default()
    };
    (status, report)
}

fn status() -> RunStatus {
    let stages = [
        ("source", 0.02, 0.01),
        ("tracker", 1.2, 0.09),
        ("localiser", 0.4, 0.03),
        ("extractor", 2.0, 0.16),
        ("encoder", 1.1, 0.11),
        ("decoder", 5.3, 0.62),
        ("sampler", 1.9, 0.2),
        ("recorder", 0.1, 0.02),
    ]
    .map(|(name, compute_ms, cpu)| stage(name, compute_ms, cpu));
    let (stages, reports): (Vec<_>, Vec<_>) = stages.into_iter().unzip();
    let reasons = vec!["frames lost: 2 (encoder 2)".to_owned(), "restarts: 1 (decoder 1)".to_owned()];
    let worst = |tick, ms, cause: &str| WorstTick {
        tick,
        end_to_end_ms: ms,
        stage: Some("decoder".to_owned()),
        cause: cause.to_owned(),
        ..WorstTick::default()
    };
    RunStatus {
        run: "stgdat_0badcafe".to_owned(),
        title: "intersection, 32 agents, seed 1".to_owned(),
        linked: true,
        elapsed_s: 73.25,
        ticks_limit: Some(500),
        recent_ticks: 125,
        recent_end_to_end_ms: times(11.4),
        recent_latencies_ms: vec![5.0, 11.4, 22.8, 34.2],
        newest: Newest {
            tick: Some(411),
            qualities: [("learned", 30), ("held", 2), ("kinematic", 0)]
                .map(|(n, c)| (n.to_owned(), c))
                .into(),
            causes: [("late".to_owned(), 2)].into(),
            outside: 0,
        },
        accuracy: Some(Errors {
            held_50: Some(0.512),
            held_90: Some(0.897),
            ade_m: Some(0.213),
            cv_ade_m: Some(0.94),
            ..Errors::default()
        }),
        events: vec![StatusEvent {
            elapsed_s: 31.2,
            text: "the decoder was killed by signal 9, and is started again".to_owned(),
        }],
        report: Report {
            ticks: 412,
            late_ticks: 3,
            late_limit_ms: Some(80.0),
            verdict: Verdict { status: Status::Degraded, reasons },
            forecasts: ForecastCounts { learned: 12_800, held: 96, ..ForecastCounts::default() },
            refusals: vec![RefusedFrames {
                reader: "sampler".to_owned(),
                sender: "decoder".to_owned(),
                cause: "check value".to_owned(),
                frames: 2,
            }],
            links: [("decoder".to_owned(), [("lost".to_owned(), 7), ("frames".to_owned(), 1_250)].into())]
                .into(),
            end_to_end_ms: times(11.1),
            stages: reports,
            worst_ticks: vec![
                worst(201, None, "3 ticks without forecasts: the tracker was restarted"),
                worst(
                    377,
                    Some(81.4),
                    "its controls did not arrive: the decoder was restarted; 32 of 32 forecasts not learned (late)",
                ),
            ],
            ..Report::default()
        },
        stages,
        ..RunStatus::default()
    }
}

/// Returns the words of the first line that contains all of `parts`.
fn words(text: &str, parts: &[&str]) -> Vec<String> {
    let has_all = |line: &&str| parts.iter().all(|part| line.contains(part));
    let line = text.lines().find(has_all).unwrap_or_else(|| panic!("no line with {parts:?} in\n{text}"));
    line.split_whitespace().map(str::to_owned).collect()
}

#[test]
fn the_table_fits_80_columns_with_its_last_one() {
    let text = text(&View::new(status(), SortBy::Chain, None), 80);
    let heading = words(&text, &["stage", "budget"]);
    assert_eq!(heading[..5], ["stage", "p50", "p99", "max", "budget"]);
    assert_eq!(heading[heading.len() - 6..], ["wait", "wake", "lost", "rst", "cpu", "mem"]);
    let decoder = words(&text, &["decoder", "62%"]);
    assert_eq!(decoder[1..6], ["decoder", "5.30", "10.6", "15.9", "8"]);
    assert_eq!(decoder[decoder.len() - 4..], ["0", "1", "62%", "51M"]);
    assert_eq!(words(&text, &["encoder", "11%"])[0], "●");
    assert!(words(&text, &["end to end"]).contains(&"34.2".to_owned()));
    assert!(words(&text, &["held", "learned"]).contains(&"late".to_owned()));
    assert!(words(&text, &["DEGRADED"]).contains(&"lost:".to_owned()));
    for part in ["refused", "was killed by signal 9", "3 ticks without forecasts", "of 90 % held 90 %"] {
        assert!(text.contains(part), "{part} in\n{text}");
    }
}

#[test]
fn the_curve_has_the_newest_latencies_up_to_the_limit() {
    let mut status = status();
    let curve = |status: &RunStatus| {
        let text = text(&View::new(status.clone(), SortBy::Chain, None), 80);
        words(&text, &["  of ", " ms"]).join(" ")
    };
    assert_eq!(curve(&status), "▁▂▄▆ of 40.0 ms", "half of the limit has room for all");
    status.recent_latencies_ms = vec![20.0, 300.0];
    assert_eq!(curve(&status), "▂█ of 80.0 ms");
}

#[test]
fn what_is_shed_stands_with_its_share() {
    let mut status = status();
    assert!(!text(&View::new(status.clone(), SortBy::Chain, None), 100).contains("shed"));
    status.report.forecasts.shed = Shed { forecasts: 52, share: Some(0.004), ..Shed::default() };
    let text = text(&View::new(status, SortBy::Chain, None), 100);
    assert!(text.contains("late 2  shed 0.4 % so far"), "{text}");
}

#[test]
fn constant_velocity_is_no_warning_and_late_is_one() {
    let mut status = status();
    let painted = |status: &RunStatus| {
        let view = View::new(status.clone(), SortBy::Chain, None);
        let lines: Vec<String> = view.table(100, 50).iter().map(|line| line.paint(100, true)).collect();
        lines.into_iter().find(|line| line.contains("learned")).expect("the line of the forecasts")
    };
    let yellow = Color::Yellow.on_default();
    let yellow = Line::styled("x", yellow).paint(1, true).split('x').next().unwrap_or_default().to_owned();
    assert!(painted(&status).contains(&yellow), "{:?}", painted(&status));
    status.newest.causes = [("outdone".to_owned(), 2)].into();
    let line = painted(&status);
    assert!(line.contains("constant velocity 2") && !line.contains(&yellow), "{line:?}");
}

#[test]
fn the_learned_noise_of_the_detections_is_shown() {
    let mut status = status();
    assert!(!text(&View::new(status.clone(), SortBy::Chain, None), 80).contains("noise"));
    let vehicles =
        audit::TypeNoise { agent_type: "vehicle".to_owned(), position_m: 0.112, ..Default::default() };
    status.report.input.noise = vec![vehicles];
    let text = text(&View::new(status, SortBy::Chain, None), 80);
    assert!(text.contains(" noise       vehicles 0.11 m\n"), "{text}");
}

#[test]
fn an_ok_states_the_share_of_constant_velocity() {
    let mut status = status();
    status.report.verdict = Verdict { status: Status::Ok, reasons: Vec::new() };
    let shown = |status: RunStatus| text(&View::new(status, SortBy::Chain, None), 80);
    assert!(shown(status.clone()).contains("OK          every tick in time, nothing lost, no fallback but"));
    status.report.forecasts.constant_velocity_share = Some(0.83);
    let text = shown(status);
    assert!(!text.contains("no fallback"), "{text}");
    assert!(text.contains("constant velocity: 83 % of the forecasts: its error was lower"), "{text}");
}

#[test]
fn the_table_has_more_in_140_columns() {
    let text = text(&View::new(status(), SortBy::P99, None), 140);
    let heading = words(&text, &["stage", "budget"]);
    for column in ["send", "over", "gap", "refus", "behind", "shared", "spare"] {
        assert!(heading.contains(&column.to_owned()), "{column}");
    }
    let encoder = words(&text, &["encoder", "11%"]);
    assert_eq!(encoder[encoder.len() - 9..], ["2", "2", "0", "7", "0", "11%", "10M", "12M", "–"]);
    assert_eq!(words(&text, &["decoder", "ready"]).last().map(String::as_str), Some("ready"));
    let rows: Vec<&str> = text.lines().filter(|line| line.starts_with('●')).collect();
    assert!(rows[0].contains("decoder") && rows[1].contains("extractor"), "sorted by p99:\n{text}");
}

#[test]
fn one_stage_is_shown_alone() {
    let text = text(&View::new(status(), SortBy::Chain, Some("decoder".to_owned())), 100);
    assert_eq!(words(&text, &["compute", "8 ms"])[..4], ["compute", "5.30", "10.6", "15.9"]);
    assert_eq!(words(&text, &["pid"])[..2], ["decoder", "running,"]);
    assert!(text.contains("2 frames of the decoder refused by the sampler: check value"));
    assert!(text.contains("link: frames 1,250, lost 7"), "{text}");
    assert!(!text.contains("localiser"));
}

#[test]
fn what_has_no_room_is_left_out_whole() {
    let view = View::new(status(), SortBy::Chain, Some("decoder".to_owned()));
    assert!(text(&view, 60).contains("shared 12M   spare ready, promoted 1×"), "{}", text(&view, 60));
    let view = View::new(status(), SortBy::Chain, None);
    let whole = text(&view, 80);
    let place = whole.lines().position(|line| line.contains("worst tick")).expect("it has worst ticks");
    for height in [place, place + 1, place + 2] {
        let mut lines = draw::lines(&view, 80);
        draw::truncate(&mut lines, height);
        let has_heading = lines.iter().any(|line| line.paint(80, false).contains("worst tick"));
        assert_eq!(has_heading, height == place + 2, "{height} lines");
    }
}

#[test]
fn no_line_is_wider_than_the_terminal_and_any_size_can_be_drawn() {
    for width in [1, 20, 80, 99, 120, 200] {
        for stage in [None, Some("decoder".to_owned())] {
            let view = View::new(status(), SortBy::Cpu, stage);
            assert!(text(&view, width).lines().all(|line| line.chars().count() <= width));
        }
    }
    let empty = View::new(RunStatus::default(), SortBy::Chain, None);
    assert!(text(&empty, 80).contains("STARTING"));
}

#[test]
fn stages_are_sorted_by_what_is_asked() {
    let first = |sort| View::new(status(), sort, None).stages()[0].name.clone();
    assert_eq!(first(SortBy::Chain), "source");
    assert_eq!([SortBy::P99, SortBy::Cpu, SortBy::Memory].map(first), ["decoder"; 3]);
    assert_eq!(first(SortBy::Lost), "encoder");
}

#[test]
fn a_paused_view_keeps_what_it_shows() {
    let mut view = View::new(status(), SortBy::Chain, None);
    view.pause();
    view.update(RunStatus::default());
    assert_eq!(view.status().run, "stgdat_0badcafe");
    view.pause();
    view.update(RunStatus::default());
    assert_eq!(view.status().run, "");
}
