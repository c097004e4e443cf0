//! Tracking of INTERACTION's vehicles from noisy positions with gaps, by filters with and without forecasts.

use std::collections::{BTreeMap, BTreeSet};

use data::sets::{DataSet, Part};
use metrics::tracking::PlanarState;
use scene::{AgentType, ContextMap};

use super::{
    Course, Follower, MethodErrors, Outcome, Place, Sensor, TrackingMethod, TrackingReport, Trials, tune,
};
use crate::error::EvaluateError;
use crate::footage::{Footage, Options, SEED, map_of};
use crate::forecaster::Model;
use crate::lines::{ForecastLines, Motion, TrackLine};
use crate::page::Page;
use crate::scenes::Cut;
use crate::threads;

const SET: DataSet = DataSet::Interaction;
/// The recipe of the weights whose forecasts are the prior. It trains on the training part of the same data
/// set.
const RECIPE: &str = "interaction";
/// Standard deviations of the measured positions, m.
const SIGMAS_M: [f64; 5] = [0.01, 0.02, 0.05, 0.1, 0.3];
/// Lengths of the gaps, s.
const GAPS_S: [f64; 4] = [0.0, 0.8, 1.6, 3.2];
/// Evaluated time from the middle of each recording, s.
const EVALUATED_S: f64 = 60.0;
/// Time from the middle of each recording on which settings are tuned, s.
const TUNED_S: f64 = 40.0;

/// Prior knowledge of each site.
type Places<'a> = BTreeMap<String, Place<'a>>;

/// Estimates motion with every method for every noise and gap, and reports the errors.
///
/// Settings are tuned on the validation part, which neither the model's training nor the figures use. Tuning
/// includes gaps of each length. Map and retrieval memory of a site come from the training part.
///
/// `sigmas_m` are standard deviations of the measured positions, m; if empty, the protocol's values are used.
/// With `particles` the learned prior also runs by Monte Carlo.
///
/// # Errors
/// If weights or recordings are missing or of another kind.
pub fn interaction(
    options: &Options,
    sigmas_m: &[f64],
    particles: bool,
    mut progress: impl FnMut(&str),
) -> Result<Page, EvaluateError> {
    let model = options.weights.open(RECIPE, SEED)?;
    let cut = Cut::of(model.forecaster.config());
    progress("reading recordings");
    let validation = options.read_part(SET, Part::Validation, &cut)?;
    let evaluated = options.read_part(SET, options.part, &cut)?;
    progress("maps and retrieval memories of the training part");
    let training = options.read_part(SET, Part::Train, &cut)?;
    let sites: BTreeSet<String> = validation.iter().chain(&evaluated).map(Footage::site).collect();
    let maps = sites.into_iter().map(|site| (site.clone(), map_of(&training, &site))).collect();
    let places = places(options, &model, &training, &maps);
    let recordings: Vec<_> = evaluated.iter().map(|footage| &footage.recording).collect();
    let provenance = model.provenance("tracking", options.map.label(), &recordings);
    let methods = TrackingMethod::evaluated(particles);
    let mut report = TrackingReport::new(provenance, EVALUATED_S, TUNED_S);
    let sigmas_m = if sigmas_m.is_empty() { &SIGMAS_M } else { sigmas_m };
    for &sigma_m in sigmas_m {
        progress(&format!("measured within {sigma_m} m: tuning"));
        let trials =
            tune(&courses(&validation, &places, sigma_m), &model.forecaster, &methods, options.threads);
        for &gap_s in &GAPS_S {
            progress(&format!("measured within {sigma_m} m, gaps of {gap_s} s"));
            let sensor = Sensor { sigma_m, gap_s, seed: SEED };
            report.add(evaluate(&evaluated, &places, &model, sensor, &trials, options));
        }
        report.add_trials(sigma_m, trials);
    }
    Ok(report.page())
}

/// Map and retrieval memory of each site, from its training recordings.
fn places<'a>(
    options: &Options,
    model: &Model,
    training: &[Footage],
    maps: &'a BTreeMap<String, Option<ContextMap>>,
) -> Places<'a> {
    let place = |(site, map): (&String, &'a Option<ContextMap>)| {
        let map = options.map.input(map.as_ref());
        let mut memory = model.forecaster.memory();
        for Footage { recording, scenes } in training.iter().filter(|footage| footage.site() == *site) {
            model.forecaster.visit(recording, scenes, map, options.threads, &mut memory);
        }
        (site.clone(), Place { map, memory: Some(memory) })
    };
    maps.iter().map(place).collect()
}

/// One recording per site to tune on. The gap lengths alternate from site to site.
fn courses<'a>(footage: &[Footage], places: &'a Places<'_>, sigma_m: f64) -> Vec<Course<'a>> {
    let sites: BTreeMap<String, &Footage> = footage.iter().map(|footage| (footage.site(), footage)).collect();
    let course = |(footage, &gap_s): (&&Footage, &f64)| {
        course(footage, places, TUNED_S, Sensor { sigma_m, gap_s, seed: SEED + 1 })
    };
    sites.values().zip(GAPS_S.iter().cycle()).map(course).collect()
}

/// `seconds` from the middle of a recording.
fn course<'a>(footage: &Footage, places: &'a Places<'_>, seconds: f64, sensor: Sensor) -> Course<'a> {
    let frames = &footage.recording.frames;
    let ends =
        frames.first().zip(frames.last()).map_or([0; 2], |(first, last)| [first.stamp_ns, last.stamp_ns]);
    let middle_ns = i64::midpoint(ends[0], ends[1]);
    let half_ns = (seconds / 2.0 * 1e9) as i64;
    Course::new(
        &footage.recording,
        [middle_ns - half_ns, middle_ns + half_ns],
        sensor,
        &places[&footage.site()],
    )
}

/// Runs every method on every recording.
fn evaluate(
    footage: &[Footage],
    places: &Places<'_>,
    model: &Model,
    sensor: Sensor,
    trials: &Trials,
    options: &Options,
) -> Vec<MethodErrors> {
    let (settings, forecaster) = (trials.settings, &model.forecaster);
    let methods = || trials.figures.iter().map(|&(method, _)| method);
    let follow = |footage: &Footage, (): &mut ()| {
        let course = course(footage, places, EVALUATED_S, sensor);
        let outcome = |method| Follower { method, settings, forecaster }.follow(&course);
        methods().map(outcome).collect::<Vec<_>>()
    };
    let outcomes = threads::each(footage, options.threads, follow);
    if let Some(lines) = &options.lines {
        for (footage, outcomes) in footage.iter().zip(&outcomes) {
            write(lines, &footage.recording.name, sensor, methods().zip(outcomes));
        }
    }
    let of_method = |(place, method)| MethodErrors::new(sensor, method, outcomes.iter().map(|of| &of[place]));
    methods().enumerate().map(of_method).collect()
}

/// Writes the estimates of all methods of a recording, instant by instant.
fn write<'a>(
    lines: &ForecastLines,
    recording: &str,
    sensor: Sensor,
    outcomes: impl Iterator<Item = (TrackingMethod, &'a Outcome)>,
) {
    let motion = |of: PlanarState| Motion { position_m: of.position_m, velocity_mps: Some(of.velocity_mps) };
    let mut instants: BTreeMap<(i64, u64), TrackLine<'_>> = BTreeMap::new();
    for (method, outcome) in outcomes {
        for error in &outcome.errors {
            let line = instants.entry((error.stamp_ns, error.id)).or_insert_with(|| TrackLine {
                part: "interaction",
                recording,
                stamp_ns: error.stamp_ns,
                agent: error.id,
                agent_type: AgentType::Vehicle.name(),
                sigma_m: sensor.sigma_m,
                gap_s: sensor.gap_s,
                is_measured: error.visible,
                truth: motion(error.truth),
                tracks: BTreeMap::new(),
            });
            line.tracks.insert(method.name(), motion(error.estimate));
        }
    }
    instants.values().for_each(|line| lines.add(line));
}
