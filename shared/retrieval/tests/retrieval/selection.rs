//! Mode selection: the neighbours' paths that replace modes.

use kinematics::MotionKind;
use retrieval::ModeSelection;
use wire::HORIZON_MAX;

/// A path of two steps to (x, y).
fn to(x: f32, y: f32) -> [[f32; 2]; HORIZON_MAX] {
    let mut path = [[0.0; 2]; HORIZON_MAX];
    (path[0], path[1]) = ([0.5 * x, 0.5 * y], [x, y]);
    path
}

/// The selection from paths; the first `probability.len()` of them are modes.
fn select(
    kind: MotionKind,
    paths: &[[[f32; 2]; HORIZON_MAX]],
    probability: &[f32],
    weights: &[f32],
) -> Vec<(usize, f32)> {
    let mut selection = ModeSelection::default();
    selection.select(kind, paths, 2, probability, weights.iter().copied());
    selection.selected().collect()
}

#[test]
fn a_common_path_replaces_the_mode_whose_loss_is_least() {
    // The second mode is almost equal to the first. Two neighbours went left, away from all modes. One went
    // to the third mode.
    let paths = [to(4.0, 0.0), to(4.1, 0.0), to(2.0, 0.0), to(0.0, 4.0), to(0.0, 4.2), to(2.0, 0.1)];
    let selected = select(MotionKind::Displacement, &paths, &[0.5, 0.2, 0.3], &[1.0, 0.9, 1.0]);
    assert_eq!(selected.iter().map(|(path, _)| *path).collect::<Vec<_>>(), [0, 3, 2]);
    let total = 8.0 + 2.9;
    for ((_, probability), of_its_own) in selected.iter().zip([8.0 * 0.7, 1.9, 8.0 * 0.3 + 1.0]) {
        assert!((probability - of_its_own / total).abs() < 1e-6, "{selected:?}");
    }
}

#[test]
fn modes_stay_where_neighbours_follow_them() {
    let modes = [to(4.0, 0.0), to(0.0, 4.0), to(-4.0, 0.0)];
    let same = [modes.as_slice(), &[to(4.0, 0.0)]].concat();
    assert_eq!(
        select(MotionKind::Displacement, &modes, &[0.2, 0.3, 0.5], &[]),
        [(0, 0.2), (1, 0.3), (2, 0.5)]
    );
    let stayed = select(MotionKind::Bicycle, &same, &[0.2, 0.3, 0.5], &[1.0]);
    assert_eq!(stayed.iter().map(|(path, _)| *path).collect::<Vec<_>>(), [0, 1, 2]);
    assert!(stayed[0].1 > 0.2, "{stayed:?}");
}

#[test]
fn only_a_few_modes_are_replaced() {
    let modes: Vec<_> = (0..8).map(|mode| to(1.0 + 0.01 * mode as f32, 0.0)).collect();
    let others: Vec<_> = (0..9).map(|other| to(0.0, 4.0 * other as f32)).collect();
    for (kind, most) in [(MotionKind::Bicycle, 5), (MotionKind::Displacement, 3)] {
        let selected = select(kind, &[&modes[..], &others].concat(), &[1.0 / 8.0; 8], &[1.0; 9]);
        assert_eq!(selected.iter().filter(|(path, _)| *path >= 8).count(), most, "{selected:?}");
        let sum: f32 = selected.iter().map(|(_, probability)| probability).sum();
        assert!((sum - 1.0).abs() < 1e-5, "{selected:?}");
    }
}
