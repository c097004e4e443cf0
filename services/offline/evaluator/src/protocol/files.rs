//! Any recordings, evaluated with one set of weights.

use std::path::PathBuf;

use data::OpenOptions;

use super::{GROWTH, MapChoice, Options, RATES, Rules, SEED, need_agents, no_agents};
use crate::group::Group;
use crate::maps::MapInput;
use crate::report::{Column, Report, Table};
use crate::weights::EMBEDDED;
use crate::{Baselines, Cut, EvaluateError, Subset};

/// Evaluates one set of weights on the recordings at `paths`, in steps of the model. Anchors and a site map
/// are not available, because there is no training part. The report lists recordings without an agent over a
/// whole window as left out.
///
/// # Errors
/// If weights or recordings can't be read, or no recording has an agent over a whole window.
pub fn files(
    options: &Options,
    paths: &[PathBuf],
    open: OpenOptions,
    from_positions: bool,
    mut progress: impl FnMut(&str),
) -> Result<Report, EvaluateError> {
    let model = options.weights.open(EMBEDDED, SEED)?;
    let cut = Cut { from_positions, ..Cut::of(model.forecaster.config()) };
    let horizons = quarters(cut.horizon_len);
    let types = wire::AGENT_TYPES.map(Subset::Of);
    // Only the first two subsets have tables.
    let subsets = [&[Subset::All, Subset::Moving], &types[..]].concat();
    let rules = Rules { horizons: &horizons, subsets: &subsets, of_type: None, threads: options.threads };
    let baselines = Baselines::fit(std::iter::empty(), &cut, SEED);
    let (map, map_label) = match options.map {
        MapChoice::None => (MapInput::None, "none"),
        MapChoice::Online | MapChoice::Site => (MapInput::Online, "online"),
    };
    let mut report = Report::new("Recordings");
    let mut groups: Vec<Vec<Group>> = subsets.iter().map(|_| Vec::new()).collect();
    let mut names_left_out: Vec<String> = Vec::new();
    for footage in options.read(paths, open, &cut)? {
        let name = &footage.recording.name;
        progress(name);
        let doubts = data::findings(&footage.recording).into_iter().filter(|found| found.doubtful);
        report.warnings.extend(doubts.map(|doubt| format!("{name}: {doubt}")));
        let blocks = rules.judge(&model, &baselines, &footage, map);
        if let Err(error) = need_agents(&blocks, name, &cut) {
            report.left_out.push(error.to_string());
            names_left_out.push(name.clone());
            continue;
        }
        report.provenance.push(model.provenance(name, map_label, &[&footage.recording]));
        for (place, (subset, groups)) in subsets.iter().zip(&mut groups).enumerate() {
            groups.push(Group::new(name, *subset, place, &blocks));
        }
    }
    if groups[0].is_empty() {
        return Err(no_agents(&names_left_out.join(", "), &cut));
    }
    let horizons_s = rules.horizons_s(&cut);
    report.set_published(published(&groups, (horizons_s[rules.last()], rules.last())));
    for (&subset, mut groups) in subsets.iter().zip(groups).take(2) {
        if groups.iter().all(|group| group.total.is_empty()) {
            report.left_out.push(format!("{} agents: there are none", subset.name()));
            continue;
        }
        if groups.len() > 1 {
            groups.push(Group::pooled("all", &groups.iter().collect::<Vec<_>>()));
        }
        let columns: Vec<Column<'_>> = groups.iter().map(|group| Column::of(&group.part, group)).collect();
        let title = |what: &str| format!("{what}: {} agents", subset.name());
        let note = format!("ADE / FDE, m, after {:.1} s.", horizons_s[rules.last()]);
        report.add_table(Table::errors(&title("Errors"), &note, &columns, rules.last()).main());
        report.add_table(Table::comparisons(&title("Comparison with baselines"), &columns, rules.last()));
        report.add_table(Table::rates(&title("Calibration and plausibility"), RATES, &columns, rules.last()));
        let all = &columns[columns.len() - 1..];
        report.add_table(Table::horizons(&title("Errors by horizon, m"), "", all, &horizons_s, &GROWTH));
        groups.iter().for_each(|group| report.add_figures(group, &horizons_s));
    }
    Ok(report)
}

/// The published forecasts and constant velocity, by type and in total.
fn published(groups: &[Vec<Group>], (horizon_s, horizon): (f64, usize)) -> Table {
    let pooled = |groups: &Vec<Group>| Group::pooled("all", &groups.iter().collect::<Vec<_>>());
    let pooled: Vec<Group> = groups.iter().map(pooled).collect();
    let rows: Vec<&Group> =
        pooled.iter().filter(|group| matches!(group.subset, Subset::Of(_) | Subset::All)).collect();
    let note = format!(
        "ADE / FDE of the single best forecast after {horizon_s:.1} s, m, with evidence and retrieval as a run has them \
         by default."
    );
    Table::published("Published forecasts", &note, &rows, horizon)
}

/// Splits the horizon into quarters, or into fifths, if these are whole steps.
fn quarters(horizon_len: usize) -> Vec<usize> {
    let parts = [4, 5].into_iter().find(|parts| horizon_len.is_multiple_of(*parts)).unwrap_or(1);
    (1..=parts).map(|part| horizon_len * part / parts).collect()
}
