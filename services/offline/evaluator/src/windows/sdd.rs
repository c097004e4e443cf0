//! Stanford Drone, TrajNet split: 2,829 test tracks of 20 points, errors in pixels of the videos.

use data::sets::{DataSet, Part};

use super::{Column, Group, Report, Subset, fit, need_agents, reference};
use crate::error::EvaluateError;
use crate::footage::{Options, SEED};
use crate::scenes::Cut;
use crate::table::Table;

/// Steps of the protocol.
const CUT: Cut = Cut { history_len: 8, horizon_len: 12, dt_s: 0.4, from_positions: false };

/// Evaluates the weights `sdd` in pixels and in metres.
///
/// Each test track is one window. The network sees all agents that are present at its eighth point. The scale
/// of each video converts metres to pixels.
///
/// # Errors
/// If weights or recordings are missing or of another kind, or if a video has no scale.
pub fn sdd(options: &Options, mut progress: impl FnMut(&str)) -> Result<Report, EvaluateError> {
    let subsets = [Subset::All];
    let rules = options.rules(&[3, 6, 9, 12], &subsets, None);
    let model = options.weights.open("sdd", SEED)?;
    model.check_steps("SDD", &CUT)?;
    progress("training part");
    let baselines = fit(&options.read_part(DataSet::SddTrajnet, Part::Train, &CUT)?, &CUT);
    progress(&format!("{} part", options.part.name()));
    let footage = options.read_part(DataSet::SddTrajnet, options.part, &CUT)?;
    let (map, map_label) = options.map.without_sites();
    let (mut metres, mut pixels) = (Vec::new(), Vec::new());
    for footage in &footage {
        let blocks = rules.judge(&model, &baselines, footage, map, options.part.name());
        let name = &footage.recording.name;
        need_agents(&blocks, name, &CUT)?;
        let pixel_m =
            footage.recording.pixel_m.ok_or_else(|| EvaluateError::NoScale { name: name.clone() })?;
        let group = Group::new(name, Subset::All, 0, &blocks);
        pixels.push(group.scaled("px", 1.0 / pixel_m));
        metres.push(group);
    }
    let pool = |groups: &[Group]| Group::pooled(options.part.name(), &groups.iter().collect::<Vec<_>>());
    let [pixels, metres] = [pool(&pixels), pool(&metres)];

    let mut report = Report::new(&format!("Stanford Drone, TrajNet split, {} part", options.part.name()));
    let recordings: Vec<_> = footage.iter().map(|footage| &footage.recording).collect();
    report.provenance.push(model.provenance(options.part.name(), map_label, &recordings));
    let columns = [Column::of("px", &pixels), Column::of("m", &metres)];
    let (last, horizons_s) = (rules.last(), rules.horizons_s(&CUT));
    let note = format!("ADE / FDE after 4.8 s, {} tracks.", metres.total.agents_len);
    let mut errors = Table::errors("Errors", &note, &columns, last);
    let paper = reference::rows(reference::SDD);
    errors.add_paper(&paper, columns.len(), |paper, method, column| {
        let row = paper.iter().find(|row| row.method == method && column == 0);
        row.map(|row| row.errors)
    });
    report.add_table(errors.main());
    report.add_table(Table::comparisons("", &columns));
    report.add_table(Table::rates("", &columns[1..], last));
    report.add_table(Table::horizons("Errors by horizon, px", &columns[..1], &horizons_s));
    [&pixels, &metres].into_iter().for_each(|group| report.add_figures(group, &horizons_s));
    Ok(report)
}
