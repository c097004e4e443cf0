//! Two agents that cross in clutter, tracked by assignment and by joint probabilistic data association.

use association::Candidate;
use association::assignment::Assigner;
use association::jpda::Associator;
use filters::{ConstantVelocity, Gaussian, Observation, Process};
use metrics::tracking::{Consistency, normalised_square};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Poisson, StandardNormal};

const SEEDS: u64 = 200;
const TICKS: u64 = 60;
const TICK_NS: u64 = 80_000_000;
const PROCESS: ConstantVelocity = ConstantVelocity { density: 0.2 };
const SIGMA_M: f64 = 0.3;
const DETECTED: f64 = 0.9;
/// Number of false detections per m².
const CLUTTER: f64 = 0.1;
/// Side of the square that contains the false detections.
const SIDE_M: f64 = 14.0;
const GATE: f64 = 16.0;

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// The observations of a frame: noisy positions of the agents, misses and clutter, sorted by x.
fn frame(truths: &[Gaussian<4>; 2], rng: &mut ChaCha8Rng) -> Vec<Observation> {
    let mut positions = Vec::new();
    for truth in truths {
        let observed = [0, 1].map(|axis| truth.mean[axis] + SIGMA_M * normal(rng));
        if rng.random_bool(DETECTED) {
            positions.push(observed);
        }
    }
    let false_count = Poisson::new(CLUTTER * SIDE_M * SIDE_M).expect("a finite mean").sample(rng);
    for _ in 0..false_count as usize {
        positions.push([0, 1].map(|_| rng.random_range(-0.5..0.5) * SIDE_M));
    }
    positions.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let observed = |position_m| Observation::of_position(position_m, SIGMA_M.powi(2));
    positions.into_iter().map(observed).collect()
}

fn candidates(tracks: &[Gaussian<4>; 2], observed: &[Observation]) -> Vec<Candidate> {
    let mut candidates = Vec::new();
    for (track, state) in (0..).zip(tracks) {
        for (detection, observed) in (0..).zip(observed) {
            let evidence = state.clone().update(observed, &PROCESS).expect("a finite state");
            if evidence.nis < GATE {
                candidates.push(Candidate { track, detection, cost: -2.0 * evidence.log_likelihood });
            }
        }
    }
    candidates
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum By {
    Assignment,
    JointProbability,
}

#[derive(Debug, Default)]
struct Outcome {
    /// Number of tracks that are nearer to the other agent after a crossing. `lost_count` counts tracks near
    /// neither.
    swapped_count: usize,
    lost_count: usize,
    squares: Consistency,
}

#[expect(clippy::unwrap_used, reason = "a failure here is the test's")]
fn cross(by: By, apart_m: f64) -> Outcome {
    let mut outcome = Outcome::default();
    let miss_cost = -2.0 * ((1.0 - DETECTED) * CLUTTER / DETECTED).ln();
    let (mut associator, mut assigner) = (Associator::default(), Assigner::default());
    for seed in 0..SEEDS {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let start = [
            Gaussian::new([-3.0, apart_m / 2.0, 1.3, -0.2], [0.1, 0.1, 0.05, 0.05]),
            Gaussian::new([3.0, -apart_m / 2.0, -1.3, 0.2], [0.1, 0.1, 0.05, 0.05]),
        ];
        let mut tracks = start;
        let drawn = |state: &Gaussian<4>, rng: &mut ChaCha8Rng| {
            Gaussian::new(state.sample(|| normal(rng)).into(), [0.0; 4])
        };
        let mut truths = [drawn(&start[0], &mut rng), drawn(&start[1], &mut rng)];
        for tick in 0..TICKS {
            for (truth, track) in truths.iter_mut().zip(&mut tracks) {
                *truth = drawn(&PROCESS.step(truth, 0.08), &mut rng);
                track.predict(TICK_NS, &PROCESS).unwrap();
            }
            let observed = frame(&truths, &mut rng);
            let mut candidates = candidates(&tracks, &observed);
            match by {
                By::Assignment => {
                    let mut paired = [None; 2];
                    assigner.solve(&mut candidates, observed.len(), miss_cost, &mut paired);
                    for (track, paired) in tracks.iter_mut().zip(paired) {
                        paired.map(|d| track.update(&observed[d as usize], &PROCESS).unwrap());
                    }
                }
                By::JointProbability => {
                    associator.associate(&mut candidates, 2, observed.len(), miss_cost);
                    for (t, track) in tracks.iter_mut().enumerate() {
                        let shares = associator.of_track(t).iter();
                        let shares: Vec<(f64, Observation)> = shares
                            .map(|share| (share.probability, observed[share.detection as usize]))
                            .collect();
                        track.update_jointly(&shares, &PROCESS).unwrap();
                    }
                }
            }
            for (truth, track) in truths.iter().zip(&tracks) {
                let nees = normalised_square(&(truth.mean - track.mean), &track.covariance).unwrap();
                outcome.squares.add(tick, nees, 4).unwrap();
            }
        }
        let off_m = |a: &Gaussian<4>, b: &Gaussian<4>| (a.mean - b.mean).fixed_rows::<2>(0).norm();
        for (t, track) in tracks.iter().enumerate() {
            let (own_m, other_m) = (off_m(track, &truths[t]), off_m(track, &truths[1 - t]));
            outcome.swapped_count += usize::from(other_m < own_m && other_m < 1.5);
            outcome.lost_count += usize::from(own_m.min(other_m) >= 1.5);
        }
    }
    outcome
}

/// Tracks that may share detections are correlated, which one Gaussian per track cannot represent. JPDA is
/// still nearly consistent. An assignment treats the nearest false detection as certain.
#[test]
fn jpda_loses_fewer_tracks_and_is_nearly_consistent() {
    for apart_m in [0.0, 1.0, 2.0] {
        let [assigned, joint] = [By::Assignment, By::JointProbability].map(|by| cross(by, apart_m));
        for (name, outcome) in [("assigned", &assigned), ("joint", &joint)] {
            let squares = outcome.squares.summary(0.95).expect("counted").expect("not empty");
            println!(
                "{apart_m} m apart, {name}: {} of {} swapped, {} lost, NEES/n {:.3}, {:.0} % inside",
                outcome.swapped_count,
                2 * SEEDS,
                outcome.lost_count,
                squares.per_degree,
                100.0 * squares.inside,
            );
        }
        let per_degree = |outcome: &Outcome| outcome.squares.summary(0.95).unwrap().unwrap().per_degree;
        assert!(joint.swapped_count <= assigned.swapped_count, "{apart_m}");
        assert!(joint.lost_count * 5 <= assigned.lost_count && assigned.lost_count > 0, "{apart_m}");
        assert!((0.9..1.1).contains(&per_degree(&joint)) && per_degree(&assigned) > 2.0, "{apart_m}");
    }
}
