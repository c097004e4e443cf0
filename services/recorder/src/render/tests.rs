use crate::record::tests::eventful;
use crate::{Recorder, RecorderOptions, Report};

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
fn any_width_can_be_rendered() {
    let mut report: Report = eventful();
    report.end_to_end_ms.p999 = Some(20.0);
    for width in 0..200 {
        assert!(!report.render(width).is_empty());
    }
}
