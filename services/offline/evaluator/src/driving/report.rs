//! Tables of matured forecasts.

use std::collections::BTreeSet;

use evidence::Priors;
use metrics::{Errors, Interval};
use nn::{ModelConfig, Precision};
use scene::AgentType;

use super::region_of_steady::mean_area_m2;
use super::{
    BAND_NAMES, Cell, FORETELLERS, Foretold, LEVEL, Method, Pair, Played, RECALL, Residuals, STEPS, Sample,
    Source, band_of, patterns,
};
use crate::footage::{MapChoice, Options};
use crate::page::{Page, sections};
use crate::table::{Entry, RESAMPLES, Table};
use crate::threads;

/// Cells with fewer forecasts are left out.
const CELL_MIN: usize = 200;
/// Speed from which a vehicle counts as moving.
const MOVES_MPS: f32 = 1.0;
/// A turning vehicle ends farther beside the line of constant velocity.
const TURNING_M: f32 = 2.0;
/// A part of the moving vehicles: its name, and whether a forecast belongs to it.
type Subset = (&'static str, fn(&Sample) -> bool);
const SUBSETS: [Subset; 5] = [
    ("all", |_| true),
    ("straight", |sample| sample.beyond_steady_m[1].abs() <= TURNING_M),
    ("turning", |sample| sample.beyond_steady_m[1].abs() > TURNING_M),
    ("with a leader", |sample| sample.has_leader),
    ("without a leader", |sample| !sample.has_leader),
];
const ADE: fn(&Errors) -> f64 = |errors| errors.ade_m;
const FDE: fn(&Errors) -> f64 = |errors| errors.fde_m;
/// The figures of a cell by the names of their columns.
type Figure = (&'static str, fn(&Cell<'_>) -> Option<Entry>);
const FIGURES: [Figure; 19] = [
    ("forecasts", |cell| Some(Entry::count(cell.samples.len()))),
    ("single best", |cell| cell.pair(Method::Best)),
    ("constant velocity", |cell| cell.pair(Method::ConstantVelocity)),
    ("/ CV, ADE", |cell| interval(cell.ratio(Method::Best, Method::ConstantVelocity, ADE))),
    ("/ CV, FDE", |cell| interval(cell.ratio(Method::Best, Method::ConstantVelocity, FDE))),
    ("turn", |cell| cell.pair(Method::DecayingTurn)),
    ("acceleration", |cell| cell.pair(Method::DecayingAcceleration)),
    ("best of 20", |cell| cell.pair(Method::BestOf)),
    ("20 anchors", |cell| cell.pair(Method::Anchors)),
    ("/ anchors, ADE", |cell| interval(cell.ratio(Method::BestOf, Method::Anchors, ADE))),
    ("/ anchors, FDE", |cell| interval(cell.ratio(Method::BestOf, Method::Anchors, FDE))),
    ("missed", |cell| number(cell.share(|sample| sample.missed), 2)),
    ("held 90 %", |cell| interval(cell.held_with_interval(LEVEL, STEPS.len() - 1))),
    ("area m²", |cell| number(cell.mean(|sample| sample.area_m2), 0)),
    ("CV area m²", |cell| number(mean_area_m2(cell.samples, LEVEL, band_of, BAND_NAMES.len()), 0)),
    ("NLL", |cell| number(cell.mean(|sample| sample.nll), 2)),
    ("regret", |cell| number(cell.regret(), 2)),
    ("network", |cell| number(cell.mean(|sample| f64::from(sample.network)), 2)),
    ("learned", |cell| number(cell.share(|sample| sample.learned), 2)),
];
/// The columns of the tables by source, by speed, and of moving vehicles.
const BY_SOURCE: &str = "forecasts|single best|constant velocity|/ CV, ADE|/ CV, FDE|turn|acceleration|best of 20|\
     20 anchors|/ anchors, ADE|/ anchors, FDE|missed|area m²|CV area m²|NLL|regret|network|learned";
const BY_SPEED: &str = "forecasts|single best|constant velocity|/ CV, ADE|/ CV, FDE|turn|best of 20|20 anchors|\
     / anchors, ADE|/ anchors, FDE|missed|held 90 %|area m²|CV area m²";
const MOVING: &str = "forecasts|single best|constant velocity|/ CV, ADE|/ CV, FDE|best of 20";

/// The subsets of the moving vehicles that contain a forecast.
pub(crate) fn subsets_of(sample: &Sample) -> impl Iterator<Item = &'static str> {
    let moves = sample.agent_type == AgentType::Vehicle && sample.speed_mps >= MOVES_MPS;
    SUBSETS.iter().filter(move |(_, is_in)| moves && is_in(sample)).map(|(name, _)| *name)
}

/// Time of a source after which its regions count as settled.
const SETTLED_S: f64 = 60.0;
/// Upper bounds of the parts of a recording in the table of first seconds.
const FIRST_S: [f64; 4] = [5.0, 10.0, 30.0, f64::INFINITY];
/// Target coverage of the 90 % regions once settled, and before.
const HELD_SETTLED: [f64; 2] = [0.88, 0.92];
const HELD_AT_FIRST: [f64; 2] = [0.8, 0.97];

/// The published forecasts and their baselines, by source, type and speed.
pub struct Report {
    pub(crate) sources: Vec<(Source, Played)>,
    made: String,
    mark: String,
}

impl Report {
    pub(crate) fn new(
        sources: Vec<Source>,
        played: Vec<Played>,
        options: &Options,
        model: &ModelConfig,
    ) -> Self {
        let weights = options.weights.file.as_ref().map_or("the embedded weights".to_owned(), |path| {
            path.file_name().unwrap_or_default().to_string_lossy().into_owned()
        });
        let map = if options.map == MapChoice::None { "no map" } else { "online map" };
        let evidence = if options.evidence { "with evidence" } else { "without evidence" };
        let lanes = if options.lanes { ", lanes of the recordings' maps" } else { "" };
        let precision = match options.weights.precision {
            Precision::F32 => String::new(),
            other => format!(", decoder in {other}"),
        };
        let (noise, horizon_s) = (options.noise.label(), model.horizon_len as f64 * model.dt_s);
        let made = format!(
            "Played through the online pipeline: {weights}, {map}{lanes}, {evidence}{precision}{noise}; horizon {horizon_s:.1} s, a forecast of each agent \
             every 0.4 s."
        );
        let lanes = if options.lanes { " --lanes" } else { "" };
        let mark = format!("evaluate driving{lanes}{}", options.noise.arguments());
        Self { sources: sources.into_iter().zip(played).collect(), made, mark }
    }

    /// All samples of a source and type; cells with fewer than [`CELL_MIN`] are left out.
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

    /// The report in all its forms.
    #[must_use]
    pub fn page(&self) -> Page {
        let mut tables = vec![
            self.by_source(),
            self.moving(),
            self.conflicts(),
            self.coverage(),
            self.out_of_distribution(),
            self.first_seconds(),
        ];
        let summary = sections(&tables, "##", "");
        tables.push(self.by_speed());
        Page { summary, ..Page::of("driving", &self.mark, &tables) }
    }

    fn by_source(&self) -> Table {
        let rows = self
            .cells()
            .map(|(source, agent_type, samples)| (vec![&*source.name, agent_type.name()], samples));
        let means = wire::AGENT_TYPES.into_iter().filter_map(|agent_type| {
            let of_type = self.cells().filter(|(_, of, _)| *of == agent_type);
            let [ade, fde] = mean_ratios(of_type.map(|(.., samples)| samples));
            (!ade.is_nan()).then(|| format!("{} {ade:.3} / {fde:.3}", agent_type.name()))
        });
        let means: Vec<String> = means.collect();
        let note = format!(
            "ADE / FDE in m. {} Ratios to constant velocity with 95 % intervals ({RESAMPLES} resamples of agents); \
             20 anchors on constant velocity are fitted to the other sources; regret is the single best forecast's error over that \
             of the best of constant velocity, turn and acceleration in hindsight; area is that of the highest-density region of 90 % at the end, \
             CV area that of a Gaussian about constant velocity, fitted in hindsight to the same forecasts of each speed, \
             that holds as many of their truths.",
            self.made
        );
        let closing = format!("Mean over the sources of the ratio of ADE / FDE: {}.", means.join(", "));
        Table { closing, ..table("By source", &note, &["source", "type"], BY_SOURCE, rows) }
    }

    fn by_speed(&self) -> Table {
        let bands = self.cells().flat_map(|(source, agent_type, samples)| {
            BAND_NAMES.iter().enumerate().map(move |(band, name)| {
                let of_band = samples.iter().copied().filter(|sample| band_of(sample) == band).collect();
                (vec![&*source.name, agent_type.name(), name], of_band)
            })
        });
        let rows = bands.filter(|(_, of_band): &(_, Vec<&Sample>)| of_band.len() >= CELL_MIN);
        table("By speed", "", &["source", "type", "m/s"], BY_SPEED, rows)
    }

    /// Moving vehicles, with subsets that need a road or a leader.
    fn moving(&self) -> Table {
        let moving = || {
            self.cells().filter_map(|(source, agent_type, mut samples)| {
                samples.retain(|sample| sample.speed_mps >= MOVES_MPS);
                (agent_type == AgentType::Vehicle && samples.len() >= CELL_MIN).then_some((source, samples))
            })
        };
        let subsets = moving().flat_map(|(source, samples)| {
            SUBSETS.iter().map(move |(name, is_in)| {
                let subset = samples.iter().copied().filter(|sample| is_in(sample)).collect();
                (vec![&*source.name, *name], subset)
            })
        });
        let rows = subsets.filter(|(_, subset): &(_, Vec<&Sample>)| subset.len() >= CELL_MIN / 4);
        let [ade, fde] = mean_ratios(moving().map(|(_, samples)| samples));
        let note = format!(
            "Vehicles that drive at {MOVES_MPS} m/s or more. *Turning* vehicles end more than \
             {TURNING_M} m beside the line of constant velocity. A vehicle has a *leader* if another agent is on its way \
             within 2 s and 20 m."
        );
        let closing = format!("Mean over the sources of the ratio of ADE / FDE: {ade:.3} / {fde:.3}.");
        Table { closing, ..table("Moving vehicles", &note, &["source", "subset"], MOVING, rows) }
    }

    /// How well forecasts foretell conflicts, by source and over all.
    fn conflicts(&self) -> Table {
        let note = format!(
            "Pairs of agents within 60 m, every 0.8 s. A pair has a conflict if its outlines come closer \
             than 0.5 m at a common step of the horizon. *Independent modes* add the probabilities of the pairs of modes \
             that do. The *published probability* contains how often such pairs had a conflict on the other sources. AP is the average precision of the pairs in the order of their scores. The other columns hold at a recall of \
             {RECALL}, with the mean time from an alarm to its conflict."
        );
        let measures = ["AP", "precision", "false alarms", "per agent and hour", "s ahead"];
        let columns = ["pairs", "conflicts"].into_iter().chain(measures);
        let mut table = Table::new("Conflicts", &note, &["source", "forecast"], columns);
        let all: Vec<Pair> = self.sources.iter().flat_map(|(_, played)| &played.pairs).copied().collect();
        let all_s = self.sources.iter().map(|(_, played)| played.agent_s).sum();
        let of_sources =
            self.sources.iter().map(|(source, played)| (&*source.name, &played.pairs[..], played.agent_s));
        for (name, pairs, agent_s) in of_sources.chain([("all", &all[..], all_s)]) {
            let conflict_count = pairs.iter().filter(|pair| pair.conflict_s.is_some()).count();
            for (number, foreteller) in FORETELLERS.iter().enumerate() {
                let Some(foretold) = Foretold::of(pairs, number) else { continue };
                let figures = [
                    Entry::count(pairs.len()),
                    Entry::count(conflict_count),
                    Entry::number(foretold.average_precision, 3),
                    Entry::number(foretold.precision, 3),
                    Entry::count(foretold.false_alarms),
                    Entry::number(foretold.false_alarms as f64 / agent_s * 3600.0, 2),
                    Entry::number(foretold.ahead_s, 1),
                ];
                table.push(&[name, foreteller], figures);
            }
        }
        table
    }

    fn coverage(&self) -> Table {
        let mut columns = Vec::new();
        for level in ["50", "90"] {
            columns.extend(STEPS.map(|step| format!("{level} %, {:.1} s", (step + 1) as f64 * 0.4)));
        }
        let note = format!(
            "Share of the forecasts whose highest-density region of 50 and of 90 % held the truth, by horizon; that \
             of 90 % with 95 % intervals ({RESAMPLES} resamples of agents)."
        );
        let mut table =
            Table::new("Coverage", &note, &["source", "type", "source time", "forecasts"], columns);
        let mut of_parts: [Vec<Interval>; 2] = [Vec::new(), Vec::new()];
        for (source, agent_type, samples) in self.cells() {
            for (name, settled) in [("first minute", false), ("after it", true)] {
                let part: Vec<&Sample> =
                    samples.iter().copied().filter(|s| (s.source_s >= SETTLED_S) == settled).collect();
                if part.len() < CELL_MIN {
                    continue;
                }
                let cell = Cell { samples: &part };
                let half = (0..STEPS.len()).map(|step| number(cell.held(0.5, step), 2));
                let held = (0..STEPS.len()).map(|step| cell.held_with_interval(LEVEL, step));
                let held: Vec<Option<Interval>> = held.collect();
                let figures = half.chain(held.iter().copied().map(interval));
                table.push(&[&source.name, agent_type.name(), name, &part.len().to_string()], figures);
                of_parts[usize::from(settled)].extend(held.into_iter().flatten());
            }
        }
        table.closing = format!(
            "Cells of 90 %: in the first minute {}; after it {}.",
            within(&of_parts[0], HELD_AT_FIRST),
            within(&of_parts[1], HELD_SETTLED)
        );
        table
    }

    fn out_of_distribution(&self) -> Table {
        let note = "The single best forecast's ADE over constant velocity's, of the forecasts of all sources in \
                    the order of their published measure, which reaches the number in brackets.";
        let columns = ["sources", "lower half", "to nine tenths", "upper tenth", "upper / lower"];
        let mut table = Table::new("Out of distribution", note, &["type"], columns);
        for agent_type in wire::AGENT_TYPES {
            let of_type = self.cells().filter(|(_, of, _)| *of == agent_type);
            let (mut samples, mut source_count) = (Vec::new(), 0);
            for (_, _, of_source) in of_type {
                samples.extend(of_source);
                source_count += 1;
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
            let of_part = |part: &[&Sample]| {
                let most = part.last().map_or(0.0, |sample| sample.out_of_distribution);
                let text = format!("{:.2} (to {most:.2})", ratio(part));
                Entry::new(text, [("ratio", ratio(part)), ("to", most.into())])
            };
            let [half, tenths, tenth] = parts.map(of_part);
            let figures = [Entry::count(source_count), half, tenths, tenth, Entry::number(upper / lower, 2)];
            table.push(&[agent_type.name()], figures);
        }
        table
    }

    fn first_seconds(&self) -> Table {
        let note = "The single best forecast's ADE / FDE over constant velocity's.";
        let columns = ["< 5 s", "5-10 s", "10-30 s", "later"];
        let mut table = Table::new("First seconds of a recording", note, &["source", "type"], columns);
        for (source, agent_type, samples) in self.cells() {
            let mut from_s = 0.0;
            let figures = FIRST_S.map(|to_s| {
                let part = samples.iter().copied().filter(|s| (from_s..to_s).contains(&s.recording_s));
                let part: Vec<&Sample> = part.collect();
                let cell = Cell { samples: &part };
                let [ours, theirs] =
                    [Method::Best, Method::ConstantVelocity].map(|method| cell.errors(method));
                from_s = to_s;
                let [ade, fde] = [ours.ade_m / theirs.ade_m, ours.fde_m / theirs.fde_m];
                let entry = Entry::new(format!("{ade:.2} / {fde:.2}"), [("ADE", ade), ("FDE", fde)]);
                (part.len() >= CELL_MIN / 4).then_some(entry)
            });
            table.push(&[&source.name, agent_type.name()], figures);
        }
        table
    }

    /// The evidence of each source, and the patterns of all sources and of all but each one. `threads` share
    /// the work.
    #[must_use]
    pub fn priors(&self, threads: usize) -> Priors {
        let learned = self
            .sources
            .iter()
            .filter_map(|(source, played)| Some((source.name.clone(), played.learned.clone()?)));
        let folders: BTreeSet<String> = self.sources.iter().map(|(source, _)| source.folder_name()).collect();
        let left_out: Vec<Option<String>> = folders.into_iter().map(Some).chain([None]).collect();
        let residuals = threads::each(&self.sources, threads, |(_, played), _: &mut ()| {
            Residuals::of_samples(&played.samples)
        });
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

/// A table with a row per cell. A row has its names, and a cell per column of [`FIGURES`].
fn table<'a>(
    title: &str,
    note: &str,
    names: &[&str],
    columns: &str,
    rows: impl Iterator<Item = (Vec<&'a str>, Vec<&'a Sample>)>,
) -> Table {
    let named = |name: &str| FIGURES.into_iter().find(|(of, _)| *of == name);
    let figures: Vec<Figure> = columns.split('|').filter_map(named).collect();
    let mut table = Table::new(title, note, names, columns.split('|'));
    for (names, samples) in rows {
        table.push(&names, figures.iter().map(|(_, figure)| figure(&Cell { samples: &samples })));
    }
    table
}

/// Mean of the cells' ratios of ADE and of FDE to constant velocity; NaN without a cell.
fn mean_ratios<'a>(cells: impl Iterator<Item = Vec<&'a Sample>>) -> [f64; 2] {
    let ratios = cells.filter_map(|samples| {
        let cell = Cell { samples: &samples };
        let to_steady = |of| Some(cell.ratio(Method::Best, Method::ConstantVelocity, of)?.mean);
        Some([to_steady(ADE)?, to_steady(FDE)?])
    });
    let ratios: Vec<[f64; 2]> = ratios.collect();
    [0, 1].map(|of| ratios.iter().map(|ratio| ratio[of]).sum::<f64>() / ratios.len() as f64)
}

fn interval(figure: Option<Interval>) -> Option<Entry> {
    figure.map(|figure| Entry::interval(figure, 2))
}

fn number(value: f64, decimals: usize) -> Option<Entry> {
    Some(Entry::number(value, decimals))
}

/// Reports the number of shares within the bounds, and the number of other shares whose interval reaches the
/// bounds.
fn within(shares: &[Interval], [low, high]: [f64; 2]) -> String {
    let percent = |share: f64| (100.0 * share).round();
    let lies =
        |share: &&Interval| percent(share.mean) >= percent(low) && percent(share.mean) <= percent(high);
    let may = |share: &&Interval| share.low <= high && share.high >= low;
    let (lie, out): (Vec<&Interval>, Vec<&Interval>) = shares.iter().partition(lies);
    let reach = out.iter().filter(|share| may(share)).count();
    format!(
        "{} of {} lie within {:.0} to {:.0} %, and the intervals of {reach} more reach there",
        lie.len(),
        shares.len(),
        percent(low),
        percent(high)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_within_bounds_are_told_from_those_that_may_be() {
        let share = |mean: f64, low: f64, high: f64| Interval { mean, low, high };
        let shares = [
            share(0.876, 0.875, 0.877),
            share(0.94, 0.919, 0.95),
            share(0.85, 0.80, 0.879),
            share(0.85, 0.80, 0.90),
        ];
        assert_eq!(
            within(&shares, HELD_SETTLED),
            "1 of 4 lie within 88 to 92 %, and the intervals of 2 more reach there"
        );
        assert_eq!(
            within(&shares, HELD_AT_FIRST),
            "4 of 4 lie within 80 to 97 %, and the intervals of 0 more reach there"
        );
    }
}
