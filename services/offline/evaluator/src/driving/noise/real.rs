//! Forecasts of recorded vehicles under noise.
//!
//! Each recording passes through a simulated sensor and then through the pipeline. The forecasts are compared
//! with the recorded motion, and with the forecasts of the same agents at the same times without noise.
//! [`under_noise`] varies the reports of the sensor. [`network_under_noise`] compares the network's own forecasts
//! with the published ones.

use std::collections::BTreeMap;

use evidence::MotionNow;
use metrics::{Errors, displacement, min_displacement};
use nn::ModelConfig;
use scene::AgentType;
use wire::Forecast;

use crate::driving::{
    play::EVERY_NS,
    source::{Source, sources},
};
use crate::error::EvaluateError;
use crate::footage::Options;
use crate::noise::Noise;
use crate::page::Page;
use crate::playback::Truth;
use crate::scenes::MOVING_MPS;
use crate::table::{Entry, Table};
use crate::threads;

/// Standard deviations of a position per axis.
const SIGMAS_M: [f64; 5] = [0.0, 0.05, 0.1, 0.2, 0.3];
/// Standard deviation of a reported heading with noise: 2 degrees.
const HEADING_RAD: f64 = 2.0 * std::f64::consts::PI / 180.0;

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
    /// Whether the forecasts are the network's own, without evidence.
    is_network: bool,
    /// Whether later runs are compared with this one.
    is_reference: bool,
}

/// A forecast: place of the recording in its source, agent, time.
type Key = (usize, u64, i64);

/// The errors of a run.
type AllEnds = BTreeMap<Key, Ends>;

/// Errors of a forecast; at the horizon, unless the field is named after the mean.
#[derive(Clone, Copy, Debug)]
struct Ends {
    /// The single best forecast.
    best_m: f64,
    /// The same, mean over the steps.
    best_mean_m: f64,
    /// The best of the modes.
    best_of_m: f64,
    /// Constant velocity from the true state.
    steady_m: f64,
    /// Constant velocity from the published state.
    tracked_m: f64,
}

/// Plays the sources with every noise. Of each source at most `scenes` recordings are played, spread evenly over
/// their names. Calls `progress` with each run before it starts.
///
/// # Errors
/// [`EvaluateError`] names the folder, recording or weights at fault.
pub fn under_noise(
    options: &Options,
    scenes: usize,
    progress: impl Fn(&str) + Sync,
) -> Result<Page, EvaluateError> {
    let study = Study {
        jobs: jobs_of,
        title: "Recorded vehicles",
        note: |scenes, horizon_s| {
            format!(
                "FDE in m after {horizon_s:.1} s of moving vehicles ({MOVING_MPS} m/s or more), a forecast every 0.4 s. At most \
                 {scenes} recordings of each source, spread evenly. *All fields* keeps the recorded headings and speeds, with \
                 noise of 2 degrees and of σ / 1 s if the positions have noise. *Clean* is the run without any change (first row \
                 of each source), on the forecasts that both runs have. *True CV* is constant velocity from the true state."
            )
        },
        head: ["source", "detections", "fields", "noise"],
        names: |job| job.names(),
        figures: &RECORDED,
    };
    Ok(Page::of("recorded", "evaluate noise", &[study.table(options, scenes, progress)?]))
}

/// As [`under_noise`], of detections with identities: the network's own forecasts beside the published ones.
///
/// # Errors
/// As [`under_noise`].
pub fn network_under_noise(
    options: &Options,
    scenes: usize,
    progress: impl Fn(&str) + Sync,
) -> Result<Page, EvaluateError> {
    let study = Study {
        jobs: network_jobs_of,
        title: "The network under noise",
        note: |scenes, horizon_s| {
            format!(
                "ADE and FDE in m over {horizon_s:.1} s of moving vehicles ({MOVING_MPS} m/s or more) with ids, a forecast every 0.4 s. \
                 At most {scenes} recordings of each source, spread evenly. *Network*: the network's forecasts without evidence. \
                 *Published*: with evidence. *All fields* as in the table of recorded vehicles. Ratios to 0 m compare the \
                 forecasts that both runs have. *Tracked CV* is constant velocity from the published state."
            )
        },
        head: ["source", "fields", "forecasts of", "noise"],
        names: |job| job.network_names(),
        figures: &NETWORK,
    };
    Ok(Page::of("network", "evaluate noise --parts network", &[study.table(options, scenes, progress)?]))
}

/// A column of numbers: its title, and the number of a run beside its reference.
type Figure = (&'static str, fn(&AllEnds, &AllEnds) -> Option<f64>);
const RECORDED: [Figure; 5] = [
    ("FDE", |run, _| mean(run, |of| of.best_m)),
    ("minFDE₂₀", |run, _| mean(run, |of| of.best_of_m)),
    ("FDE / clean", |run, clean| to_clean(run, clean, |of| of.best_m)),
    ("minFDE₂₀ / clean", |run, clean| to_clean(run, clean, |of| of.best_of_m)),
    ("FDE / true CV", |run, _| {
        let sum = |of: fn(&Ends) -> f64| run.values().map(of).sum::<f64>();
        ratio(sum(|of| of.best_m), sum(|of| of.steady_m))
    }),
];
const NETWORK: [Figure; 7] = [
    ("ADE", |run, _| mean(run, |of| of.best_mean_m)),
    ("FDE", |run, _| mean(run, |of| of.best_m)),
    ("minFDE₂₀", |run, _| mean(run, |of| of.best_of_m)),
    ("ADE / 0 m", |run, clean| to_clean(run, clean, |of| of.best_mean_m)),
    ("FDE / 0 m", |run, clean| to_clean(run, clean, |of| of.best_m)),
    ("minFDE₂₀ / 0 m", |run, clean| to_clean(run, clean, |of| of.best_of_m)),
    ("tracked CV, FDE / 0 m", |run, clean| to_clean(run, clean, |of| of.tracked_m)),
];

/// A table of runs, each beside the latest run before it that is a reference.
struct Study {
    jobs: fn(&Source) -> Vec<Job<'_>>,
    title: &'static str,
    /// The note for a number of recordings and a horizon in s.
    note: fn(usize, f64) -> String,
    /// Titles of the columns of names.
    head: [&'static str; 4],
    names: fn(&Job<'_>) -> Vec<String>,
    figures: &'static [Figure],
}

impl Study {
    fn table(
        &self,
        options: &Options,
        scenes: usize,
        progress: impl Fn(&str) + Sync,
    ) -> Result<Table, EvaluateError> {
        let (weights, sources) = (options.weights.load()?, spread_sources(options, scenes)?);
        let model = weights.config();
        let jobs: Vec<Job<'_>> = sources.iter().flat_map(|source| (self.jobs)(source)).collect();
        let played = threads::each(&jobs, options.threads, |job, _: &mut ()| {
            progress(&format!("{}, {}", job.source.name, job.names()[1..].join(", ")));
            job.play(options, model)
        });
        let played = played.into_iter().collect::<Result<Vec<_>, _>>()?;
        let note = (self.note)(scenes, model.horizon_len as f64 * model.dt_s);
        let columns = std::iter::once("forecasts").chain(self.figures.iter().map(|(title, _)| *title));
        let mut table = Table::new(self.title, &note, &self.head, columns);
        let mut reference = &BTreeMap::new();
        for (job, played) in jobs.iter().zip(&played) {
            if job.is_reference {
                reference = played;
            }
            let figures = self.figures.iter().map(|(_, figure)| figure(played, reference).map(Entry::digits));
            let count = Some(Entry::count(played.len()));
            table.push(&(self.names)(job), std::iter::once(count).chain(figures));
        }
        Ok(table)
    }
}

/// The sources, with at most `scenes` recordings each.
fn spread_sources(options: &Options, scenes: usize) -> Result<Vec<Source>, EvaluateError> {
    let mut sources = sources(&options.data.join("driving"), &options.sources)?;
    sources.iter_mut().for_each(|source| source.files = spread(&source.files, scenes));
    Ok(sources)
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
                jobs.push(Job { source, noise, fields, is_network: false, is_reference: noise.is_none() });
            }
        }
    }
    jobs
}

/// The runs of a source that compare the network with the published forecasts: in each series the noise grows.
fn network_jobs_of(source: &Source) -> Vec<Job<'_>> {
    let with_ids = |fields| {
        let jobs = jobs_of(source).into_iter();
        jobs.filter(move |job| !job.noise.without_ids && job.fields == fields)
    };
    let series = |(fields, is_network)| {
        with_ids(fields).map(move |job| Job { is_network, is_reference: job.noise.sigma_m == 0.0, ..job })
    };
    [(Fields::All, true), (Fields::All, false), (Fields::Positions, true), (Fields::Positions, false)]
        .into_iter()
        .flat_map(series)
        .collect()
}

fn mean(played: &AllEnds, of: fn(&Ends) -> f64) -> Option<f64> {
    (!played.is_empty()).then(|| played.values().map(of).sum::<f64>() / played.len() as f64)
}

fn ratio(a: f64, b: f64) -> Option<f64> {
    (b > 0.0).then(|| a / b)
}

/// The ratio of an error to the clean run's, on the forecasts that both runs have.
fn to_clean(played: &AllEnds, clean: &AllEnds, of: fn(&Ends) -> f64) -> Option<f64> {
    let both = played.iter().filter_map(|(key, ends)| Some((ends, clean.get(key)?)));
    let (ours, theirs) = both.fold((0.0, 0.0), |(ours, theirs), (a, b)| (ours + of(a), theirs + of(b)));
    ratio(ours, theirs)
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

    fn network_names(&self) -> Vec<String> {
        let [source, _, fields, noise]: [String; 4] = self.names().try_into().expect("four names");
        let of = if self.is_network { "network" } else { "published" };
        vec![source, fields, of.to_owned(), noise]
    }

    /// Plays the source as one run, as `evaluate driving` does.
    fn play(&self, options: &Options, model: &ModelConfig) -> Result<AllEnds, EvaluateError> {
        let evidence = options.evidence && !self.is_network;
        let options = &Options { evidence, noise: self.noise, ..options.clone() };
        let mut ends = BTreeMap::new();
        self.source.play(options, model, |place, _, playing| {
            let mut counted = None;
            while let Some(tick) = playing.next() {
                let stamp_ns = tick.header.stamp_ns;
                let number = stamp_ns.div_euclid(EVERY_NS);
                if counted.replace(number) == Some(number) {
                    continue;
                }
                for (forecast, track) in tick.followed() {
                    let is_vehicle = track.reported_at(stamp_ns).agent_type == AgentType::Vehicle;
                    let judged = judge(stamp_ns, forecast, tick.truth, track.id, model);
                    ends.extend(judged.filter(|_| is_vehicle).map(|of| ((place, track.id, stamp_ns), of)));
                }
            }
            Ok(())
        })?;
        Ok(ends)
    }
}

/// The errors of the forecast of a moving agent; `None` if it does not count or the recording lacks its future.
fn judge(stamp_ns: i64, forecast: &Forecast, truth: &Truth, agent: u64, model: &ModelConfig) -> Option<Ends> {
    let now = truth.state(agent, stamp_ns)?;
    if now.speed_mps() < MOVING_MPS || forecast.modes_len < 2 {
        return None;
    }
    let len = model.horizon_len;
    let truth = truth.ahead(agent, stamp_ns, model.step_ns() as f64, len)?;
    let steady_m = |position_m: [f32; 2], velocity_mps: [f32; 2]| {
        let mut steady = vec![[0.0; 2]; len];
        MotionNow::since(position_m, velocity_mps, None).steady(model.dt_s as f32, &mut steady);
        Errors::of(displacement(&steady, &truth)).fde_m
    };
    let best = Errors::of(displacement(&forecast.best, &truth));
    let modes = &forecast.modes[..forecast.modes_len as usize];
    Some(Ends {
        best_m: best.fde_m,
        best_mean_m: best.ade_m,
        best_of_m: Errors::of(min_displacement(modes, &truth)).fde_m,
        steady_m: steady_m(now.position_m, now.velocity_mps),
        tracked_m: steady_m([forecast.x_m, forecast.y_m], [forecast.vx_mps, forecast.vy_mps]),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ends(best_m: f64) -> Ends {
        Ends { best_m, best_mean_m: best_m / 4.0, best_of_m: best_m / 2.0, steady_m: 4.0, tracked_m: 5.0 }
    }

    #[test]
    fn ratios_to_the_clean_run_use_the_forecasts_of_both() {
        let clean = [((0, 1, 0), ends(1.0)), ((0, 2, 0), ends(2.0)), ((0, 3, 0), ends(50.0))].into();
        let noisy = [((0, 1, 0), ends(2.0)), ((0, 2, 0), ends(4.0)), ((1, 2, 0), ends(9.0))].into();
        assert_eq!(RECORDED.map(|(_, of)| of(&noisy, &clean)), [5.0, 2.5, 2.0, 2.0, 1.25].map(Some));
        assert_eq!(RECORDED.map(|(_, of)| of(&BTreeMap::new(), &clean)), [None; 5]);
        let of_network = [1.25, 5.0, 2.5, 2.0, 2.0, 2.0, 1.0].map(Some);
        assert_eq!(NETWORK.map(|(_, of)| of(&noisy, &clean)), of_network);
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
        assert!(jobs[0].is_reference && jobs[1..].iter().all(|job| !job.is_reference));
        let mut names: Vec<Vec<String>> = jobs.iter().map(Job::names).collect();
        names.sort();
        names.dedup();
        assert_eq!(names.len(), jobs.len());
    }

    #[test]
    fn each_series_of_the_network_begins_without_noise() {
        let source = Source { name: String::new(), folder: "a".into(), files: Vec::new(), scale: 1.0 };
        let jobs = network_jobs_of(&source);
        for series in jobs.chunks(SIGMAS_M.len()) {
            assert_eq!(series.iter().map(|job| job.noise.sigma_m).collect::<Vec<_>>(), SIGMAS_M);
            assert!(series[0].is_reference && series[1..].iter().all(|job| !job.is_reference));
            let first = series[0].network_names();
            assert!(series.iter().all(|job| job.network_names()[..3] == first[..3]));
        }
    }
}
