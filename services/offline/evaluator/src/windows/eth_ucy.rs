//! ETH/UCY: five folds, each tested on the scene that its training leaves out.

use data::sets::{DataSet, Fold, Part};
use data::{Format, OpenOptions};

use super::{Column, Group, PaperRow, Report, Rules, Sensor, Subset, fit, need_agents, reference};
use crate::error::EvaluateError;
use crate::footage::{Options, SEED};
use crate::scenes::Cut;
use crate::table::Table;
use metrics::Errors;

/// Steps of the protocol: 8 + 12 annotated frames.
const CUT: Cut = Cut { history_len: 8, horizon_len: 12, dt_s: 0.4, from_positions: false };
/// The ETH scene with the true 0.4 s between frames.
const TRUE_TIME: &str = "eth_ucy/obsmat/eth_0.4s.txt";

/// Evaluates the weights of the five folds under both window rules. The ETH weights are also evaluated on
/// their scene in true time.
///
/// A window is 20 consecutive annotated frames, with stride 1. Pedestrians that are present in all of them
/// count. The network sees all pedestrians that are present at the newest of the 8 history frames.
///
/// # Errors
/// If weights or recordings are missing or of another kind.
pub fn eth_ucy(options: &Options, mut progress: impl FnMut(&str)) -> Result<Report, EvaluateError> {
    let subsets = [Subset::Company, Subset::All];
    let rules = options.rules(&[3, 6, 9, 12], &subsets, None);
    let mut report = Report::new(&format!(
        "ETH/UCY, leave one out, {} part{}",
        options.part.name(),
        options.noise.label()
    ));
    let mut groups: [Vec<Group>; 2] = [Vec::new(), Vec::new()];
    let (map, map_label) = options.map.without_sites();
    let mut models = Vec::new();
    for fold in Fold::ALL {
        let model = options.weights.open(fold.name(), SEED)?;
        model.check_steps("ETH/UCY", &CUT)?;
        models.push((fold, model));
    }
    for (fold, model) in models {
        progress(fold.name());
        let set = DataSet::EthUcyFold(fold);
        let baselines = fit(&options.read_part(set, Part::Train, &CUT)?, &CUT);
        let mut tests = vec![(fold.name().to_owned(), options.read_part(set, options.part, &CUT)?)];
        if fold == Fold::Eth && options.part == Part::Test {
            let path = options.data.join(TRUE_TIME);
            let footage = options.read(&[path], &OpenOptions::of(Format::Obsmat), &CUT)?;
            tests.push(("eth, true time".to_owned(), footage));
        }
        for (name, footage) in tests {
            let sensor = Sensor { noise: options.noise, forecaster: &model.forecaster, map };
            let footage = sensor.observe_all(footage, options.threads, &name, &mut report)?;
            let blocks: Vec<_> = footage
                .iter()
                .flat_map(|footage| rules.judge(&model, &baselines, footage, map, &name))
                .collect();
            need_agents(&blocks, &name, &CUT)?;
            let recordings: Vec<_> = footage.iter().map(|footage| &footage.recording).collect();
            report.provenance.push(model.provenance(&name, map_label, &recordings));
            for (place, (subset, groups)) in subsets.into_iter().zip(&mut groups).enumerate() {
                groups.push(Group::new(&name, subset, place, &blocks));
            }
        }
    }
    for groups in &groups {
        tables(&mut report, groups, &rules, &rules.horizons_s(&CUT));
    }
    Ok(report)
}

fn tables(report: &mut Report, groups: &[Group], rules: &Rules<'_>, horizons_s: &[f64]) {
    let rule = match groups[0].subset {
        Subset::Company => "windows with 2 or more pedestrians",
        _ => "windows with 1 or more pedestrians",
    };
    let folds: Vec<&Group> = groups.iter().filter(|group| group.part != "eth, true time").collect();
    let pooled = Group::pooled("all folds, pooled", &folds);
    let average = Column { name: "average".to_owned(), groups: folds.clone() };
    let mut columns: Vec<Column<'_>> = folds.iter().copied().map(of_group).collect();
    columns.push(average.clone());
    columns.extend(groups.iter().filter(|group| group.part == "eth, true time").map(of_group));
    let each: Vec<Column<'_>> = folds.iter().copied().chain([&pooled]).map(of_group).collect();
    let last = rules.last();
    let of = format!(": {rule}");

    let note = "ADE / FDE, m, after 4.8 s. The average is that of the five folds.";
    let mut errors = Table::errors(&format!("Errors{of}"), note, &columns, last);
    let paper = reference::rows(reference::ETH_UCY);
    errors
        .add_paper(&paper, columns.len(), |paper, method, column| of_paper(paper, method, &columns[column]));
    report.add_table(if groups[0].subset == Subset::Company { errors.main() } else { errors });
    report.add_table(Table::comparisons(&of, &each));
    let pooled_too = [&columns[..], &[of_group(&pooled)]].concat();
    report.add_table(Table::rates(&of, &pooled_too, last));
    let title = format!("Errors by horizon, average of the folds, m{of}");
    report.add_table(Table::horizons(&title, &[average], horizons_s));
    groups.iter().for_each(|group| report.add_figures(group, horizons_s));
    report.add_figures(&pooled, horizons_s);
}

fn of_group(group: &Group) -> Column<'_> {
    Column::of(&group.part, group)
}

fn of_paper(paper: &[PaperRow], method: &str, column: &Column<'_>) -> Option<Errors> {
    let scene = if column.name == "average" { "AVG" } else { &column.name.to_uppercase() };
    let found = paper.iter().find(|row| row.method == method && row.scene == scene);
    found.map(|row| row.errors)
}
