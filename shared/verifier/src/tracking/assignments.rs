//! Pairings of rows with columns, at their optimal cost.

use association::Candidate;
use association::assignment::Assigner;
use serde::Deserialize;

use super::ledger::{EXACT, Ledger};
use super::part::{Part, document};
use super::table::{Matrix, Table};
use crate::VerifyError;

/// A problem of `gated.json`. Costs at or above the gate do not form a pair. A row without a pair has its own
/// cost.
#[derive(Deserialize)]
struct Gated {
    file: String,
    /// Rows and columns.
    n: usize,
    m: usize,
    gate: f64,
    miss_cost_per_row: f64,
    /// Cost of the optimum.
    opt: f64,
    /// An optimal pairing.
    pairs: Vec<[usize; 2]>,
}

pub(super) fn compare(part: &mut Part, ledger: &mut Ledger) -> Result<(), VerifyError> {
    compare_dense(part, ledger)?;
    compare_gated(part, ledger)
}

/// Problems whose number of pairs equals the smaller of the numbers of rows and columns.
fn compare_dense(part: &mut Part, ledger: &mut Ledger) -> Result<(), VerifyError> {
    let Some(path) = part.find("index.csv") else { return Ok(()) };
    let table = Table::read(&path)?;
    let (files, kinds) = (table.texts("file")?, table.texts("kind")?);
    let optima = table.number_rows(["optimal_cost"])?;
    let shapes = table.whole_numbers("rows")?.into_iter().zip(table.whole_numbers("cols")?);
    for (row, ((file, [optimum]), (rows, columns))) in files.into_iter().zip(optima).zip(shapes).enumerate() {
        if kinds[row] != "dense" {
            return Err(table.malformed(row, format!("nothing computes kind \"{}\"", kinds[row])));
        }
        let matrix = matrix(part, file)?;
        if [rows, columns] != [matrix.row_count as u64, matrix.column_count as u64] {
            let own = format!("{} × {}", matrix.row_count, matrix.column_count);
            return Err(table.malformed(row, format!("{file} is {own}, not {rows} × {columns}")));
        }
        // A miss costs more than any pair, so only rows without a free column choose it.
        let dearest = matrix.numbers().iter().fold(0.0_f64, |most, cost| most.max(cost.abs()));
        let pairs = solve(&matrix, f64::INFINITY, 2.0 * dearest + 1.0);
        let all_paired = pairs.len() == matrix.row_count.min(matrix.column_count);
        let cost = if all_paired { cost(&matrix, &pairs) } else { f64::INFINITY };
        ledger.compare(part.vector(file, "cost"), &[1], &[cost], &[optimum], &EXACT);
    }
    Ok(())
}

fn compare_gated(part: &mut Part, ledger: &mut Ledger) -> Result<(), VerifyError> {
    let Some(path) = part.find("gated.json") else { return Ok(()) };
    for problem in document::<Vec<Gated>>(&path)? {
        let wrong = |reason: String| VerifyError::malformed(&path, format!("{}: {reason}", problem.file));
        let matrix = matrix(part, &problem.file)?;
        let (row_count, column_count) = (matrix.row_count, matrix.column_count);
        if (row_count, column_count) != (problem.n, problem.m) {
            let Gated { n, m, .. } = problem;
            return Err(wrong(format!("the matrix is {row_count} × {column_count}, not {n} × {m}")));
        }
        if let Some(pair) = problem.pairs.iter().find(|pair| pair[0] >= row_count || pair[1] >= column_count)
        {
            return Err(wrong(format!("there is no pair {pair:?}")));
        }
        let with_misses = |pairs: &[[usize; 2]]| {
            cost(&matrix, pairs) + problem.miss_cost_per_row * (row_count as f64 - pairs.len() as f64)
        };
        let found = with_misses(&solve(&matrix, problem.gate, problem.miss_cost_per_row));
        ledger.compare(part.vector(&problem.file, "cost"), &[1], &[found], &[problem.opt], &EXACT);
        // Several pairings may be optimal. The folder's pairing must have the same cost as ours.
        let theirs = with_misses(&problem.pairs);
        ledger.compare(part.vector(&problem.file, "pairs"), &[1], &[found], &[theirs], &EXACT);
    }
    Ok(())
}

fn matrix(part: &mut Part, file: &str) -> Result<Matrix, VerifyError> {
    Matrix::read(&part.expect(file)?)
}

/// The cheapest pairing of rows and columns with costs below the gate.
fn solve(matrix: &Matrix, gate: f64, miss_cost: f64) -> Vec<[usize; 2]> {
    let places =
        (0..matrix.row_count).flat_map(|row| (0..matrix.column_count).map(move |column| (row, column)));
    let candidate = |(row, column)| Candidate {
        track: row as u32,
        detection: column as u32,
        cost: matrix.at(row, column),
    };
    let mut candidates: Vec<_> = places.map(candidate).filter(|candidate| candidate.cost < gate).collect();
    let mut paired = vec![None; matrix.row_count];
    Assigner::default().solve(&mut candidates, matrix.column_count, miss_cost, &mut paired);
    let pair = |(row, column): (usize, &Option<u32>)| Some([row, (*column)? as usize]);
    paired.iter().enumerate().filter_map(pair).collect()
}

/// The total cost of pairs; infinite if two pairs share a row or column.
fn cost(matrix: &Matrix, pairs: &[[usize; 2]]) -> f64 {
    let shared = |side: usize| {
        let mut taken: Vec<_> = pairs.iter().map(|pair| pair[side]).collect();
        taken.sort_unstable();
        taken.windows(2).any(|two| two[0] == two[1])
    };
    if shared(0) || shared(1) {
        return f64::INFINITY;
    }
    pairs.iter().map(|[row, column]| matrix.at(*row, *column)).sum()
}
