//! The expert `following` equals its reference in double precision (`reference/following.py`).

use evidence::{Leader, MotionNow};

const REFERENCE: &str = include_str!("reference/following.csv");
const STEPS: usize = 12;
const DT_S: f32 = 0.4;

#[test]
fn paths_behind_a_leader_equal_the_reference() {
    let mut leaders = 0;
    for (number, line) in REFERENCE.lines().enumerate().skip(1) {
        let row: Vec<f32> = line.split(',').map(|value| value.parse().expect("a number")).collect();
        let [x, y, vx, vy, turn_rate_radps, acceleration_mps2, gap_m, speed_mps, leader_mps2] =
            row[..9].try_into().expect("nine columns");
        let now =
            MotionNow { turn_rate_radps, acceleration_mps2, ..MotionNow::since([x, y], [vx, vy], None) };
        let leader = (gap_m > 0.0).then_some(Leader { gap_m, speed_mps, acceleration_mps2: leader_mps2 });
        leaders += usize::from(leader.is_some());
        let mut path = [[0.0; 2]; STEPS];
        now.following(DT_S, leader.as_ref(), &mut path);
        for (step, (found, expected)) in path.iter().zip(row[9..].chunks(2)).enumerate() {
            let apart_m = (found[0] - expected[0]).hypot(found[1] - expected[1]);
            assert!(apart_m < 2e-3, "line {number}, step {step}: {found:?} instead of {expected:?}");
        }
    }
    assert_eq!(leaders, 40);
}
