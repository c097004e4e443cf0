use crate::record::tests::eventful;
use crate::report::{Percentiles, StageReport};
use crate::{
    Outage, Recorder, RecorderOptions, Replacement, ReplacementOutcome, Report, SceneNoise, StageMemory,
    Status, Supervision, Verdict,
};

fn widest(text: &str) -> usize {
    text.lines().map(|line| line.chars().count()).max().unwrap_or(0)
}

#[test]
fn an_eventful_run_fits_80_columns() {
    let text = eventful().render(80);
    assert!(widest(&text) <= 80 + "  restarted 1×".chars().count(), "{text}");
    insta::assert_snapshot!(text);
}

#[test]
fn a_wide_terminal_shows_every_phase() {
    insta::assert_snapshot!(eventful().render(120));
}

#[test]
fn the_noise_of_a_generated_scene_is_one_line() {
    let line = |position_m, heading_deg| SceneNoise { position_m, heading_deg }.line();
    assert_eq!(line([0.1; 3], 2.0), "generated, detector noise 0.1 m, headings 2°");
    let by_type = "generated, detector noise 0.08 to 0.15 m by type, headings 2.29°";
    assert_eq!(line([0.15, 0.12, 0.08], 2.292), by_type);
    assert_eq!(line([0.0; 3], 0.0), "generated, without detector noise");
    let mut report = eventful();
    assert!(!report.render(80).contains(" scene "));
    report.run.scene_noise = Some(SceneNoise { position_m: [0.1; 3], heading_deg: 2.0 });
    assert!(report.render(80).contains(" scene       generated, detector noise 0.1 m, headings 2°\n"));
}

#[test]
fn a_run_without_ticks_is_empty() {
    insta::assert_snapshot!(Recorder::new(RecorderOptions::default()).report().render(80));
}

#[test]
fn page_faults_and_refused_settings_fit_80_columns() {
    let mut report = Report { stages: Vec::new(), ..eventful() };
    let memory =
        StageMemory { ticks: 1_900, minor_faults: 12_345, resident_kib: 40 << 10, ..Default::default() };
    let stages = wire::StageId::ALL.map(|stage| (stage.name().to_owned(), memory));
    report.supervision.memory = stages.into();
    report.supervision.notes = vec!["the encoder can't have processor 9: it runs on any".to_owned(); 2];
    let text = report.render(80);
    assert!(widest(&text) <= 80, "{text}");
    assert!(text.contains(" NOT ALLOWED the encoder can't have processor 9"), "{text}");
    assert!(text.contains("1,900 ticks: ") && text.contains("tracker 12,345"), "{text}");
    assert!(text.contains("320 MiB resident · 0 MiB locked, the rest is over ulimit -l"), "{text}");
    report.supervision.memory =
        [("tracker".to_owned(), StageMemory { ticks: 9, ..StageMemory::default() })].into();
    assert!(report.render(80).contains("page faults in the last 9 ticks: none"));
}

#[test]
fn links_are_listed_by_stage() {
    let mut report = Report { stages: Vec::new(), ..eventful() };
    assert!(!report.render(80).contains("LINKS"));
    let counts = wire::LinkCount::ALL.map(|kind| (kind.name().to_owned(), 12_345));
    report.links = [("to-planner".to_owned(), counts.into())].into();
    let text = report.render(80);
    assert!(widest(&text) <= 80, "{text}");
    assert!(text.contains(" LINKS\n to-planner  another key 12,345, connections 12,345, "), "{text}");
    let since_stamp_ms = Percentiles { p50: Some(21.25), p99: Some(40.0), ..Percentiles::default() };
    let stage = StageReport { name: "to-planner".into(), since_stamp_ms, ..StageReport::default() };
    let line = Report { stages: vec![stage], ..report }.link_line("to-planner").unwrap();
    assert!(line.ends_with(", since the stamp 21.2 / 40.0 ms"), "{line}");
}

#[test]
fn any_width_can_be_rendered() {
    let mut report: Report = eventful();
    report.end_to_end_ms.p999 = Some(20.0);
    for width in 0..200 {
        assert!(!report.render(width).is_empty());
    }
}

#[test]
fn replacements_are_listed_and_are_no_restarts() {
    let replacement = |outcome, stage: &str, incarnation, cause: &str| Replacement {
        command: if outcome == ReplacementOutcome::Replaced { Vec::new() } else { vec!["./mine".into()] },
        outcome,
        warm_up_ms: Some(310.4),
        hand_over_ms: Some(9.2),
        outage: Outage {
            stage: stage.into(),
            incarnation,
            cause: cause.into(),
            tick: 54,
            ticks_to_learned: Some(1),
            ..Outage::default()
        },
    };
    let supervised = |replacements, restarts| {
        let stage = StageReport { name: "encoder".into(), restarts, ..StageReport::default() };
        let reasons = vec![format!("restarts: {restarts} (encoder {restarts})")];
        let verdict = Verdict { status: Status::Degraded, reasons };
        let mut report = Report { ticks: 90, stages: vec![stage], verdict, ..Report::default() };
        report.supervised(Supervision { replacements, ..Supervision::default() });
        report
    };
    let replaced = replacement(ReplacementOutcome::Replaced, "encoder", 1, "");
    let report = supervised(vec![replaced.clone()], 1);
    assert_eq!((report.verdict.status, report.stages[0].restarts), (Status::Ok, 0));
    assert_eq!(report.stages[0].replacements, 1);

    let not_used = replacement(ReplacementOutcome::NotUsed, "encoder", 1, "ended with exit code 3");
    let rolled_back = replacement(ReplacementOutcome::RolledBack, "encoder", 3, "was killed by signal 9");
    let report = supervised(vec![replaced, not_used, rolled_back], 4);
    let reasons = [
        "the replacement of the encoder was rolled back: it was killed by signal 9",
        "restarts: 1 (encoder 1)",
    ];
    assert_eq!(
        (report.verdict.status, &report.verdict.reasons[..]),
        (Status::Degraded, &reasons.map(String::from)[..])
    );
    let text = report.render(100);
    let list = text.split_once(" REPLACED").expect("a list").1;
    let ticks = "ticks: 0 lost, 0 not learned, learned again after 1";
    let lines = [
        format!("by the built-in one, warm after 310 ms, handed over in 9 ms; {ticks}"),
        "not by ./mine: it ended with exit code 3; the old one continues".to_owned(),
        format!("rolled back from ./mine: it was killed by signal 9; {ticks}"),
    ];
    let expected = lines.map(|line| format!(" encoder     tick 54: {line}"));
    assert!(list.lines().skip(1).take(3).eq(expected.iter()), "{list}");
}

#[test]
fn the_verdict_states_the_share_of_constant_velocity() {
    let mut report = eventful();
    report.verdict = Verdict { status: Status::Ok, reasons: Vec::new() };
    (report.forecasts.learned, report.forecasts.held, report.forecasts.kinematic) = (17, 0, 83);
    report.forecasts.causes = [("outdone".to_owned(), 80), ("young".to_owned(), 3)].into();
    report.forecasts.constant_velocity_share = Some(0.8);
    let text = report.render(80);
    let verdict: Vec<&str> = text.lines().skip(1).take(2).map(str::trim_start).collect();
    let expected = [
        "OK          every tick in time, nothing lost",
        "constant velocity: 80 % of the forecasts: its error was lower",
    ];
    assert_eq!(verdict, expected, "{text}");
    assert!(!text.contains("not learned: ") && text.contains("kinematic: constant velocity\n"), "{text}");
}
