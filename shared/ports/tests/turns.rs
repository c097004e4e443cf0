//! Properties of the turns in any scene: the agents that matter most come first, and no agent starves.

use ports::shedding::{CONFLICTS_MAX, Candidate, Ego, NEAREST_LEN, Turns, wait_ticks_max};
use proptest::prelude::*;
use wire::AGENTS_MAX;

const TICK_NS: u64 = 80_000_000;

fn candidates(len_max: usize) -> impl Strategy<Value = Vec<Candidate>> {
    let agent = (-80.0..80.0_f32, -80.0..80.0_f32, -12.0..12.0_f32, -12.0..12.0_f32, 0..20_u64);
    prop::collection::vec(agent, 1..=len_max).prop_map(|agents| {
        let candidate = |(place, (x, y, vx, vy, ticks)): (usize, _)| Candidate {
            place,
            position_m: [x, y],
            velocity_mps: [vx, vy],
            waiting_ns: ticks * TICK_NS,
        };
        agents.into_iter().enumerate().map(candidate).collect()
    })
}

fn distance_m(candidate: &Candidate, ego: &Ego) -> f32 {
    let [x, y] = [0, 1].map(|axis| candidate.position_m[axis] - ego.position_m[axis]);
    x.hypot(y)
}

proptest! {
    #[test]
    fn everybody_has_one_turn_whatever_the_order(mut candidates in candidates(AGENTS_MAX), seed in any::<u64>()) {
        let mut turns = Turns::default();
        let order = turns.order(&Ego::default(), &candidates).to_vec();
        let mut places = order.clone();
        places.sort_unstable();
        prop_assert!(places.into_iter().eq(0..candidates.len()));
        let len = candidates.len();
        candidates.rotate_left(seed as usize % len);
        candidates.swap(0, (seed >> 32) as usize % len);
        prop_assert_eq!(turns.order(&Ego::default(), &candidates), &order[..]);
    }

    /// A sixth of any prefix of the order are the longest waiting agents. Apart from these and the
    /// conflicting agents, the prefix holds the nearest agents.
    #[test]
    fn any_beginning_has_the_nearest_and_the_longest_waiting(candidates in candidates(AGENTS_MAX)) {
        let (ego, mut turns) = (Ego::default(), Turns::default());
        let order = turns.order(&ego, &candidates).to_vec();
        let mut nearest = candidates.clone();
        nearest.sort_by(|a, b| distance_m(a, &ego).total_cmp(&distance_m(b, &ego)));
        let mut waited: Vec<u64> = candidates.iter().map(|candidate| candidate.waiting_ns).collect();
        waited.sort_unstable_by(|a, b| b.cmp(a));
        for served_count in 0..=candidates.len() {
            let served = &order[..served_count];
            let by_rank = (served_count - served_count / 6).saturating_sub(CONFLICTS_MAX).min(NEAREST_LEN);
            for near in nearest.iter().take(by_rank) {
                prop_assert!(served.contains(&near.place), "{} of {served_count}", near.place);
            }
            let mut of_served: Vec<u64> = served.iter().map(|&place| candidates[place].waiting_ns).collect();
            of_served.sort_unstable_by(|a, b| b.cmp(a));
            for (own, longest) in of_served.iter().zip(&waited).take(served_count / 6) {
                prop_assert_eq!(own, longest);
            }
        }
    }

    /// Agents appear, leave and move at random, and so does the ego. If each tick serves `served_count`
    /// agents, no agent waits longer than the bound.
    #[test]
    fn nobody_starves(
        agents_len in 1..=AGENTS_MAX,
        served_count in 6..=AGENTS_MAX,
        moves in prop::collection::vec((any::<u64>(), -50.0..50.0_f32, -50.0..50.0_f32), 60),
    ) {
        let bound = wait_ticks_max(agents_len, served_count).unwrap();
        let mut turns = Turns::default();
        let mut candidates: Vec<Candidate> =
            (0..agents_len).map(|place| Candidate { place, ..Candidate::default() }).collect();
        for (random, x, y) in moves {
            for (i, candidate) in candidates.iter_mut().enumerate() {
                let turn = (random >> (i % 50)) as f32 % 7.0 + i as f32;
                candidate.position_m = [x + 40.0 * turn.cos(), y + 40.0 * turn.sin()];
                candidate.velocity_mps = [10.0 * turn.sin(), -9.0 * turn.cos()];
                candidate.waiting_ns += TICK_NS;
                prop_assert!(candidate.waiting_ns <= bound as u64 * TICK_NS, "agent {i}, bound {bound}");
            }
            // One agent leaves, and another takes its place.
            candidates[random as usize % agents_len].waiting_ns = 0;
            let ego = Ego { position_m: [y, x], velocity_mps: [x * 0.1, 0.0] };
            for &place in turns.order(&ego, &candidates).iter().take(served_count) {
                candidates[place].waiting_ns = 0;
            }
        }
    }
}

#[test]
fn who_will_cross_the_egos_path_comes_before_who_is_nearer() {
    let ego = Ego { position_m: [0.0, 0.0], velocity_mps: [10.0, 0.0] };
    let at = |place, position_m, velocity_mps| Candidate { place, position_m, velocity_mps, waiting_ns: 0 };
    let candidates = [
        at(0, [-8.0, 0.0], [-5.0, 0.0]),
        at(1, [30.0, 30.0], [0.0, -10.0]),
        at(2, [20.0, 20.0], [0.0, -10.0]),
        at(3, [20.0, 20.0], [0.0, 10.0]),
    ];
    assert_eq!(Turns::default().order(&ego, &candidates), [2, 1, 0, 3], "the earlier crossing first");
    let behind = Ego { velocity_mps: [-10.0, 0.0], ..ego };
    assert_eq!(Turns::default().order(&behind, &candidates)[0], 0, "now it closes in on the one behind");
}

#[test]
fn all_of_a_scene_that_fits_are_served_in_each_tick() {
    assert_eq!(wait_ticks_max(32, 32), Some(1));
    assert_eq!(wait_ticks_max(128, 62), Some(6), "0.48 s at 12.5 Hz");
    assert_eq!(wait_ticks_max(128, 48), Some(16));
    assert_eq!(wait_ticks_max(5, 2), None);
}
