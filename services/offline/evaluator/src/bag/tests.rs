use std::fmt::Write as _;

use data::{Format, Input, PredictedPath, Role};
use metrics::Errors;

use super::report::{METHODS, Row};
use super::*;

const TICKS: usize = 110;
const INTERVAL_NS: i64 = 80_000_000;

/// A car that turns, a pedestrian and a cyclist, at 12.5 Hz.
fn recording(has_identities: bool) -> Recording {
    let mut text = "stamp_s,id,type,x_m,y_m\n".to_owned();
    for tick in 0..TICKS {
        let t = tick as f64 * INTERVAL_NS as f64 / 1e9;
        let agents = [
            ("vehicle", 30.0 * (t / 5.0).sin(), 30.0 - 30.0 * (t / 5.0).cos()),
            ("pedestrian", 40.0, 1.2 * t),
            ("cyclist", -20.0 + 4.0 * t, -15.0),
        ];
        for (place, (of, x_m, y_m)) in agents.into_iter().enumerate() {
            let id = if has_identities { (place + 1).to_string() } else { String::new() };
            let _ = writeln!(text, "{t:.3},{id},{of},{x_m:.4},{y_m:.4}");
        }
    }
    data::parse(Format::Csv, &[Input::new(Role::Rows, "three.csv", text)]).expect("a recording")
}

/// What a run of the recording publishes, as messages with at most `paths` paths.
fn exported(recording: Recording, paths: usize) -> Vec<PredictedFrame> {
    let mut playback = playback(recording);
    let weights = nn::Weights::onboard();
    let run = run(playback.interval_ns(), &Options::default(), None).expect("a run");
    let mut chain = Chain::new(&run, weights.config()).expect("the stages");
    let step_ns = (weights.config().dt_s * 1e9).round() as i64;
    let horizon_len = weights.config().horizon_len;
    let mut frames = Vec::new();
    while let Some(tick) = playback.next_tick() {
        let stamp_ns = tick.header.stamp_ns;
        let object = |forecast: &Forecast| {
            let now = [forecast.x_m, forecast.y_m];
            let mut order: Vec<usize> = (0..forecast.modes_len as usize).collect();
            order.sort_by(|a, b| forecast.probability[*b].total_cmp(&forecast.probability[*a]));
            let path = |mode: usize| {
                let steps = &forecast.modes[mode][..horizon_len];
                let points_m = std::iter::once(now).chain(steps.iter().copied()).collect();
                PredictedPath { step_ns, confidence: forecast.probability[mode], points_m }
            };
            let agent_type = AgentType::try_from(forecast.agent_type).expect("a type");
            let paths = order.into_iter().take(paths).map(path).collect();
            PredictedAgent { agent_type, position_m: now, paths }
        };
        let objects = chain.tick(&tick.header, tick.detections, |_| ()).1.iter().map(object).collect();
        frames.push(PredictedFrame { stamp_ns, objects, other_len: 0 });
    }
    frames
}

/// The same objects, with straight paths of another step.
fn straight(frames: &mut [PredictedFrame], step_ns: i64, len: usize) {
    let ahead_s = step_ns as f32 * 1e-9;
    for agent in frames.iter_mut().flat_map(|frame| &mut frame.objects) {
        let [x, y] = agent.position_m;
        let at = |step: usize| [x + 2.0 * ahead_s * step as f32, y];
        let points_m = (0..=len).map(at).collect();
        agent.paths = vec![PredictedPath { step_ns, confidence: 1.0, points_m }];
    }
}

fn against(frames: Vec<PredictedFrame>, has_identities: bool) -> AgainstReport {
    compare(recording(has_identities), frames, &Options::default()).expect("a report")
}

/// The row of all agents over the whole horizon.
fn all(report: &AgainstReport) -> Row {
    report.rows.last().expect("a row").clone()
}

fn of(row: &Row, key: &str) -> Errors {
    row.errors[METHODS.iter().position(|name| *name == key).expect("a method")]
}

fn near(a: Errors, b: Errors) -> bool {
    (a.ade_m - b.ade_m).abs() < 1e-4 && (a.fde_m - b.fde_m).abs() < 1e-4
}

#[test]
fn our_own_forecasts_in_a_bag_have_our_errors() {
    for has_identities in [true, false] {
        let report = against(exported(recording(has_identities), 20), has_identities);
        let row = all(&report);
        assert_eq!((row.agents, row.horizon_s, report.is_truth_recorded), ("all", 4.8, has_identities));
        assert!(row.forecasts > 100 && report.paths_max == 20, "{:?}", report.counts);
        assert!(
            near(of(&row, "bag, best of its paths"), of(&row, "stgdat, best of 20"))
                && near(of(&row, "bag, best of its paths"), of(&row, "stgdat, best of as many"))
        );
        assert_eq!((report.counts.only_ours, report.counts.only_theirs, report.counts.short), (0, 0, 0));
        assert!(row.within.is_some_and(|[half, most]| half <= most && most <= 1.0));
        let by_type: u64 = report
            .rows
            .iter()
            .filter(|of| of.agents != "all" && of.horizon_s == 4.8)
            .map(|of| of.forecasts)
            .sum();
        assert_eq!(by_type, row.forecasts);
    }
}

#[test]
fn fewer_paths_are_compared_with_as_many_of_ours() {
    let report = against(exported(recording(true), 3), true);
    let row = all(&report);
    assert_eq!(report.paths_max, 3);
    assert!(near(of(&row, "bag, best of its paths"), of(&row, "stgdat, best of as many")));
    assert!(of(&row, "stgdat, best of 20").ade_m < of(&row, "stgdat, best of as many").ade_m, "{row:?}");
}

#[test]
fn other_steps_and_horizons_are_interpolated() {
    // A straight path is the same with every step.
    let errors = [(400_000_000, 12), (500_000_000, 10), (250_000_000, 20)].map(|(step_ns, len)| {
        let mut frames = exported(recording(true), 1);
        straight(&mut frames, step_ns, len);
        all(&against(frames, true))
    });
    assert!(
        errors.iter().all(|row| row.horizon_s == 4.8 && near(of(row, "bag"), of(&errors[0], "bag"))),
        "{errors:?}"
    );
    let mut frames = exported(recording(true), 1);
    straight(&mut frames, 500_000_000, 6);
    let row = all(&against(frames, true));
    assert_eq!(row.horizon_s, 2.8, "the whole steps of 3 s");
    assert!(of(&row, "bag").fde_m < of(&errors[0], "bag").fde_m);
}

#[test]
fn other_rates_and_stamps_are_compared_with_the_newest_tick() {
    let whole = all(&against(exported(recording(true), 20), true));
    let mut frames = exported(recording(true), 20);
    let mut number = 0;
    frames.retain(|_| {
        number += 1;
        number % 4 == 1
    });
    let report = against(frames, true);
    assert_eq!((report.counts.messages, report.counts.messages_outside), (TICKS.div_ceil(4) as u64, 0));
    let row = all(&report);
    assert!(
        row.forecasts * 3 < whole.forecasts
            && near(of(&row, "bag, best of its paths"), of(&row, "stgdat, best of 20"))
    );

    // Half an interval later, our forecasts are interpolated and end a step earlier.
    let mut frames = exported(recording(true), 1);
    straight(&mut frames, 400_000_000, 12);
    frames.iter_mut().for_each(|frame| frame.stamp_ns += INTERVAL_NS / 2);
    let row = all(&against(frames, true));
    assert!((row.horizon_s - 4.4).abs() < 1e-9 && of(&row, "stgdat").ade_m.is_finite(), "{row:?}");
    assert!(
        (of(&row, "stgdat, best of 20").ade_m - of(&whole, "stgdat, best of 20").ade_m).abs() < 0.2,
        "{row:?} {whole:?}"
    );
}

#[test]
fn absent_objects_and_other_times_are_counted() {
    let mut frames = exported(recording(true), 20);
    let pedestrians = |agent: &PredictedAgent| agent.agent_type == AgentType::Pedestrian;
    let absent: usize =
        frames.iter().map(|frame| frame.objects.iter().filter(|agent| pedestrians(agent)).count()).sum();
    let mut far = frames[60].objects[0].clone();
    far.position_m = [500.0, 500.0];
    for frame in &mut frames {
        frame.objects.retain(|agent| !pedestrians(agent));
    }
    frames[60].objects.push(far);
    frames[0].stamp_ns = -1_000_000_000;
    let report = against(frames, true);
    assert_eq!((report.counts.only_ours, report.counts.only_theirs), (absent as u64, 1));
    assert_eq!(report.counts.messages_outside, 1);
    assert!(report.rows.iter().all(|row| row.agents != "pedestrian"));
    let text = report.page().markdown;
    assert!(text.contains("bag, best of 20") && text.contains("1 messages outside"), "{text}");

    let mut frames = exported(recording(true), 20);
    frames.iter_mut().for_each(|frame| frame.stamp_ns += 1_000_000_000_000);
    let error = compare(recording(true), frames, &Options::default()).unwrap_err().to_string();
    assert!(
        error.contains("110 messages outside") && error.contains("the recording ends at 8.720 s"),
        "{error}"
    );
    let mut frames = exported(recording(true), 1);
    straight(&mut frames, 100_000_000, 3);
    let error = compare(recording(true), frames, &Options::default()).unwrap_err().to_string();
    assert_eq!(error, "half of the bag's paths end within 0.3 s, and a step is 0.4 s");
}
