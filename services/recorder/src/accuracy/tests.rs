use bytemuck::Zeroable;
use wire::{Cause, Counts};

use super::*;

const TICK_NS: i64 = 80_000_000;
const STEP_NS: i64 = 400_000_000;
const HORIZON_LEN: usize = 12;
/// Number of ticks within a horizon.
const HORIZON_TICKS: i64 = HORIZON_LEN as i64 * STEP_NS / TICK_NS;

fn header(tick: i64, agents_len: usize) -> Header {
    let counts =
        Counts { agents_len: agents_len as u32, horizon_len: HORIZON_LEN as u32, ..Counts::default() };
    Header { counts, step_ns: STEP_NS as u64, ..Header::new(1, tick as u64, tick * TICK_NS) }
}

/// An agent that drives along x at 10 m/s from `y_m`.
fn truth(id: u64, tick: i64, y_m: f32) -> Truth {
    let x_m = (10.0 * (tick * TICK_NS) as f64 / 1e9) as f32;
    Truth { id, agent_type: AgentType::Vehicle as u32, x_m, y_m, ..Truth::default() }
}

/// The exact forecast of this agent. Its second mode is 3 m to the left, and its single best 1 m to the left.
fn forecast(source_id: u64, tick: i64, y_m: f32) -> Forecast {
    let now_s = (tick * TICK_NS) as f64 / 1e9;
    let path = |offset_m: f32| {
        std::array::from_fn(|k| {
            let t_s = now_s + (k as f64 + 1.0) * STEP_NS as f64 / 1e9;
            [(10.0 * t_s) as f32, y_m + offset_m]
        })
    };
    let mut forecast = Forecast {
        id: 100,
        source_id,
        modes_len: 2,
        x_m: (10.0 * now_s) as f32,
        y_m,
        vx_mps: 10.0,
        best: path(1.0),
        ..Forecast::zeroed()
    };
    forecast.modes[0] = path(3.0);
    forecast.modes[1] = path(0.0);
    forecast
}

/// Plays `ticks` ticks of truth with their forecasts.
fn play(ticks: i64, truths: impl Fn(i64) -> Vec<Truth>, forecasts: impl Fn(i64) -> Vec<Forecast>) -> Scorer {
    let mut scorer = Scorer::default();
    for tick in 0..ticks {
        scorer.truth(&header(tick, 0), &truths(tick)).unwrap();
        let forecasts = forecasts(tick);
        scorer.forecasts(&header(tick, forecasts.len()), &forecasts);
    }
    scorer
}

fn close(found: Option<f64>, expected: f64) {
    let found = found.expect("known");
    assert!((found - expected).abs() < 1e-4, "{found}, expected {expected}");
}

#[test]
fn exact_forecasts_have_no_error() {
    let scorer = play(100, |tick| vec![truth(7, tick, 2.0)], |tick| vec![forecast(7, tick, 2.0)]);
    let accuracy = scorer.accuracy();
    assert_eq!(accuracy.errors.forecasts, 100 - HORIZON_TICKS as u64);
    close(accuracy.errors.ade_m, 0.0);
    close(accuracy.errors.fde_m, 0.0);
    close(accuracy.errors.cv_ade_m, 0.0);
    close(accuracy.errors.cv_fde_m, 0.0);
    close(accuracy.errors.single_ade_m, 1.0);
    close(accuracy.errors.single_fde_m, 1.0);
    assert_eq!((accuracy.draws, accuracy.horizon_s), (Some(2), Some(4.8)));
    assert_eq!((accuracy.uncovered, accuracy.unmatched), (HORIZON_TICKS as u64, 0));
    assert_eq!(accuracy.by_type.keys().collect::<Vec<_>>(), ["vehicle"]);
    assert_eq!(accuracy.learned, accuracy.errors);
}

#[test]
fn known_offsets_are_the_errors() {
    // Without the exact mode, the best mode is 3 m off. Constant velocity at 9 m/s loses 1 m per second.
    let scorer = play(
        100,
        |tick| vec![truth(7, tick, 2.0)],
        |tick| vec![Forecast { modes_len: 1, vx_mps: 9.0, ..forecast(7, tick, 2.0) }],
    );
    let errors = scorer.accuracy().errors;
    close(errors.ade_m, 3.0);
    close(errors.fde_m, 3.0);
    close(errors.miss_rate, 1.0);
    close(errors.single_miss_rate, 0.0);
    close(errors.cv_ade_m, 0.4 * 6.5);
    close(errors.cv_fde_m, 4.8);
}

#[test]
fn steps_between_recorded_truths_are_interpolated() {
    // Every third tick has truth (240 ms), so only every fifth step coincides with one.
    let scorer = play(
        120,
        |tick| if tick % 3 == 0 { vec![truth(7, tick, 2.0)] } else { Vec::new() },
        |tick| if tick == 1 { vec![forecast(7, tick, 2.0)] } else { Vec::new() },
    );
    let errors = scorer.accuracy().errors;
    assert_eq!(errors.forecasts, 1);
    close(errors.ade_m, 0.0);
}

#[test]
fn without_identities_the_nearest_of_the_type_is_matched() {
    let scorer = play(
        100,
        |tick| vec![truth(1, tick, 0.0), truth(2, tick, 5.0)],
        |tick| vec![forecast(0, tick, 5.5), forecast(0, tick, 2.3)],
    );
    let accuracy = scorer.accuracy();
    assert_eq!(accuracy.unmatched, 100 - HORIZON_TICKS as u64, "2.3 m and more from all agents");
    close(accuracy.errors.ade_m, 0.5);
}

#[test]
fn an_agent_that_leaves_is_not_scored() {
    let scorer = play(
        100,
        |tick| if tick < 30 { vec![truth(7, tick, 2.0)] } else { Vec::new() },
        |tick| if tick < 30 { vec![forecast(7, tick, 2.0)] } else { Vec::new() },
    );
    let accuracy = scorer.accuracy();
    assert_eq!((accuracy.errors.forecasts, accuracy.draws), (0, None));
    assert_eq!(accuracy.errors.ade_m, None);
    assert_eq!(accuracy.uncovered + accuracy.unmatched, 30);
}

#[test]
fn learned_forecasts_have_errors_of_their_own() {
    let scorer = play(
        100,
        |tick| vec![truth(7, tick, 2.0)],
        |tick| {
            let fallback = Forecast {
                quality: Quality::Kinematic as u32,
                cause: Cause::Late as u32,
                modes_len: 1,
                ..forecast(7, tick, 2.0)
            };
            vec![if tick % 2 == 0 { forecast(7, tick, 2.0) } else { fallback }]
        },
    );
    let accuracy = scorer.accuracy();
    close(accuracy.learned.ade_m, 0.0);
    close(accuracy.errors.ade_m, 1.5);
    assert_eq!(accuracy.learned.forecasts * 2, accuracy.errors.forecasts);
}

#[test]
fn reading_the_errors_changes_nothing() {
    let mut asked = Scorer::default();
    let mut left_alone = Scorer::default();
    for tick in 0..200 {
        for scorer in [&mut asked, &mut left_alone] {
            scorer.truth(&header(tick, 0), &[truth(7, tick, 2.0)]).unwrap();
            scorer.forecasts(&header(tick, 1), &[forecast(7, tick, 2.5)]);
        }
        let _ = asked.accuracy();
    }
    assert_eq!(asked.accuracy(), left_alone.accuracy());
}

#[test]
fn queues_stay_bounded_with_and_without_truth() {
    let bound = (HORIZON_TICKS + (GAP_MAX_NS + LAG_MAX_NS) / TICK_NS + 2) as usize;
    let mut without_truth = Scorer::default();
    for tick in 0..10_000 {
        without_truth.forecasts(&header(tick, 1), &[forecast(7, tick, 2.0)]);
        assert!(without_truth.waiting_count() <= bound, "{} ticks wait", without_truth.waiting_count());
    }
    assert_eq!(without_truth.accuracy(), Accuracy::default());
    let with_truth = play(10_000, |tick| vec![truth(7, tick, 2.0)], |tick| vec![forecast(7, tick, 2.0)]);
    assert!(with_truth.waiting_count() <= bound, "{} ticks wait", with_truth.waiting_count());
    assert!(with_truth.spare.len() + with_truth.waiting_count() <= bound);
    assert!(with_truth.paths.sample_count() <= bound, "{} truths kept", with_truth.paths.sample_count());
}
