//! The tables of a state.

use super::{Basis, Bins, COMPARED_SUBSETS, Part, Parts, State, Total};
use crate::forecaster::Provenance;
use crate::table::Table;
use crate::windows::{
    Group, Subset, Tally, files::SUBSETS, group::BlockErrors, report::Report, tables::Column,
};

/// Name of all recordings together.
const ALL: &str = "all";

impl State {
    /// The tables and figures of the recordings.
    #[must_use]
    pub fn report(&self) -> Report {
        let horizons_s = &self.basis.horizons_s;
        let last = horizons_s.len().saturating_sub(1);
        let mut report = Report::new("Recordings");
        report.warnings.clone_from(&self.warnings);
        report.failed.clone_from(&self.failed);
        report.doubts.clone_from(&self.doubts);
        report.left_out =
            self.left_out.iter().map(|name| self.basis.no_agents(name.clone()).to_string()).collect();
        report.provenance = self.provenance();
        report.set_published(self.published());
        for (place, subset) in SUBSETS.into_iter().take(COMPARED_SUBSETS).enumerate() {
            let mut groups = self.groups(place);
            if groups.len() > 1 {
                groups.push(Group::pooled(ALL, &groups.iter().collect::<Vec<_>>()));
            }
            if groups.iter().all(|group| group.total.is_empty()) {
                report.left_out.push(format!("{} agents: there are none", subset.name()));
                continue;
            }
            let columns: Vec<Column<'_>> =
                groups.iter().map(|group| Column::of(&group.part, group)).collect();
            let of = format!(": {} agents", subset.name());
            let note = format!("ADE / FDE, m, after {:.1} s.", horizons_s[last]);
            report.add_table(Table::errors(&format!("Errors{of}"), &note, &columns, last).main());
            report.add_table(Table::comparisons(&of, &columns));
            report.add_table(Table::rates(&of, &columns, last));
            let all = &columns[columns.len() - 1..];
            report.add_table(Table::horizons(&format!("Errors by horizon, m{of}"), all, horizons_s));
            groups.iter().for_each(|group| report.add_figures(group, horizons_s));
        }
        report
    }

    /// The group of each recording in a subset, or the group of all recordings if single ones are not kept.
    fn groups(&self, place: usize) -> Vec<Group> {
        match &self.parts {
            Parts::Each(parts) => parts.iter().map(|part| part.group(place)).collect(),
            Parts::Total(total) => vec![total.group(place)],
        }
    }

    /// The published forecasts and constant velocity, by type and in total.
    fn published(&self) -> Table {
        let shown = SUBSETS.iter().enumerate().filter(|(_, subset)| **subset != Subset::Moving);
        let pooled =
            shown.map(|(place, _)| Group::pooled(ALL, &self.groups(place).iter().collect::<Vec<_>>()));
        let groups: Vec<Group> = pooled.filter(|group| !group.total.is_empty()).collect();
        let (horizon, horizon_s) = self.basis.horizons_s.iter().enumerate().next_back().unwrap_or((0, &0.0));
        let note = format!(
            "ADE / FDE of the single best forecast after {horizon_s:.1} s, m, with evidence and retrieval as a run has them \
             by default."
        );
        Table::published("Published forecasts", &note, &groups.iter().collect::<Vec<_>>(), horizon)
    }

    /// The weights behind each recording, or behind all together.
    fn provenance(&self) -> Vec<Provenance> {
        match &self.parts {
            Parts::Each(parts) => {
                let of = |part: &Part| self.basis.provenance(&part.name, 1, usize::from(part.is_seen));
                parts.iter().map(of).collect()
            }
            Parts::Total(total) => {
                vec![self.basis.provenance(ALL, total.recordings as usize, total.seen as usize)]
            }
        }
    }
}

impl Part {
    fn group(&self, place: usize) -> Group {
        let blocks = self.blocks.get(place).cloned().unwrap_or_default();
        group(&self.name, place, self.tallies[place].clone(), blocks)
    }
}

impl Total {
    fn group(&self, place: usize) -> Group {
        let blocks = self.bins.get(place).map(Bins::blocks).unwrap_or_default();
        group(ALL, place, self.tallies[place].clone(), blocks)
    }
}

fn group(part: &str, place: usize, total: Tally, blocks: Vec<BlockErrors>) -> Group {
    Group { part: part.to_owned(), subset: SUBSETS[place], unit: "m", total, blocks }
}

impl Basis {
    fn provenance(&self, part: &str, recordings: usize, seen_in_training: usize) -> Provenance {
        let part = part.to_owned();
        Provenance { part, recordings, seen_in_training, ..self.provenance.clone() }
    }
}
