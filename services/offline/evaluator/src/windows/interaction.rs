//! INTERACTION: vehicles at roundabouts (RA) and intersections (UI), at training sites and at held-out sites.

use std::path::{Path, PathBuf};

use data::OpenOptions;
use data::sets::{DataSet, Part};
use retrieval::RetrievalMemory;
use scene::AgentType;

use super::{
    Baselines, Block, Column, Group, Judge, PaperRow, Report, Rules, Sensor, Subset, fit, need_agents,
    reference,
};
use crate::error::EvaluateError;
use crate::footage::{Footage, MapChoice, Options, SEED, map_of};
use crate::forecaster::{MapInput, Model, Provenance};
use crate::noise::Noise;
use crate::scenes::{Cut, MOVING_MPS};
use crate::table::Table;
use metrics::Errors;

/// Steps of the protocol: 2 Hz.
const CUT: Cut = Cut { history_len: 4, horizon_len: 10, dt_s: 0.5, from_positions: false };
const SET: DataSet = DataSet::Interaction;
const SUBSETS: [Subset; 2] = [Subset::All, Subset::Moving];

/// Which weights are evaluated on which recordings.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum InteractionPart {
    /// The weights of all sites, on recordings of these sites that training did not use.
    Seen,
    /// The weights whose training left out a site, on all recordings of this site.
    HeldOut(String),
}

/// The errors of recordings that are evaluated together, by subset.
struct Judged {
    part: String,
    site: String,
    groups: [Group; 2],
}

/// Evaluates forecasts of 1 to 5 s, with the recorded speed and with motion from positions alone.
///
/// Vehicles that are present in all 14 steps count. The network sees all agents at the newest of the 4
/// history steps. Moving agents have at least [`MOVING_MPS`] at the last observed step.
///
/// # Errors
/// If weights or recordings are missing or of another kind.
pub fn interaction(
    options: &Options,
    parts: &[InteractionPart],
    mut progress: impl FnMut(&str),
) -> Result<Report, EvaluateError> {
    let rules = options.rules(&[2, 4, 6, 8, 10], &SUBSETS, Some(AgentType::Vehicle));
    let mut models = Vec::new();
    for part in parts {
        let model = options.weights.open(&part.recipe(), SEED)?;
        model.check_steps("INTERACTION", &CUT)?;
        models.push((part, model));
    }
    let part = options.part.name();
    let noise = options.noise.label();
    let mut report = Report::new(&format!("INTERACTION, split by recording, {part} part{noise}"));
    for (motion, from_positions) in [("recorded speed", false), ("positions only", true)] {
        let cut = Cut { from_positions, ..CUT };
        progress(&format!("{motion}: training part"));
        let training = options.read_part(SET, Part::Train, &cut)?;
        let mut judged = Vec::new();
        let protocol = Protocol { options, rules, cut, motion, training: &training };
        for (part, model) in &models {
            match part {
                InteractionPart::Seen => {
                    progress(&format!("{motion}: seen sites"));
                    judged.extend(protocol.seen(model, &mut report)?);
                }
                InteractionPart::HeldOut(site) => {
                    progress(&format!("{motion}: {site} held out"));
                    judged.extend(protocol.held_out(model, site, &mut report)?);
                }
            }
        }
        for place in 0..SUBSETS.len() {
            tables(&mut report, &judged, place, motion, &rules, &rules.horizons_s(&cut));
        }
    }
    Ok(report)
}

/// State that all parts share.
struct Protocol<'a> {
    options: &'a Options,
    rules: Rules<'a>,
    cut: Cut,
    /// Where the motion of this table comes from.
    motion: &'static str,
    training: &'a [Footage],
}

impl Protocol<'_> {
    /// The recordings of all sites in the evaluated part, by site.
    fn seen(&self, model: &Model, report: &mut Report) -> Result<Vec<Judged>, EvaluateError> {
        let Self { options, rules, cut, motion, training } = self;
        let baselines = fit(training, cut);
        let footage = options.read_part(SET, options.part, cut)?;
        let mut sites: Vec<(String, Vec<Block>)> = Vec::new();
        // Recordings are sorted by site.
        let mut visited: Option<(String, RetrievalMemory)> = None;
        let mut seen = Vec::new();
        for footage in footage {
            let site = footage.site();
            let map = (options.map == MapChoice::Site).then(|| map_of(training, &site)).flatten();
            let map = options.map.input(map.as_ref());
            let part = format!("seen {}, {motion}", short(&site));
            let judge =
                Judge { lanes: options.lanes_of(&site)?, ..rules.judge_with(model, &baselines, &part) };
            if visited.as_ref().is_none_or(|(name, _)| *name != site) {
                let mut memory = model.forecaster.memory();
                for earlier in training.iter().filter(|footage| footage.site() == site) {
                    let Footage { recording, scenes } = earlier;
                    model.forecaster.visit(recording, scenes, map, options.threads, &mut memory);
                }
                visited = Some((site.clone(), memory));
            }
            let footage = self.observe(model, map, footage, &format!("seen {}", short(&site)), report)?;
            // Other recordings of the evaluated part must not enter the memory.
            let mut memory = visited.as_ref().map(|(_, memory)| memory.clone());
            let blocks = judge.recording(&footage.recording, &footage.scenes, map, memory.as_mut());
            match sites.iter_mut().find(|(name, _)| *name == site) {
                Some((_, all)) => all.extend(blocks),
                None => sites.push((site, blocks)),
            }
            seen.push(footage.recording);
        }
        let recordings: Vec<_> = seen.iter().collect();
        add_provenance(report, model.provenance("seen", options.map.label(), &recordings));
        let judge = |(site, blocks): (String, Vec<Block>)| {
            need_agents(&blocks, &site, cut)?;
            Ok(Judged::new(format!("seen {}", short(&site)), site, &blocks))
        };
        sites.into_iter().map(judge).collect()
    }

    /// A recording as the sensor sees it, from positions alone if the motion of this table comes from them.
    fn observe(
        &self,
        model: &Model,
        map: MapInput<'_>,
        footage: Footage,
        part: &str,
        report: &mut Report,
    ) -> Result<Footage, EvaluateError> {
        let noise = self.options.noise;
        let positions_only = noise.positions_only || (self.cut.from_positions && !noise.is_none());
        let noise = Noise { positions_only, ..noise };
        let sensor = Sensor { noise, forecaster: &model.forecaster, map };
        let seen = sensor.observe_all(vec![footage], 1, part, report)?;
        Ok(seen.into_iter().next().expect("one recording stays one"))
    }

    /// All recordings of a site together, and the recordings of the evaluated part separately.
    fn held_out(&self, model: &Model, site: &str, report: &mut Report) -> Result<Vec<Judged>, EvaluateError> {
        let Self { options, rules, cut, motion, training } = self;
        let others = training.iter().filter(|footage| short(&footage.site()) != site);
        let baselines = Baselines::fit(others.flat_map(|footage| &footage.scenes), cut, SEED);
        let (mut tests, mut all, mut recordings) = (Vec::new(), Vec::new(), Vec::new());
        let mut name = site.to_owned();
        let mut lanes = None;
        let mut drawn = None;
        let mut memory = model.forecaster.memory();
        for part in [Part::Train, Part::Validation, Part::Test] {
            let of_site = |path: &PathBuf| short(&folder(path)) == site;
            let name_of_part = format!("held-out {site}, {} part, {motion}", part.name());
            let mut judge = rules.judge_with(model, &baselines, &name_of_part);
            let paths: Vec<PathBuf> = SET.files(&options.data, part)?.into_iter().filter(of_site).collect();
            for footage in options.read(&paths, &OpenOptions::of(SET.format()), cut)? {
                if name != footage.site() {
                    name = footage.site();
                    lanes = options.lanes_of(&name)?;
                    let of_lanes = lanes.as_deref().map(mapper::of_lanes).transpose();
                    drawn = of_lanes.map_err(|source| EvaluateError::unusable(&name, source))?;
                }
                judge.lanes.clone_from(&lanes);
                // Training used no recording of this site, so the only possible site map is the map of its
                // lanes.
                let map = options.map.input(drawn.as_ref());
                let footage = self.observe(model, map, footage, &format!("held-out {site}"), report)?;
                let Footage { recording, scenes } = &footage;
                let blocks = judge.recording(recording, scenes, map, Some(&mut memory));
                memory.end_session();
                if part == options.part {
                    tests.extend(blocks.iter().cloned());
                }
                all.extend(blocks);
                recordings.push(footage.recording);
            }
        }
        let of_part = format!("{} part", options.part.name());
        need_agents(&tests, &format!("{site}, {of_part}"), cut)?;
        let map_label = match options.map {
            MapChoice::Online => "online",
            MapChoice::Site if options.lanes => "of the site's lanes",
            _ => "none",
        };
        let part = format!("held-out {site}");
        add_provenance(report, model.provenance(&part, map_label, &recordings.iter().collect::<Vec<_>>()));
        let by_itself = Judged::new(format!("{part}, {of_part}"), name.clone(), &tests);
        Ok(vec![by_itself, Judged::new(part, name, &all)])
    }
}

impl InteractionPart {
    /// The recipe of the part's weights.
    fn recipe(&self) -> String {
        match self {
            Self::Seen => "interaction".to_owned(),
            Self::HeldOut(site) => format!("interaction-without-{site}"),
        }
    }
}

impl Judged {
    fn new(part: String, site: String, blocks: &[Block]) -> Self {
        let group = |place: usize| Group::new(&part, SUBSETS[place], place, blocks);
        Self { groups: [group(0), group(1)], part, site }
    }

    fn is_seen(&self) -> bool {
        self.part.starts_with("seen")
    }

    fn is_roundabout(&self) -> bool {
        self.site.contains("Roundabout")
    }
}

fn tables(
    report: &mut Report,
    judged: &[Judged],
    place: usize,
    motion: &str,
    rules: &Rules<'_>,
    horizons_s: &[f64],
) {
    let pool = |name: &str, wanted: &dyn Fn(&Judged) -> bool| {
        let groups: Vec<&Group> =
            judged.iter().filter(|judged| wanted(judged)).map(|judged| &judged.groups[place]).collect();
        (!groups.is_empty()).then(|| Group::pooled(name, &groups))
    };
    let kinds: Vec<Group> = [
        pool("seen RA", &|judged| judged.is_seen() && judged.is_roundabout()),
        pool("seen UI", &|judged| judged.is_seen() && !judged.is_roundabout()),
        pool("seen, all", &Judged::is_seen),
    ]
    .into_iter()
    .flatten()
    .collect();
    let (sites, foreign): (Vec<&Judged>, Vec<&Judged>) = judged.iter().partition(|judged| judged.is_seen());
    let whole: Vec<&Group> = foreign
        .iter()
        .filter(|judged| !judged.part.ends_with(" part"))
        .map(|judged| &judged.groups[place])
        .collect();
    let mut columns: Vec<Column<'_>> = kinds.iter().map(|group| Column::of(&group.part, group)).collect();
    columns.extend(foreign.iter().map(|judged| Column::of(&judged.part, &judged.groups[place])));
    if whole.len() > 1 {
        columns.push(Column { name: "held-out, mean".to_owned(), groups: whole });
    }

    let last = rules.last();
    let of = format!(": {} vehicles, {motion}", SUBSETS[place].name());
    let title = |what: &str| format!("{what}{of}");
    let note = format!(
        "ADE / FDE, m, after 5 s. Moving: at least {MOVING_MPS} m/s at the last observed step. Held-out sites: all \
         their recordings, and those of one part alone."
    );
    let mut errors = Table::errors(&title("Errors"), &note, &columns, last).main();
    if SUBSETS[place] == Subset::All {
        let paper = reference::rows(reference::INTERACTION);
        errors.add_paper(&paper, columns.len(), |paper, method, column| {
            of_paper(paper, method, columns[column].name.trim_start_matches("seen "), horizons_s[last])
        });
    }
    report.add_table(errors);
    let single: Vec<Column<'_>> = columns.iter().filter(|column| column.groups.len() == 1).cloned().collect();
    report.add_table(Table::comparisons(&of, &single));
    let by_site: Vec<Column<'_>> =
        sites.iter().map(|judged| Column::of(&judged.part, &judged.groups[place])).collect();
    if !by_site.is_empty() {
        report.add_table(Table::errors(&title("Errors by site"), "ADE / FDE, m, after 5 s.", &by_site, last));
        report.add_table(growth(&title("Errors by horizon, m"), &columns[..2.min(kinds.len())], horizons_s));
    }
    report.add_table(Table::rates(&of, &columns, last));
    for group in kinds.iter().chain(judged.iter().map(|judged| &judged.groups[place])) {
        let mut group = group.clone();
        group.part += &format!(", {motion}");
        report.add_figures(&group, horizons_s);
    }
}

/// Errors by horizon. The rows of the paper are for all vehicles.
fn growth(title: &str, columns: &[Column<'_>], horizons_s: &[f64]) -> Table {
    let mut table = Table::horizons(title, columns, horizons_s);
    let paper = reference::rows(reference::INTERACTION);
    table.add_paper(&paper, columns.len() * horizons_s.len(), |paper, method, cell| {
        let (column, horizon_s) = (&columns[cell / horizons_s.len()], horizons_s[cell % horizons_s.len()]);
        of_paper(paper, method, column.name.trim_start_matches("seen "), horizon_s)
    });
    table
}

fn of_paper(paper: &[PaperRow], method: &str, scene: &str, horizon_s: f64) -> Option<Errors> {
    let wanted =
        |row: &&PaperRow| row.method == method && row.scene == scene && row.horizon_s == Some(horizon_s);
    paper.iter().find(wanted).map(|row| row.errors)
}

/// Adds a provenance unless the report already has it.
fn add_provenance(report: &mut Report, provenance: Provenance) {
    if !report.provenance.contains(&provenance) {
        report.provenance.push(provenance);
    }
}

/// The folder of a recording: `DR_USA_Roundabout_FT`.
fn folder(path: &Path) -> String {
    let folder = path.parent().and_then(Path::file_name);
    folder.map_or_else(String::new, |folder| folder.to_string_lossy().into_owned())
}

/// The short name of a site: `FT`.
fn short(site: &str) -> &str {
    site.rsplit('_').next().unwrap_or(site)
}
