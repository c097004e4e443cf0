use crate::record::tests::eventful;
use crate::{Recorder, RecorderOptions, Report, StageMemory};

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
fn any_width_can_be_rendered() {
    let mut report: Report = eventful();
    report.end_to_end_ms.p999 = Some(20.0);
    for width in 0..200 {
        assert!(!report.render(width).is_empty());
    }
}
