//! Lies planted in a true history. Each must be found as the violation that it is.
//!
//! `true.jsonl` was written by `stgdat fault run --keep`. In that run the decoder was killed twice, the
//! sampler and the tracker once, and some controls were dropped.

use std::path::Path;

use super::{Facts, ForecastSeen, Line, Output, Promise, check, read};
use wire::{Cause, Forecast, Header, Quality, Steering};

fn true_history() -> Vec<Line> {
    read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src/checker/true.jsonl"))
        .expect("the history can be read")
}

/// The promises that a history breaks.
fn broken(history: &[Line]) -> Vec<Promise> {
    let findings = check(history).into_iter();
    findings.filter(|finding| finding.count > 0).map(|finding| finding.promise).collect()
}

fn facts(history: &mut [Line]) -> &mut Facts {
    let facts =
        history.iter_mut().find_map(|line| if let Line::Facts(facts) = line { Some(facts) } else { None });
    facts.expect("a history ends with the facts about the run")
}

fn is_output(line: &Line) -> bool {
    line.output().is_some()
}

/// The first suitable output in the last two thirds of the history.
fn output(history: &mut [Line], is_fit: impl Fn(&Output) -> bool) -> &mut Output {
    let middle = history.len() / 3;
    let output = history[middle..].iter_mut().find_map(|line| match line {
        Line::Forecasts(output) if is_fit(output) => Some(output),
        _ => None,
    });
    output.expect("the history has such an output")
}

/// Whether the forecasts are learned and there is at least one.
fn is_learned(output: &Output) -> bool {
    output.is_learned() && !output.forecasts.is_empty()
}

fn learned(output: &mut Output) -> &mut ForecastSeen {
    output.forecasts.iter_mut().find(|forecast| forecast.is_learned()).expect("it has a learned forecast")
}

fn is_held(output: &Output) -> bool {
    output.forecasts.iter().any(|forecast| forecast.quality == "held")
}

fn held(output: &mut Output) -> &mut ForecastSeen {
    let held = output.forecasts.iter_mut().find(|forecast| forecast.quality == "held");
    held.expect("it has a held forecast")
}

/// Places of two consecutive outputs with learned forecasts, far from any fault.
fn calm_pair(history: &[Line]) -> (usize, usize) {
    let outputs: Vec<usize> = (0..history.len()).filter(|place| is_output(&history[*place])).collect();
    let calm = |place: usize| history[place].output().is_some_and(is_learned);
    let pair = outputs.windows(8).find(|places| places.iter().all(|place| calm(*place)));
    let pair = pair.expect("the run was calm for a while");
    (pair[6], pair[7])
}

#[test]
fn a_true_history_keeps_all_promises() {
    let history = true_history();
    assert!(history.iter().filter(|line| is_output(line)).count() > 50);
    assert_eq!(broken(&history), [], "{:?}", check(&history));
}

type Lie = fn(&mut Vec<Line>);

/// A name, the lie, and the promise that it breaks.
const LIES: [(&str, Lie, Promise); 21] = [
    ("a missing tick", |h| drop(h.remove(calm_pair(h).0)), Promise::MissingTicksExplained),
    (
        "a missing tick, and controls that never arrived",
        |h| {
            h.remove(calm_pair(h).0);
            *facts(h).lost.entry("sampler".to_owned()).or_default() += 50;
        },
        Promise::MissingTicksExplained,
    ),
    (
        "a missing tick on which a fault off its path has acted",
        |h| {
            let Line::Forecasts(output) = h.remove(calm_pair(h).0) else { panic!("an output") };
            let (topic, kinds) = ("approaches".to_owned(), vec!["drop".to_owned()]);
            facts(h).off_path_topics.push(topic.clone());
            h.insert(0, Line::Injected { topic, tick: output.tick, kinds });
        },
        Promise::MissingTicksExplained,
    ),
    (
        "missing last ticks",
        |h| facts(h).ticks = facts(h).ticks.map(|ticks| ticks + 2),
        Promise::MissingTicksExplained,
    ),
    ("a doubled tick", |h| h.insert(calm_pair(h).1, h[calm_pair(h).0].clone()), Promise::TicksInOrder),
    (
        "two ticks the wrong way round",
        |h| {
            let (a, b) = calm_pair(h);
            h.swap(a, b);
        },
        Promise::TicksInOrder,
    ),
    ("a stamp that goes back", |h| output(h, is_learned).stamp_ns -= 200_000_000, Promise::StampsInOrder),
    ("a gap in the ticks", |h| shift(h), Promise::MissingTicksExplained),
    (
        "a held forecast that is too young",
        |h| held(output(h, is_held)).age_ns -= 80_000_000,
        Promise::AgesRight,
    ),
    (
        "a held forecast that is too old",
        |h| held(output(h, is_held)).age_ns += 80_000_000,
        Promise::AgesRight,
    ),
    (
        "a learned forecast with an age",
        |h| learned(output(h, is_learned)).age_ns = 80_000_000,
        Promise::AgesRight,
    ),
    (
        "a held forecast called learned",
        |h| call_learned(held(output(h, is_held))),
        Promise::LearnedAreOfTheirTick,
    ),
    ("a stale forecast called fresh", |h| repeat(h), Promise::LearnedAreOfTheirTick),
    ("forecasts that come 3 s late", |h| delay(h), Promise::NothingStale),
    ("a forecast without a cause", |h| held(output(h, is_held)).cause = "none".into(), Promise::CausesNamed),
    (
        "a cause that nobody counted",
        |h| held(output(h, is_held)).cause = "missing".into(),
        Promise::CausesCounted,
    ),
    (
        "causes counted too low",
        |h| *facts(h).causes.get_mut("late").expect("late") -= 1,
        Promise::CausesCounted,
    ),
    (
        "an impossible number",
        |h| output(h, is_learned).impossible = Some("NaN".into()),
        Promise::NumbersPossible,
    ),
    ("a restart that is not reported", |h| forget_outage(h), Promise::RestartsReported),
    (
        "a neighbour restarted",
        |h| facts(h).targets.retain(|stage| stage != "sampler"),
        Promise::OthersUntouched,
    ),
    ("a file left", |h| facts(h).files_left = 1, Promise::NothingLeft),
];

/// Delays all ticks from a calm one on by one tick number.
fn shift(history: &mut [Line]) {
    let from = calm_pair(history).0;
    for line in &mut history[from..] {
        if let Line::Forecasts(output) = line {
            output.tick += 1;
        }
    }
    facts(history).ticks = None;
}

/// Delays more outputs than are counted as late.
fn delay(history: &mut [Line]) {
    let late = facts(history).late_ticks as usize + 1;
    let from = calm_pair(history).0;
    let outputs = history[from..].iter_mut().filter(|line| line.output().is_some_and(is_learned));
    for line in outputs.take(late) {
        let Line::Forecasts(output) = line else { panic!("an output") };
        output.received_ns += 3_000_000_000;
    }
}

fn call_learned(forecast: &mut ForecastSeen) {
    (forecast.quality, forecast.cause, forecast.age_ns) = ("learned".into(), "none".into(), 0);
}

/// Repeats the controls of one tick in the next one, with the agents at their true positions.
fn repeat(history: &mut [Line]) {
    let (a, b) = calm_pair(history);
    let before = history[a].output().expect("an output").clone();
    let Line::Forecasts(after) = &mut history[b] else { panic!("an output") };
    for forecast in &mut after.forecasts {
        let earlier = before.forecasts.iter().find(|earlier| earlier.id == forecast.id);
        forecast.print = earlier.map_or(forecast.print, |earlier| earlier.print);
    }
}

/// Removes a death of the decoder from the report.
fn forget_outage(history: &mut [Line]) {
    let outages = &mut facts(history).outages;
    let place = outages.iter().rposition(|outage| outage.stage == "decoder").expect("it was killed");
    outages.remove(place);
}

#[test]
fn each_lie_is_found() {
    for (name, lie, promise) in LIES {
        let mut history = true_history();
        lie(&mut history);
        let found = broken(&history);
        assert!(found.contains(&promise), "{name}: {found:?}");
    }
}

#[test]
fn a_missing_tick_whose_tracks_never_came_is_explained() {
    let mut history = true_history();
    history.remove(calm_pair(&history).0);
    facts(&mut history).unanswered.insert("sampler".to_owned(), 1);
    assert_eq!(broken(&history), []);
}

#[test]
fn a_stage_left_and_an_unknown_cause_are_found() {
    let mut history = true_history();
    facts(&mut history).stages_left = 1;
    held(output(&mut history, is_held)).cause = "number 77".into();
    let found = broken(&history);
    assert!(
        [Promise::NothingLeft, Promise::CausesNamed].iter().all(|promise| found.contains(promise)),
        "{found:?}"
    );
}

#[test]
fn forecasts_are_seen_by_quality_and_cause() {
    let forecast = |quality: Quality, cause: Cause, age_ns| Forecast {
        id: 3,
        quality: quality as u32,
        cause: cause as u32,
        age_ns,
        steering: Steering::Bicycle as u32,
        ..Forecast::default()
    };
    let learned = forecast(Quality::Learned, Cause::None, 0);
    let held = forecast(Quality::Held, Cause::Late, 160_000_000);
    let header = Header::new(1, 5, 0);
    assert!(Output::of(&header, 0, &[learned]).is_learned());
    let output = Output::of(&header, 0, &[learned, held, forecast(Quality::Kinematic, Cause::Young, 0)]);
    assert_eq!((output.degraded(), output.age_ms_max(), output.is_learned()), (1, 160.0, false));
    assert_eq!(output.causes().into_iter().collect::<Vec<_>>(), [("late", 1), ("young", 1)]);
    assert_eq!(output.forecasts[0].print, output.forecasts[1].print, "the same controls");
    let mut other = learned;
    other.controls[0][0].mean[0] = 0.5;
    assert_ne!(Output::of(&header, 0, &[other]).forecasts[0].print, output.forecasts[0].print);
    let nowhere = Forecast { x_m: f32::NAN, ..learned };
    assert!(Output::of(&header, 0, &[nowhere]).impossible.is_some());
}

#[test]
fn a_line_that_is_none_is_named() {
    let folder = std::env::temp_dir();
    let path = folder.join(format!("stgdat_checker_{}.jsonl", std::process::id()));
    std::fs::write(&path, "{\"signalled\":{\"target\":\"a\",\"what\":\"b\",\"tick\":1}}\n{\"nonsense\":1}\n")
        .unwrap();
    let why = read(&path).unwrap_err().to_string();
    std::fs::remove_file(&path).unwrap();
    assert!(why.starts_with(&format!("{}:2: ", path.display())), "{why}");
    assert!(read(&folder.join("no-such-history")).unwrap_err().to_string().contains("no-such-history"));
}
