//! Tests which agents' residuals are retrieved, when, and how they change controls.

use crate::passing::{AT_ZERO, HORIZON_LEN, STEP_NS, STEP_S, after, at_x, pass, retrieve, straight};
use kinematics::{ControlLimits, MotionKind, MotionModel, MotionOptions, MotionStart};
use retrieval::{
    BicycleKey, ControlAdapter, ControlChanges, DisplacementKey, ForecastControls, Key, Query, Retrieval,
    RetrievalMemory, Retrieved, Unstored,
};
use wire::ControlGaussian;

/// A vehicle at the origin at 8 m/s along x; its controls hardly saturate.
fn vehicle() -> MotionModel {
    let start = MotionStart { velocity_mps: [8.0, 0.0], length_m: Some(4.0), ..MotionStart::default() };
    let limits = ControlLimits { accel_mps2: 100.0, slip_rate_radps: 10.0 };
    let options = MotionOptions { rear_axle_ratio: 0.3, limits, ..MotionOptions::default() };
    MotionModel::new(MotionKind::Bicycle, &start, &options, STEP_S)
}

/// The expected changes of acceleration of another agent.
fn accelerations(memory: &RetrievalMemory, x_m: f32) -> Vec<f32> {
    let changes = retrieve(memory, 99, &at_x(x_m)).expected.control_change(&vehicle());
    changes[..HORIZON_LEN].iter().map(|[acceleration, _]| *acceleration).collect()
}

#[test]
fn braking_is_expected_where_others_braked() {
    for tick_s in [0.5, 0.1, 0.08] {
        let memory = after(60, -1.0, tick_s, 3.0);
        let found = accelerations(&memory, 0.2);
        assert!(found[1..3].iter().all(|found| (found + 1.0).abs() < 0.15), "ticks of {tick_s} s: {found:?}");
        // The last known residual is the mean speed over the last step.
        let slower_mps = found.iter().sum::<f32>() * STEP_S;
        assert!((slower_mps + 1.75).abs() < 0.1, "ticks of {tick_s} s: {slower_mps}");
    }
}

/// The agents are randomly faster and slower than forecast, so that almost nothing is expected.
#[test]
fn residuals_without_a_common_mean_shrink_to_nothing() {
    let mut memory = RetrievalMemory::new(HORIZON_LEN, STEP_NS);
    let mut now_ns = 0;
    for agent in 1..=200_u64 {
        let acceleration = if agent.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 63 == 0 { 1.5 } else { -1.5 };
        let path = |t_s: f32| [8.0 * t_s + 0.5 * acceleration * t_s * t_s, 0.0];
        let when = (now_ns, STEP_S, HORIZON_LEN as f32 * STEP_S);
        now_ns = pass(&mut memory, (agent, at_x(0.0)), &straight(), when, path) + 10_000_000_000;
    }
    let found = accelerations(&memory, 0.0);
    assert!(found.iter().all(|found| found.abs() < 0.15), "{found:?}");
}

#[test]
fn only_steps_that_were_taken_count() {
    let memory = after(20, -1.0, 0.5, 1.0);
    let found = accelerations(&memory, 0.0);
    assert!(found[0] < -0.5, "{found:?}");
    assert_eq!(found[2..], [0.0; 2], "what is not known stays as it is");
    assert!(retrieve(&memory, 99, &at_x(0.0)).neighbours.is_empty(), "no path is complete");
}

#[test]
fn own_entries_and_dissimilar_keys_are_not_retrieved() {
    let memory = after(1, -1.0, 0.5, 3.0);
    let finds = |agent: u64, key: Key| !retrieve(&memory, agent, &key).expected.is_empty();
    assert!(finds(2, at_x(0.0)));
    assert!(!finds(1, at_x(0.0)), "of oneself");
    assert!(!finds(2, at_x(9.0)), "elsewhere");
    assert!(!finds(2, Key::Bicycle(BicycleKey { heading_rad: 1.0, ..AT_ZERO })), "another way");
    assert!(!finds(2, Key::Bicycle(BicycleKey { speed_mps: 2.0, ..AT_ZERO })), "another speed");
}

#[test]
fn another_session_restarts_time_and_agent_numbers() {
    let mut memory = after(1, -1.0, 0.5, 3.0);
    assert!(!memory.observe(0, []), "time does not go back");
    memory.end_session();
    assert!(memory.observe(0, []));
    assert!(!retrieve(&memory, 1, &at_x(0.0)).is_empty(), "another agent of the same number");
}

/// If a crowd exceeds the limit, some agents are not stored. After the crowd has left, others are stored.
#[test]
fn a_crowd_beyond_the_limit_is_stored_in_part() {
    let mut memory = RetrievalMemory::new(HORIZON_LEN, STEP_NS);
    for (crowd, stamp_ns) in [(0..600, 0), (600..1_200, 10_000_000_000)] {
        assert!(memory.observe(stamp_ns, crowd.clone().map(|agent| (agent, [0.0; 2]))));
        for agent in crowd {
            let query = Query { stamp_ns, agent, key: at_x(0.0) };
            memory.retrieve_and_store(&query, &straight(), &mut Retrieved::default());
        }
    }
    assert_eq!(memory.entry_count(), 2 * 512);
}

#[test]
fn agents_are_stored_once_a_step_and_never_late() {
    let mut memory = RetrievalMemory::new(HORIZON_LEN, STEP_NS);
    let mut store = |agent: u64, stamp_ns: i64| {
        let query = Query { stamp_ns, agent, key: at_x(0.0) };
        memory.retrieve_and_store(&query, &straight(), &mut Retrieved::default());
        let stored = memory.entry_count();
        memory.observe(stamp_ns + 100_000_000, [(1, [0.0; 2])]);
        stored
    };
    assert_eq!(store(1, 0), 0, "not observed yet");
    assert_eq!(store(1, 100_000_000), 1);
    assert_eq!(store(1, 200_000_000), 1, "within the step");
    assert_eq!(store(1, 200_000_000), 1, "late");
    assert_eq!(store(2, 300_000_000), 1, "another that was not observed");
}

#[test]
fn vehicles_that_stand_have_no_key() {
    let state =
        |speed_mps: f32| Some(scene::State { velocity_mps: [speed_mps, 0.0], ..scene::State::default() });
    let key = |history: &[_]| Key::new(MotionKind::Bicycle, history, STEP_S);
    assert_eq!(key(&[state(3.0), state(0.05)]), None);
    assert_eq!(key(&[state(3.0), None]), None);
    let slowing = key(&[state(3.0), state(2.0)]);
    let Some(Key::Bicycle(slowing)) = slowing else { panic!("{slowing:?}") };
    assert_eq!(slowing.acceleration_mps2, -2.0);
    let key = |history: &[_]| Key::new(MotionKind::Displacement, history, STEP_S);
    assert!(key(&[state(3.0), state(0.0)]).is_some(), "pedestrians that stand have one");
    assert_eq!(key(&[None, state(1.0)]), None);
}

/// Pedestrians at 1.25 m/s along the diagonal, with a straight forecast; they turn left from the origin.
#[test]
fn turning_left_is_expected_where_others_turned_left() {
    let mut memory = RetrievalMemory::new(HORIZON_LEN, STEP_NS);
    let at = |position_m| Key::Displacement(DisplacementKey { position_m, velocity_mps: [0.75, 1.0] });
    let straight: Vec<[f32; 2]> =
        (1..=HORIZON_LEN).map(|step| [0.375 * step as f32, 0.5 * step as f32]).collect();
    let left = |t_s: f32| {
        let step = t_s / STEP_S;
        let [along, across] = [0.625 * step, 0.05 * (step * step)];
        [0.6 * along - 0.8 * across, 0.8 * along + 0.6 * across]
    };
    let mut now_ns = 0;
    for agent in 1..=40 {
        let when = (now_ns, STEP_S, HORIZON_LEN as f32 * STEP_S);
        now_ns = pass(&mut memory, (agent, at([0.0; 2])), &straight, when, left) + 10_000_000_000;
    }
    let retrieved = retrieve(&memory, 99, &at([0.1, -0.1]));
    let start = MotionStart { frame_heading_rad: 1.0_f32.atan2(0.75), ..MotionStart::default() };
    let model = MotionModel::new(MotionKind::Displacement, &start, &MotionOptions::default(), STEP_S);
    let found = retrieved.expected.control_change(&model);
    let across: f32 = found[..HORIZON_LEN].iter().map(|[_, left]| left).sum();
    assert!((across - 0.8).abs() < 0.15, "{found:?}");
    assert!(found[..HORIZON_LEN].iter().all(|[along, _]| along.abs() < 0.02), "{found:?}");
    assert!(retrieved.neighbours.len() > 20, "{}", retrieved.neighbours.len());
    let beside = retrieve(&memory, 99, &at([7.5, 0.0]));
    assert!(
        beside.expected.is_empty() && !beside.neighbours.is_empty(),
        "too far for the mean, not for a neighbour"
    );
    assert!(retrieve(&memory, 99, &at([12.0, 0.0])).is_empty(), "too far");
    let driver = Key::Bicycle(BicycleKey { heading_rad: 0.9, speed_mps: 1.25, ..AT_ZERO });
    assert!(retrieve(&memory, 99, &driver).is_empty(), "of the other kind");
}

/// Two modes, one straight and one slightly faster, and a straight best forecast, all with the same
/// deviations.
struct Forecast {
    modes: [Vec<ControlGaussian>; 2],
    best: Vec<ControlGaussian>,
}

impl Forecast {
    fn new() -> Self {
        let controls = |mean| vec![ControlGaussian { mean, cholesky: [0.3, 0.1, 0.2] }; HORIZON_LEN];
        Self { modes: [controls([0.0; 2]), controls([0.1, 0.0])], best: controls([0.0; 2]) }
    }

    fn controls(&self) -> ForecastControls<'_, Vec<ControlGaussian>> {
        ForecastControls { modes: &self.modes, probability: &[0.7, 0.3], best: &self.best }
    }
}

/// Final positions with changed controls: of the best forecast and of the modes.
fn ends_m(changes: &ControlChanges, forecast: &Forecast) -> [f32; 3] {
    let end = |means: &mut dyn Iterator<Item = [f32; 2]>| {
        let mut path = [[0.0; 2]; HORIZON_LEN];
        vehicle().positions(means, &mut path);
        path[HORIZON_LEN - 1][0]
    };
    let controls = forecast.controls();
    let [first, second] = [0, 1].map(|mode| end(&mut changes.mode(mode, &controls).map(|c| c.mean)));
    [end(&mut changes.best(&controls)), first, second]
}

#[test]
fn controls_stay_where_nothing_is_retrieved() {
    let forecast = Forecast::new();
    let mut changes = ControlChanges::default();
    ControlAdapter::default().adapt(&Retrieved::default(), &vehicle(), &forecast.controls(), &mut changes);
    assert_eq!(changes.probability(), [0.7, 0.3]);
    for (mode, own) in forecast.modes.iter().enumerate() {
        assert!(changes.mode(mode, &forecast.controls()).eq(own.iter().copied()));
    }
    assert!(changes.best(&forecast.controls()).eq(forecast.best.iter().map(|control| control.mean)));
}

/// All others braked at 1 m/s². The best forecast then brakes, and their path replaces a mode.
#[test]
fn the_best_forecast_changes_and_a_mode_is_replaced() {
    let (forecast, mut changes) = (Forecast::new(), ControlChanges::default());
    let mut memory = after(60, -1.0, 0.5, 3.0);
    let query = Query { stamp_ns: i64::MAX, agent: 99, key: at_x(0.0) };
    let unstored =
        Retrieval::default().adapt((&memory, &[]), &query, &vehicle(), &forecast.controls(), &mut changes);
    memory.store(&unstored);
    let [best_m, first_m, second_m] = ends_m(&changes, &forecast);
    let braked_m = 14.0;
    assert!((best_m - braked_m).abs() < 0.3, "{best_m}");
    // Half of the expected change, from 16 m.
    assert!((first_m - 15.0).abs() < 0.2, "{first_m}");
    assert!((second_m - braked_m).abs() < 0.3, "a neighbour's path: {second_m}");
    let sum: f32 = changes.probability().iter().sum();
    assert!((sum - 1.0).abs() < 1e-6 && changes.probability()[1] > 0.9, "{:?}", changes.probability());
    let controls = forecast.controls();
    assert!(changes.mode(0, &controls).all(|control| control.cholesky == [0.3, 0.1, 0.2]), "deviations stay");
    assert_eq!(memory.entry_count(), 60, "a query of another time is not stored");
}

/// Retrieving for a frame's agents at the same time gives the same results as retrieving in turn, also if
/// their entries push out older ones.
#[test]
fn retrieving_for_a_frame_at_a_time_is_retrieving_one_after_the_other() {
    // More entries than a search covers: an entry that a further one pushes out is not found.
    let mut serial = after(300, -1.0, 0.5, 3.0);
    let stamp_ns = 10_000 * STEP_NS.cast_signed();
    let agents = 1_000..1_040_u64;
    let queries = agents.map(|agent| Query { stamp_ns, agent, key: at_x(0.02 * (agent - 1_000) as f32) });
    let queries: Vec<Query> = queries.collect();
    assert!(serial.observe(stamp_ns, queries.iter().map(|query| (query.agent, [0.0; 2]))));
    let mut parallel = serial.clone();
    let before = parallel.clone();
    let (mut ahead, mut unstored, mut found) = (Vec::new(), Vec::new(), Vec::new());
    for query in &queries {
        assert!(parallel.would_store(stamp_ns, query.agent));
        let mut retrieved = Retrieved::default();
        parallel.retrieve_behind(&ahead, query.agent, &query.key, &mut retrieved);
        unstored.push(Unstored::new(query, &straight(), &retrieved));
        ahead.push(query.key.bucket());
        found.push(retrieved);
    }
    unstored.iter().for_each(|unstored| parallel.store(unstored));
    assert_eq!(serial.entry_count() + queries.len(), parallel.entry_count());
    for (query, found) in queries.iter().zip(&found) {
        let mut retrieved = Retrieved::default();
        serial.retrieve_and_store(query, &straight(), &mut retrieved);
        assert_eq!(*found, retrieved, "agent {}", query.agent);
        assert!(!parallel.would_store(stamp_ns, query.agent), "once a step at most");
    }
    let last = queries[queries.len() - 1];
    assert_ne!(found[queries.len() - 1], retrieve(&before, last.agent, &last.key), "others came first");
}
