//! Tables of matured forecasts.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

use evaluator::{RESAMPLES, Table, digits, threads};
use evidence::Priors;
use metrics::{Interval, PairedErrors, paired_bootstrap_ratio};
use nn::ModelConfig;
use nn::Precision;
use scene::AgentType;
use serde_json::json;

use crate::patterns::{Residuals, patterns};
use crate::play::Played;
use crate::sample::{LEVEL, METHODS, Method, STEPS, Sample};
use crate::source::Source;
use crate::{Errors, Options, region_of_steady};

/// Bounds of the speed bands, m/s.
const BANDS_MPS: [f32; 4] = [3.0, 8.0, 15.0, 25.0];
const BAND_NAMES: [&str; 5] = ["0-3", "3-8", "8-15", "15-25", "> 25"];
/// A cell with fewer forecasts is left out.
const CELL_MIN: usize = 200;
/// Time of a source from which on its regions must hold.
const SETTLED_S: f64 = 60.0;
/// The first seconds of a recording that are told apart.
const FIRST_S: [f64; 4] = [5.0, 10.0, 30.0, f64::INFINITY];
const SEED: u64 = 1;

/// What was published, beside its yardsticks, by source, type and speed.
#[derive(Debug)]
pub struct Report {
    sources: Vec<(Source, Played)>,
    made: String,
}

impl std::fmt::Debug for Played {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "{} forecasts in {:.0} s", self.samples.len(), self.seconds)
    }
}

impl Report {
    pub(crate) fn new(
        sources: Vec<Source>,
        played: Vec<Played>,
        options: &Options,
        model: &ModelConfig,
    ) -> Self {
        let weights = options.weights.as_ref().map_or("the embedded weights".to_owned(), |path| {
            path.file_name().unwrap_or_default().to_string_lossy().into_owned()
        });
        let map = if options.map { "online map" } else { "no map" };
        let evidence = if options.evidence { "with evidence" } else { "without evidence" };
        let precision = match options.precision {
            Precision::F32 => String::new(),
            other => format!(", decoder in {other}"),
        };
        let horizon_s = model.horizon_len as f64 * model.dt_s;
        let made = format!(
            "Played through the online pipeline: {weights}, {map}, {evidence}{precision}; horizon {horizon_s:.1} s, a forecast of each agent \
             every 0.4 s."
        );
        Self { sources: sources.into_iter().zip(played).collect(), made }
    }

    /// All samples of a source and type, none of fewer than [`CELL_MIN`].
    fn cells(&self) -> impl Iterator<Item = (&Source, AgentType, Vec<&Sample>)> {
        let types = wire::AGENT_TYPES;
        self.sources.iter().flat_map(move |(source, played)| {
            types.into_iter().filter_map(move |agent_type| {
                let samples = played.samples.iter().filter(|sample| sample.agent_type == agent_type);
                let samples: Vec<&Sample> = samples.collect();
                (samples.len() >= CELL_MIN).then_some((source, agent_type, samples))
            })
        })
    }

    /// The main tables as Markdown.
    #[must_use]
    pub fn summary(&self) -> String {
        [self.by_source(), self.coverage(), self.out_of_distribution(), self.first_seconds()].join("\n\n")
    }

    /// All tables as Markdown.
    #[must_use]
    pub fn markdown(&self) -> String {
        [self.summary(), self.by_speed()].join("\n\n")
    }

    fn by_source(&self) -> String {
        let columns = [
            "forecasts",
            "single best",
            "constant velocity",
            "/ CV, ADE",
            "/ CV, FDE",
            "turn",
            "acceleration",
            "best of 20",
            "20 anchors",
            "missed",
            "area m²",
            "CV area m²",
            "NLL",
            "regret",
            "network",
            "learned",
        ];
        let mut table = Table::new("", "", &["source", "type"], columns.map(str::to_owned).into_iter());
        let mut ratios: BTreeMap<AgentType, Vec<[f64; 2]>> = BTreeMap::new();
        for (source, agent_type, samples) in self.cells() {
            let cell = Cell { samples: &samples };
            let ratio = cell.ratios();
            if let [Some(ade), Some(fde)] = &ratio {
                ratios.entry(agent_type).or_default().push([ade.mean, fde.mean]);
            }
            let mut row = vec![source.name.clone(), agent_type.name().to_owned(), samples.len().to_string()];
            row.push(cell.text(Method::Best));
            row.push(cell.text(Method::ConstantVelocity));
            row.extend(ratio.iter().map(|ratio| ratio.as_ref().map_or("-".to_owned(), interval)));
            row.extend(
                [Method::DecayingTurn, Method::DecayingAcceleration, Method::BestOf, Method::Anchors]
                    .map(|method| cell.text(method)),
            );
            row.push(format!("{:.2}", cell.share(|sample| sample.missed)));
            row.extend(cell.areas_m2().map(|area_m2| format!("{area_m2:.0}")));
            row.push(format!("{:.2}", cell.mean(|sample| sample.nll)));
            row.push(format!("{:.2}", cell.regret()));
            row.push(format!("{:.2}", cell.mean(|sample| f64::from(sample.network))));
            row.push(format!("{:.2}", cell.share(|sample| sample.learned)));
            table.push_row(row);
        }
        let means = ratios.iter().map(|(agent_type, ratios)| {
            let [ade, fde] =
                [0, 1].map(|i| ratios.iter().map(|ratio| ratio[i]).sum::<f64>() / ratios.len() as f64);
            format!("{} {ade:.3} / {fde:.3}", agent_type.name())
        });
        let means: Vec<String> = means.collect();
        format!(
            "## By source\n\nADE / FDE in m. {} Ratios to constant velocity with 95 % intervals ({RESAMPLES} resamples of agents); \
             20 anchors on constant velocity are fitted to the other sources; regret is the single best forecast's error over that \
             of the best of constant velocity, turn and acceleration in hindsight; area is that of the highest-density region of 90 % at the end, \
             CV area that of a Gaussian about constant velocity, fitted in hindsight to the same forecasts of each speed, \
             that holds as many of their truths.\n\n{}\n\
             Mean over the sources of the ratio of ADE / FDE: {}.",
            self.made,
            table.grid(),
            means.join(", ")
        )
    }

    fn by_speed(&self) -> String {
        let columns = [
            "forecasts",
            "single best",
            "constant velocity",
            "/ CV, ADE",
            "/ CV, FDE",
            "best of 20",
            "20 anchors",
            "held 90 %",
            "area m²",
            "CV area m²",
        ];
        let mut table =
            Table::new("", "", &["source", "type", "m/s"], columns.map(str::to_owned).into_iter());
        for (source, agent_type, samples) in self.cells() {
            for (band, name) in BAND_NAMES.iter().enumerate() {
                let of_band: Vec<&Sample> = samples.iter().copied().filter(|s| band_of(s) == band).collect();
                if of_band.len() < CELL_MIN {
                    continue;
                }
                let cell = Cell { samples: &of_band };
                let mut row = vec![
                    source.name.clone(),
                    agent_type.name().to_owned(),
                    (*name).to_owned(),
                    of_band.len().to_string(),
                ];
                row.extend([Method::Best, Method::ConstantVelocity].map(|method| cell.text(method)));
                row.extend(cell.ratios().iter().map(|ratio| ratio.as_ref().map_or("-".to_owned(), interval)));
                row.extend([Method::BestOf, Method::Anchors].map(|method| cell.text(method)));
                row.push(format!("{:.2}", cell.held(LEVEL, STEPS.len() - 1)));
                row.extend(cell.areas_m2().map(|area_m2| format!("{area_m2:.0}")));
                table.push_row(row);
            }
        }
        format!("## By speed\n\n{}", table.grid())
    }

    fn coverage(&self) -> String {
        let mut columns = Vec::new();
        for level in ["50", "90"] {
            columns.extend(STEPS.map(|step| format!("{level} %, {:.1} s", (step + 1) as f64 * 0.4)));
        }
        let mut table =
            Table::new("", "", &["source", "type", "source time", "forecasts"], columns.into_iter());
        for (source, agent_type, samples) in self.cells() {
            for (name, settled) in [("first minute", false), ("after it", true)] {
                let part: Vec<&Sample> =
                    samples.iter().copied().filter(|s| (s.source_s >= SETTLED_S) == settled).collect();
                if part.len() < CELL_MIN {
                    continue;
                }
                let cell = Cell { samples: &part };
                let mut row = vec![
                    source.name.clone(),
                    agent_type.name().to_owned(),
                    name.to_owned(),
                    part.len().to_string(),
                ];
                for level in [0.5, 0.9] {
                    row.extend((0..STEPS.len()).map(|step| format!("{:.2}", cell.held(level, step))));
                }
                table.push_row(row);
            }
        }
        format!(
            "## Coverage\n\nShare of the forecasts whose highest-density region of 50 and of 90 % held the truth, by horizon.\n\n{}",
            table.grid()
        )
    }

    fn out_of_distribution(&self) -> String {
        let columns = ["sources", "lower half", "to nine tenths", "upper tenth", "upper / lower"];
        let mut table = Table::new("", "", &["type"], columns.map(str::to_owned).into_iter());
        for agent_type in wire::AGENT_TYPES {
            let of_type = self.cells().filter(|(_, of, _)| *of == agent_type);
            let (mut samples, mut sources_len) = (Vec::new(), 0);
            for (_, _, of_source) in of_type {
                samples.extend(of_source);
                sources_len += 1;
            }
            if samples.is_empty() {
                continue;
            }
            samples.sort_by(|a, b| a.out_of_distribution.total_cmp(&b.out_of_distribution));
            let ratio = |part: &[&Sample]| {
                let cell = Cell { samples: part };
                cell.errors(Method::Best).ade_m / cell.errors(Method::ConstantVelocity).ade_m
            };
            let (half, tenth) = (samples.len() / 2, samples.len() - samples.len() / 10);
            let parts = [&samples[..half], &samples[half..tenth], &samples[tenth..]];
            let [lower, _, upper] = parts.map(ratio);
            let mut row = vec![agent_type.name().to_owned(), sources_len.to_string()];
            row.extend(parts.map(|part| {
                let most = part.last().map_or(0.0, |sample| sample.out_of_distribution);
                format!("{:.2} (to {most:.2})", ratio(part))
            }));
            row.push(format!("{:.2}", upper / lower));
            table.push_row(row);
        }
        format!(
            "## Out of distribution\n\nThe single best forecast's ADE over constant velocity's, of the forecasts of all sources in \
             the order of their published measure, which reaches the number in brackets.\n\n{}",
            table.grid()
        )
    }

    fn first_seconds(&self) -> String {
        let columns = ["< 5 s", "5-10 s", "10-30 s", "later"].map(str::to_owned);
        let mut table = Table::new("", "", &["source", "type"], columns.into_iter());
        for (source, agent_type, samples) in self.cells() {
            let mut row = vec![source.name.clone(), agent_type.name().to_owned()];
            let mut from_s = 0.0;
            for to_s in FIRST_S {
                let part = samples.iter().copied().filter(|s| (from_s..to_s).contains(&s.recording_s));
                let part: Vec<&Sample> = part.collect();
                let cell = Cell { samples: &part };
                let [ours, theirs] =
                    [Method::Best, Method::ConstantVelocity].map(|method| cell.errors(method));
                row.push(if part.len() < CELL_MIN / 4 {
                    "-".to_owned()
                } else {
                    format!("{:.2} / {:.2}", ours.ade_m / theirs.ade_m, ours.fde_m / theirs.fde_m)
                });
                from_s = to_s;
            }
            table.push_row(row);
        }
        format!(
            "## First seconds of a recording\n\nThe single best forecast's ADE / FDE over constant velocity's.\n\n{}",
            table.grid()
        )
    }

    /// A line per source, type and method.
    #[must_use]
    pub fn csv(&self) -> String {
        let mut text = String::from("source,type,method,forecasts,ade_m,fde_m\n");
        for (source, agent_type, samples) in self.cells() {
            for method in METHODS {
                let Errors { ade_m, fde_m } = Cell { samples: &samples }.errors(method);
                let (name, of_type, len) = (&source.name, agent_type.name(), samples.len());
                let _ = writeln!(text, "{name},{of_type},{method:?},{len},{ade_m},{fde_m}");
            }
        }
        text
    }

    /// Errors by source, type and method.
    #[must_use]
    pub fn json(&self) -> serde_json::Value {
        let cells = self.cells().map(|(source, agent_type, samples)| {
            let cell = Cell { samples: &samples };
            let errors = METHODS.map(|method| {
                let Errors { ade_m, fde_m } = cell.errors(method);
                (format!("{method:?}"), json!({ "ade_m": ade_m, "fde_m": fde_m }))
            });
            let held = [0.5, 0.9]
                .map(|level| (0..STEPS.len()).map(|step| cell.held(level, step)).collect::<Vec<f64>>());
            let [area_m2, steady_area_m2] = cell.areas_m2();
            json!({
                "source": source.name,
                "type": agent_type.name(),
                "forecasts": samples.len(),
                "errors": errors.into_iter().collect::<serde_json::Map<_, _>>(),
                "held_50": held[0],
                "held_90": held[1],
                "area_90_m2": area_m2,
                "constant_velocity_area_90_m2": steady_area_m2,
            })
        });
        json!({ "made": self.made, "cells": cells.collect::<Vec<_>>() })
    }

    /// What the sampler learned of its experts, by source, and the patterns of all sources and of all but each.
    /// The work is shared by so many threads.
    #[must_use]
    pub fn priors(&self, threads: usize) -> Priors {
        let learned = self
            .sources
            .iter()
            .filter_map(|(source, played)| Some((source.name.clone(), played.learned.clone()?)));
        let folders: BTreeSet<String> = self.sources.iter().map(|(source, _)| source.folder_name()).collect();
        let left_out: Vec<Option<String>> = folders.into_iter().map(Some).chain([None]).collect();
        let residuals =
            threads::each(&self.sources, threads, |(_, played), _: &mut ()| Residuals::of(&played.samples));
        let patterns = threads::each(&left_out, threads, |left_out, _: &mut ()| {
            let all = self.sources.iter().zip(&residuals);
            let others = all.filter(|((source, _), _)| Some(source.folder_name()) != *left_out);
            patterns(&others.map(|(_, residuals)| residuals).collect::<Vec<_>>())
        });
        let mut priors = Priors { sources: learned.collect(), ..Priors::default() };
        for (left_out, patterns) in left_out.into_iter().zip(patterns) {
            match left_out {
                Some(name) => _ = priors.pattern_without.insert(name, patterns),
                None => priors.pattern = patterns,
            }
        }
        priors
    }
}

/// The number of a sample's speed band.
fn band_of(sample: &Sample) -> usize {
    BANDS_MPS.iter().filter(|&&bound| sample.speed_mps >= bound).count()
}

/// Some samples.
struct Cell<'a> {
    samples: &'a [&'a Sample],
}

impl Cell<'_> {
    fn mean(&self, of: impl Fn(&Sample) -> f64) -> f64 {
        let values = self.samples.iter().map(|sample| of(sample)).filter(|value| value.is_finite());
        let (sum, len) = values.fold((0.0, 0_u32), |(sum, len), value| (sum + value, len + 1));
        sum / f64::from(len)
    }

    fn share(&self, of: impl Fn(&Sample) -> bool) -> f64 {
        self.mean(|sample| f64::from(u8::from(of(sample))))
    }

    fn errors(&self, method: Method) -> Errors {
        let of = |sample: &Sample| sample.errors[method as usize];
        Errors { ade_m: self.mean(|sample| of(sample).ade_m), fde_m: self.mean(|sample| of(sample).fde_m) }
    }

    fn text(&self, method: Method) -> String {
        let Errors { ade_m, fde_m } = self.errors(method);
        if ade_m.is_nan() { "-".to_owned() } else { format!("{} / {}", digits(ade_m), digits(fde_m)) }
    }

    fn held(&self, level: f64, step: usize) -> f64 {
        self.share(|sample| sample.is_held(level, step))
    }

    /// The single best forecast's mean error over constant velocity's, of ADE and FDE.
    fn ratios(&self) -> [Option<Interval>; 2] {
        [|errors: &Errors| errors.ade_m, |errors: &Errors| errors.fde_m].map(|of| {
            let mut clusters: BTreeMap<u64, PairedErrors> = BTreeMap::new();
            for sample in self.samples {
                let [ours, theirs] = [Method::Best, Method::ConstantVelocity]
                    .map(|method| of(&sample.errors[method as usize]));
                clusters.entry(sample.agent).or_default().add(ours, theirs);
            }
            let clusters: Vec<PairedErrors> = clusters.into_values().collect();
            paired_bootstrap_ratio(&clusters, RESAMPLES, SEED)
        })
    }

    /// Mean areas of the published region of 90 % at the end and of that of constant velocity that holds as
    /// many, m².
    fn areas_m2(&self) -> [f64; 2] {
        let steady_m2 = region_of_steady::mean_area_m2(self.samples, LEVEL, band_of, BAND_NAMES.len());
        [self.mean(|sample| sample.area_m2), steady_m2]
    }

    /// The published forecast's ADE over that of the best kinematic expert.
    fn regret(&self) -> f64 {
        let experts = [Method::ConstantVelocity, Method::DecayingTurn, Method::DecayingAcceleration];
        let least = experts.map(|method| self.errors(method).ade_m).into_iter().fold(f64::INFINITY, f64::min);
        self.errors(Method::Best).ade_m / least
    }
}

fn interval(ratio: &Interval) -> String {
    format!("{:.2} ({:.2}–{:.2})", ratio.mean, ratio.low, ratio.high)
}
