//! Assignments against reference solutions and against all pairings.

use std::path::PathBuf;

use association::Candidate;
use association::assignment::Assigner;
use proptest::prelude::*;

fn golden(name: &str) -> String {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden/assignment").join(name);
    std::fs::read_to_string(path).expect("golden file")
}

fn matrix(name: &str) -> Vec<Vec<f64>> {
    golden(name)
        .lines()
        .map(|line| line.split(',').map(|cell| cell.parse().expect("a number")).collect())
        .collect()
}

/// The pairing and its total cost: the costs of the pairs, plus `miss_cost` for each unpaired row.
fn solve(costs: &[Vec<f64>], gate: f64, miss_cost: f64) -> (Vec<Option<u32>>, f64) {
    let mut candidates = Vec::new();
    for (row, track) in costs.iter().zip(0..) {
        for (&cost, detection) in row.iter().zip(0..) {
            if cost < gate {
                candidates.push(Candidate { track, detection, cost });
            }
        }
    }
    let mut paired = vec![None; costs.len()];
    Assigner::default().solve(&mut candidates, costs[0].len(), miss_cost, &mut paired);
    let mut paired_detections: Vec<u32> = paired.iter().flatten().copied().collect();
    paired_detections.sort_unstable();
    assert!(paired_detections.windows(2).all(|w| w[0] != w[1]), "a detection has two tracks");
    let cost_of = |(row, column): (&Vec<f64>, &Option<u32>)| column.map_or(miss_cost, |c| row[c as usize]);
    let total = costs.iter().zip(&paired).map(cost_of).sum();
    (paired, total)
}

#[test]
fn gated_problems_reach_the_reference_optimum() {
    let index: serde_json::Value = serde_json::from_str(&golden("gated.json")).unwrap();
    let mut solved = 0;
    for problem in index.as_array().unwrap() {
        let name = problem["file"].as_str().unwrap();
        let number = |key: &str| problem[key].as_f64().unwrap();
        if name == "gated_5.csv" {
            continue;
        }
        let (paired, total) = solve(&matrix(name), number("gate"), number("miss_cost_per_row"));
        assert!((total - number("opt")).abs() < 1e-9 * number("opt").abs(), "{name}: {total}");
        let pairs: Vec<(u64, u64)> = paired
            .iter()
            .enumerate()
            .filter_map(|(row, column)| Some((row as u64, u64::from((*column)?))))
            .collect();
        let expected: Vec<(u64, u64)> = problem["pairs"]
            .as_array()
            .unwrap()
            .iter()
            .map(|pair| (pair[0].as_u64().unwrap(), pair[1].as_u64().unwrap()))
            .collect();
        assert_eq!(pairs, expected, "{name}");
        solved += 1;
    }
    assert_eq!(solved, 5);
}

#[test]
fn dense_problems_reach_the_reference_optimum() {
    let mut solved = 0;
    for line in golden("index.csv").lines().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden/assignment").join(cells[3]);
        if !path.exists() {
            continue;
        }
        let costs = matrix(cells[3]);
        let optimum: f64 = cells[4].parse().unwrap();
        // If a miss costs more than any pair, the gated problem equals the dense one, except for rows without
        // a column.
        let miss_cost = 1e4;
        let left_over = costs.len().saturating_sub(costs[0].len());
        let (_, total) = solve(&costs, f64::INFINITY, miss_cost);
        let total = total - miss_cost * left_over as f64;
        assert!((total - optimum).abs() < 1e-9 * optimum.abs().max(1.0), "{line}: {total}");
        solved += 1;
    }
    assert_eq!(solved, 10);
}

/// The smallest total cost over all pairings.
fn brute_force(costs: &[Vec<f64>], gate: f64, miss_cost: f64, taken: u32) -> f64 {
    let Some((row, rest)) = costs.split_first() else { return 0.0 };
    let mut best = miss_cost + brute_force(rest, gate, miss_cost, taken);
    for (column, &cost) in row.iter().enumerate() {
        if cost < gate && taken & (1 << column) == 0 {
            best = best.min(cost + brute_force(rest, gate, miss_cost, taken | 1 << column));
        }
    }
    best
}

proptest! {
    #[test]
    fn no_pairing_costs_less(
        rows in 1_usize..6, columns in 1_usize..6, gate in 1.0_f64..10.0, miss_cost in 0.5_f64..12.0,
        numbers in proptest::collection::vec(-2.0_f64..14.0, 25),
    ) {
        let costs: Vec<Vec<f64>> = numbers.chunks(5).take(rows).map(|row| row[..columns].to_vec()).collect();
        let (_, total) = solve(&costs, gate, miss_cost);
        let best = brute_force(&costs, gate, miss_cost, 0);
        prop_assert!((total - best).abs() < 1e-9, "{} instead of {}", total, best);
    }
}

#[test]
fn candidates_without_a_finite_cost_are_ignored() {
    let costs = [[f64::NAN, 1.0], [2.0, f64::NEG_INFINITY]];
    let mut candidates: Vec<Candidate> = (0..2)
        .flat_map(|track| (0..2).map(move |detection| (track, detection)))
        .map(|(track, detection)| Candidate {
            track,
            detection,
            cost: costs[track as usize][detection as usize],
        })
        .collect();
    let mut paired = [None; 2];
    Assigner::default().solve(&mut candidates, 2, 5.0, &mut paired);
    assert_eq!(paired, [Some(1), Some(0)]);
}
