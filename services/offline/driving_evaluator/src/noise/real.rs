//! Forecasts of recorded vehicles under noise.
//!
//! Each recording passes through a simulated sensor and then through the pipeline. The forecasts are compared
//! with the recorded motion, and with the forecasts of the same agents at the same times without noise.

use std::collections::BTreeMap;

use data::RecordedTrack;
use evaluator::{MOVING_MPS, Noise, threads};
use evidence::{MotionNow, Priors};
use metrics::{Errors, displacement, min_displacement};
use nn::ModelConfig;
use onboard::Chain;
use scene::AgentType;
use source::{Playback, PlaybackOptions};
use wire::Forecast;

use super::sheet::{COUNTS, Row, Sheet};
use crate::matching::agents;
use crate::play::run;
use crate::sample::GAP_NS;
use crate::source::Source;
use crate::{DrivingError, Options, model_of, sources};

/// Standard deviations of a position per axis.
const SIGMAS_M: [f64; 5] = [0.0, 0.05, 0.1, 0.2, 0.3];
/// Standard deviation of a reported heading with noise: 2 degrees.
const HEADING_RAD: f64 = 2.0 * std::f64::consts::PI / 180.0;
/// Time between two forecasts of an agent that count.
const EVERY_NS: i64 = 400_000_000;

/// Errors of recorded vehicles under noise.
#[derive(Clone, Debug, PartialEq)]
pub struct NoiseReport {
    sheet: Sheet,
}

/// What detections report.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fields {
    Positions,
    PositionsAndSigma,
    All,
}

/// A run of a source.
struct Job<'a> {
    source: &'a Source,
    noise: Noise,
    fields: Fields,
}

/// A forecast: place of the recording in its source, agent, time.
type Key = (usize, u64, i64);

/// Errors at the horizon.
#[derive(Clone, Copy, Debug)]
struct Ends {
    /// The single best forecast.
    best_m: f64,
    /// The best of the modes.
    best_of_m: f64,
    /// Constant velocity from the true state.
    steady_m: f64,
}

/// Plays the sources with every noise. Of each source at most `scenes` recordings are played, spread evenly over
/// their names. Calls `progress` with each run before it starts.
///
/// # Errors
/// [`DrivingError`] names the folder, recording or weights at fault.
pub fn under_noise(
    options: &Options,
    scenes: usize,
    progress: impl Fn(&str) + Sync,
) -> Result<NoiseReport, DrivingError> {
    let weights = model_of(options)?;
    let model = weights.config();
    let mut sources = sources(&options.folder, &options.sources)?;
    sources.iter_mut().for_each(|source| source.files = spread(&source.files, scenes));
    let jobs: Vec<Job<'_>> = sources.iter().flat_map(jobs_of).collect();
    let played = threads::each(&jobs, options.threads, |job, _: &mut ()| {
        progress(&format!("{}, {}", job.source.name, job.names()[1..].join(", ")));
        job.play(options, model)
    });
    let played = played.into_iter().collect::<Result<Vec<_>, _>>()?;
    let mut sheet = sheet(scenes, model.horizon_len as f64 * model.dt_s);
    // The first run of a source is the one without noise.
    let mut clean = &BTreeMap::new();
    for (job, played) in jobs.iter().zip(&played) {
        if job.noise.is_none() {
            clean = played;
        }
        sheet.rows.push(Row { names: job.names(), values: figures(played, clean) });
    }
    Ok(NoiseReport { sheet })
}

/// At most `len` items at even distances.
fn spread<T: Clone>(items: &[T], len: usize) -> Vec<T> {
    let len = len.clamp(1, items.len().max(1));
    (0..len).filter_map(|place| items.get(place * items.len() / len).cloned()).collect()
}

/// The runs of a source; the one without any change first.
fn jobs_of(source: &Source) -> Vec<Job<'_>> {
    let mut jobs = Vec::new();
    for without_ids in [false, true] {
        for fields in [Fields::All, Fields::Positions, Fields::PositionsAndSigma] {
            for sigma_m in SIGMAS_M {
                // Without noise there is no sigma to report.
                if sigma_m == 0.0 && fields == Fields::PositionsAndSigma {
                    continue;
                }
                let noise = Noise {
                    sigma_m,
                    heading_rad: if sigma_m > 0.0 { HEADING_RAD } else { 0.0 },
                    without_ids,
                    positions_only: fields != Fields::All,
                    reports_sigma: fields == Fields::PositionsAndSigma,
                    seed: 1,
                    ..Noise::default()
                };
                jobs.push(Job { source, noise, fields });
            }
        }
    }
    jobs
}

fn sheet(scenes: usize, horizon_s: f64) -> Sheet {
    Sheet {
        title: "Recorded vehicles",
        note: format!(
            "FDE in m after {horizon_s:.1} s of moving vehicles ({MOVING_MPS} m/s or more), a forecast every 0.4 s. At most \
             {scenes} recordings of each source, spread evenly. *All fields* keeps the recorded headings and speeds, with \
             noise of 2 degrees and of σ / 1 s if the positions have noise. *Clean* is the run without any change (first row \
             of each source), on the forecasts that both runs have. *True CV* is constant velocity from the true state."
        ),
        names: vec!["source", "detections", "fields", "noise"],
        columns: vec![COUNTS, "FDE", "minFDE₂₀", "FDE / clean", "minFDE₂₀ / clean", "FDE / true CV"],
        rows: Vec::new(),
    }
}

/// The numbers of a row.
fn figures(played: &BTreeMap<Key, Ends>, clean: &BTreeMap<Key, Ends>) -> Vec<Option<f64>> {
    let sum = |of: fn(&Ends) -> f64| played.values().map(of).sum::<f64>();
    let mean = |of: fn(&Ends) -> f64| (!played.is_empty()).then(|| sum(of) / played.len() as f64);
    let ratio = |a: f64, b: f64| (b > 0.0).then(|| a / b);
    let both = || played.iter().filter_map(|(key, ends)| Some((ends, clean.get(key)?)));
    let to_clean = |of: fn(&Ends) -> f64| {
        let (ours, theirs) = both().fold((0.0, 0.0), |(ours, theirs), (a, b)| (ours + of(a), theirs + of(b)));
        ratio(ours, theirs)
    };
    let [best, best_of]: [fn(&Ends) -> f64; 2] = [|of| of.best_m, |of| of.best_of_m];
    vec![
        Some(played.len() as f64),
        mean(best),
        mean(best_of),
        to_clean(best),
        to_clean(best_of),
        ratio(sum(best), sum(|of| of.steady_m)),
    ]
}

impl NoiseReport {
    /// The table as Markdown.
    pub fn markdown(&self) -> String {
        self.sheet.markdown()
    }

    /// One line per number.
    pub fn csv(&self) -> String {
        self.sheet.csv()
    }

    /// The table by its title.
    pub fn json(&self) -> serde_json::Value {
        self.sheet.json()
    }
}

impl Job<'_> {
    fn names(&self) -> Vec<String> {
        let fields = match self.fields {
            Fields::Positions => "positions",
            Fields::PositionsAndSigma => "positions, sigma",
            Fields::All => "all fields",
        };
        let ids = if self.noise.without_ids { "no ids" } else { "ids" };
        let noise = format!("{} m", self.noise.sigma_m);
        vec![self.source.name.clone(), ids.to_owned(), fields.to_owned(), noise]
    }

    /// Plays the source as one run, as `evaluate driving` does.
    fn play(&self, options: &Options, model: &ModelConfig) -> Result<BTreeMap<Key, Ends>, DrivingError> {
        let mut ends = BTreeMap::new();
        let mut before: Option<Chain> = None;
        for (place, path) in self.source.files.iter().enumerate() {
            let clean = self.source.open(path)?;
            let truth: BTreeMap<u64, RecordedTrack> =
                data::tracks(&clean).into_iter().map(|track| (track.id, track)).collect();
            let noisy = self.noise.applied_to(&clean);
            let has_identities = noisy.has_identities;
            let mut playback =
                Playback::new(noisy, PlaybackOptions { lockstep: true, ..PlaybackOptions::default() });
            let mut chain = Chain::new(&run(&playback, options, None)?, model)?;
            match before.take() {
                Some(before) => chain.continue_from(before),
                None => chain.expect(Priors::shipped().without(&self.source.folder_name())),
            }
            let mut counted = None;
            while let Some(tick) = playback.next_tick() {
                let stamp_ns = tick.header.stamp_ns;
                let (_, forecasts) = chain.tick(&tick.header, tick.detections, |_| ());
                let number = stamp_ns.div_euclid(EVERY_NS);
                if counted.replace(number) == Some(number) {
                    continue;
                }
                for (forecast, agent) in
                    forecasts.iter().zip(agents(forecasts, &truth, stamp_ns, has_identities))
                {
                    let of_agent = agent.and_then(|agent| Some((agent, truth.get(&agent)?)));
                    let Some((agent, track)) = of_agent else { continue };
                    if let Some(of_forecast) = judge(stamp_ns, forecast, track, model) {
                        ends.insert((place, agent, stamp_ns), of_forecast);
                    }
                }
            }
            before = Some(chain);
        }
        Ok(ends)
    }
}

/// The errors of a moving vehicle's forecast; `None` if it does not count or the recording lacks its future.
fn judge(stamp_ns: i64, forecast: &Forecast, track: &RecordedTrack, model: &ModelConfig) -> Option<Ends> {
    let now = track.state_at(stamp_ns, i64::MAX, GAP_NS)?;
    let is_vehicle = track.reported_at(stamp_ns).agent_type == AgentType::Vehicle;
    if !is_vehicle || now.speed_mps() < MOVING_MPS || forecast.modes_len < 2 {
        return None;
    }
    let len = model.horizon_len;
    let truth = (1..=len as i64).map(|step| {
        let at_ns = stamp_ns + step * model.step_ns().cast_signed();
        track.state_at(at_ns, i64::MAX, GAP_NS).map(|state| Some(state.position_m))
    });
    let truth: Vec<Option<[f32; 2]>> = truth.collect::<Option<_>>()?;
    let mut steady = vec![[0.0; 2]; len];
    MotionNow::since(now.position_m, now.velocity_mps, None).steady(model.dt_s as f32, &mut steady);
    let modes = &forecast.modes[..forecast.modes_len as usize];
    Some(Ends {
        best_m: Errors::of(displacement(&forecast.best, &truth)).fde_m,
        best_of_m: Errors::of(min_displacement(modes, &truth)).fde_m,
        steady_m: Errors::of(displacement(&steady, &truth)).fde_m,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ends(best_m: f64) -> Ends {
        Ends { best_m, best_of_m: best_m / 2.0, steady_m: 4.0 }
    }

    #[test]
    fn ratios_to_the_clean_run_use_the_forecasts_of_both() {
        let clean = [((0, 1, 0), ends(1.0)), ((0, 2, 0), ends(2.0)), ((0, 3, 0), ends(50.0))].into();
        let noisy = [((0, 1, 0), ends(2.0)), ((0, 2, 0), ends(4.0)), ((1, 2, 0), ends(9.0))].into();
        let expected = [3.0, 5.0, 2.5, 2.0, 2.0, 1.25].map(Some);
        assert_eq!(figures(&noisy, &clean), expected);
        assert_eq!(figures(&BTreeMap::new(), &clean), [Some(0.0), None, None, None, None, None]);
    }

    #[test]
    fn recordings_are_spread_over_a_source() {
        let items: Vec<u32> = (0..47).collect();
        assert_eq!(spread(&items, 4), [0, 11, 23, 35]);
        assert_eq!(spread(&items[..3], 8), [0, 1, 2]);
        assert_eq!(spread(&[] as &[u32], 8), [] as [u32; 0]);
    }

    #[test]
    fn the_first_run_of_a_source_is_clean_and_no_other_one_is() {
        let source = Source { name: String::new(), folder: "a".into(), files: Vec::new(), scale: 1.0 };
        let jobs = jobs_of(&source);
        assert!(jobs[0].noise.is_none() && jobs[1..].iter().all(|job| !job.noise.is_none()));
        let mut names: Vec<Vec<String>> = jobs.iter().map(Job::names).collect();
        names.sort();
        names.dedup();
        assert_eq!(names.len(), jobs.len());
    }
}
