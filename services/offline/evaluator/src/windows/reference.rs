//! The tables of the paper, printed with our results.

use metrics::Errors;

/// In m.
pub(crate) const ETH_UCY: &str = include_str!("reference/paper_eth_ucy.csv");
/// In pixels.
pub(crate) const SDD: &str = include_str!("reference/paper_sdd.csv");
/// In m.
pub(crate) const INTERACTION: &str = include_str!("reference/paper_interaction.csv");

/// A row of the paper's tables.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PaperRow {
    /// The scene (`ETH` … `AVG`, `RA`, `UI`); empty if the table has only one.
    pub(crate) scene: &'static str,
    /// The horizon, if the table has several.
    pub(crate) horizon_s: Option<f64>,
    /// The paper's name of the method.
    pub(crate) method: &'static str,
    /// Errors in the unit of the table: metres, or pixels for SDD.
    pub(crate) errors: Errors,
}

/// The methods of a table, in the table's order.
pub(crate) fn methods(rows: &[PaperRow]) -> Vec<&'static str> {
    let mut methods = Vec::new();
    for row in rows {
        if !methods.contains(&row.method) {
            methods.push(row.method);
        }
    }
    methods
}

/// Parses a table. Its header names the columns; ADE and FDE are last.
pub(crate) fn rows(table: &'static str) -> Vec<PaperRow> {
    let mut lines = table.lines();
    let head: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let row = |line: &'static str| {
        let cells: Vec<&'static str> = line.split(',').collect();
        let cell = |name: &str| Some(*cells.get(head.iter().position(|column| *column == name)?)?);
        let number = |place: usize| cells.get(place)?.parse::<f64>().ok();
        Some(PaperRow {
            scene: cell("scene").unwrap_or_default(),
            horizon_s: cell("horizon_s").and_then(|cell| cell.parse().ok()),
            method: cell("method")?,
            errors: Errors { ade_m: number(cells.len() - 2)?, fde_m: number(cells.len() - 1)? },
        })
    };
    lines.filter_map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_line_of_every_table_is_read() {
        for table in [ETH_UCY, SDD, INTERACTION] {
            assert_eq!(rows(table).len() + 1, table.lines().filter(|line| !line.is_empty()).count());
        }
        let ours =
            rows(ETH_UCY).into_iter().find(|row| (row.scene, row.method) == ("AVG", "STG-DAT")).unwrap();
        assert_eq!(ours.errors, Errors { ade_m: 0.30, fde_m: 0.59 });
        assert!(rows(INTERACTION).iter().all(|row| row.horizon_s.is_some_and(|s| (1.0..=5.0).contains(&s))));
        assert_eq!(methods(&rows(SDD)).len(), 7);
    }
}
