//! Tracking measures on scenes with a known result, and their invariants.

use metrics::tracking::{
    ClearMot, ClearMotCounts, Frame, Hota, HotaCounts, HotaScore, Identity, IdentityCounts, Object,
    SetDistance, TrackingError, linear_similarity,
};
use proptest::collection::vec;
use proptest::prelude::*;

const GATE_M: f64 = 1.0;
const ZERO_M: f64 = 2.0;

fn at(id: u64, x_m: f64) -> Object {
    Object { id, position_m: [x_m, 0.0] }
}

fn frame(truths: &[Object], tracks: &[Object]) -> Frame {
    Frame::new(truths, tracks).unwrap()
}

fn measured(frames: &[Frame]) -> (ClearMotCounts, IdentityCounts, HotaCounts) {
    let mut clear_mot = ClearMot::new(GATE_M).unwrap();
    let mut identity = Identity::new(GATE_M).unwrap();
    let mut hota = Hota::default();
    for frame in frames {
        clear_mot.add(frame);
        identity.add(frame);
        hota.add(frame, |distance_m| linear_similarity(distance_m, ZERO_M));
    }
    (clear_mot.finish(), identity.finish(), hota.finish())
}

#[test]
fn frames_without_objects_have_no_ratios() {
    for frames in [vec![], vec![Frame::default(); 3]] {
        let (clear_mot, identity, hota) = measured(&frames);
        assert_eq!(clear_mot, ClearMotCounts { frames_len: frames.len() as u64, ..Default::default() });
        let ratios = [clear_mot.mota(), clear_mot.motp_m(), clear_mot.recall(), clear_mot.precision()];
        assert_eq!(ratios, [None; 4]);
        assert_eq!([identity.idf1(), identity.idp(), identity.idr()], [None; 3]);
        assert_eq!(hota.mean(), HotaScore { loc_a: 1.0, ..Default::default() });
    }
}

#[test]
fn tracks_without_truth_are_false_tracks() {
    let (clear_mot, identity, hota) =
        measured(&[frame(&[], &[at(1, 0.0), at(2, 5.0)]), frame(&[], &[at(1, 0.0)])]);
    assert_eq!((clear_mot.false_count, clear_mot.missed_count), (3, 0));
    assert_eq!((clear_mot.mota(), clear_mot.precision()), (None, Some(0.0)));
    assert_eq!((identity.false_count, identity.idf1()), (3, Some(0.0)));
    assert_eq!((hota.track_count, hota.mean().hota), (3, 0.0));
}

#[test]
fn truths_without_track_are_missed_and_mostly_lost() {
    let (clear_mot, identity, hota) =
        measured(&[frame(&[at(1, 0.0)], &[]), frame(&[at(1, 0.0)], &[at(7, 1.5)])]);
    assert_eq!((clear_mot.missed_count, clear_mot.false_count, clear_mot.mostly_lost_count), (2, 1, 1));
    assert_eq!((clear_mot.mota(), clear_mot.recall()), (Some(-0.5), Some(0.0)));
    assert_eq!((identity.missed_count, identity.idr()), (2, Some(0.0)));
    // The distance is beyond the gate, but the similarity is still above 0.
    assert_eq!(hota.scores()[4].det_re, 0.5);
    assert_eq!(hota.scores()[5].det_re, 0.0);
}

#[test]
fn perfect_tracks_score_1() {
    let truths = |t: u32| [at(1, f64::from(t)), at(2, 100.0 - f64::from(t))];
    let tracks = |t: u32| [at(9, 100.0 - f64::from(t)), at(8, f64::from(t))];
    let frames: Vec<Frame> = (0..100).map(|t| frame(&truths(t), &tracks(t))).collect();
    let (clear_mot, identity, hota) = measured(&frames);
    assert_eq!((clear_mot.mota(), clear_mot.motp_m(), clear_mot.f1()), (Some(1.0), Some(0.0), Some(1.0)));
    assert_eq!((clear_mot.mostly_tracked_count, clear_mot.switch_count), (2, 0));
    assert_eq!(identity.idf1(), Some(1.0));
    let best = hota.mean();
    assert!((best.hota - 1.0).abs() < 1e-12 && (best.loc_a - 1.0).abs() < 1e-12, "{best:?}");
}

#[test]
fn a_kept_pair_precedes_a_nearer_track() {
    let truth = [at(1, 0.0)];
    let frames = [
        frame(&truth, &[at(7, 0.5)]),
        // Track 8 is nearer, but 7 is still within the gate.
        frame(&truth, &[at(7, 0.9), at(8, 0.1)]),
        // Missed while 7 is beyond the gate and 8 is gone; then track 8 finds it.
        frame(&truth, &[at(7, 1.1)]),
        frame(&truth, &[at(8, 0.1)]),
    ];
    let (clear_mot, identity, _) = measured(&frames);
    assert_eq!((clear_mot.matched_count, clear_mot.missed_count, clear_mot.false_count), (3, 1, 2));
    assert_eq!((clear_mot.switch_count, clear_mot.ascent_count, clear_mot.fragmentation_count), (1, 1, 1));
    assert!((clear_mot.distance_sum_m - 1.5).abs() < 1e-12);
    assert_eq!((identity.true_count, identity.missed_count, identity.false_count), (2, 2, 3));
}

#[test]
fn the_number_of_pairs_precedes_their_distance() {
    let both = frame(&[at(1, 0.0), at(2, 0.9)], &[at(8, 0.8), at(9, 1.8)]);
    let (clear_mot, _, _) = measured(&[both]);
    assert_eq!((clear_mot.matched_count, clear_mot.missed_count), (2, 0));
}

#[test]
fn exchanged_tracks_count_as_transfers() {
    let truths = [at(1, 0.0), at(2, 5.0)];
    let frames = [
        frame(&truths, &[at(7, 0.0), at(8, 5.0)]),
        frame(&truths, &[at(7, 5.0), at(8, 0.0)]),
        frame(&[at(3, 5.0)], &[at(7, 5.0)]),
    ];
    let (clear_mot, _, hota) = measured(&frames);
    assert_eq!((clear_mot.switch_count, clear_mot.transfer_count, clear_mot.migration_count), (2, 3, 1));
    // Detection is perfect; truth and track of each of the five matches share one frame.
    let score = hota.scores()[0];
    assert_eq!(score.det_a, 1.0);
    assert!((score.ass_pr - (2.0 / 2.0 + 3.0 / 3.0) / 5.0).abs() < 1e-12, "{score:?}");
}

#[test]
fn parameters_out_of_range_are_refused() {
    for gate_m in [-1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(ClearMot::new(gate_m), Err(TrackingError::Value { name: "gate_m", .. })));
        assert!(matches!(Identity::new(gate_m), Err(TrackingError::Value { name: "gate_m", .. })));
    }
    for (name, cutoff_m, order) in [
        ("cutoff_m", 0.0, 1.0),
        ("cutoff_m", f64::NAN, 1.0),
        ("order", 1.0, 0.5),
        ("order", 1.0, f64::INFINITY),
        ("cutoff_m to the power of order", 1e200, 2.0),
    ] {
        let refused = SetDistance::new(cutoff_m, order);
        assert!(
            matches!(refused, Err(TrackingError::Value { name: found, .. }) if found == name),
            "{refused:?}"
        );
    }
}

#[test]
fn similarities_are_clamped_and_nan_counts_as_0() {
    let frame = frame(&[at(1, 0.0)], &[at(2, 0.0)]);
    let mut hota = Hota::default();
    hota.add(&frame, |_| f64::NAN);
    hota.add(&frame, |_| -1.0);
    hota.add(&frame, |_| 7.0);
    let counts = hota.finish();
    assert_eq!((counts.alphas[18].matched_count, counts.alphas[18].similarity_sum), (1, 1.0));
}

#[test]
fn gospa_splits_into_its_components() {
    let distance = SetDistance::new(2.0, 2.0).unwrap();
    let gospa = distance.gospa(&frame(&[at(0, 0.0), at(1, 10.0)], &[at(0, 1.0), at(1, 20.0), at(2, 30.0)]));
    assert_eq!((gospa.pair_count, gospa.localisation, gospa.missed, gospa.false_tracks), (1, 1.0, 2.0, 4.0));
    assert!((gospa.distance_m - 7.0_f64.sqrt()).abs() < 1e-12);
    assert_eq!(distance.ospa(&frame(&[], &[at(0, 0.0)])), 2.0);
}

#[test]
fn merged_counts_equal_those_of_one_recording() {
    let parts = [
        vec![frame(&[at(1, 0.0)], &[at(5, 0.2)]), frame(&[at(1, 0.0)], &[])],
        vec![frame(&[at(1, 0.0), at(2, 3.0)], &[at(5, 3.2)])],
    ];
    let ((mut clear_mot, mut identity, mut hota), other) = (measured(&parts[0]), measured(&parts[1]));
    clear_mot.merge(&other.0);
    identity.merge(&other.1);
    hota.merge(&other.2);
    // Both parts as one recording; the second part has its own ids.
    let second = frame(&[at(11, 0.0), at(12, 3.0)], &[at(15, 3.2)]);
    let whole = measured(&[parts[0][0].clone(), parts[0][1].clone(), second]);
    assert_eq!((clear_mot, identity, hota), whole);
}

/// Rows of one frame: a few objects near each other, in random order.
fn rows(ids: u64) -> impl Strategy<Value = Vec<Object>> {
    let ids: Vec<u64> = (0..ids).collect();
    let len = 0..=ids.len();
    (proptest::sample::subsequence(ids, len), vec([0.0..4.0, 0.0..4.0], 8)).prop_map(|(ids, positions)| {
        ids.into_iter().zip(positions).map(|(id, position_m)| Object { id, position_m }).collect()
    })
}

fn points() -> impl Strategy<Value = Vec<Object>> {
    rows(6)
}

fn close(a: &HotaScore, b: &HotaScore) -> bool {
    let parts = |s: &HotaScore| [s.hota, s.det_a, s.det_re, s.det_pr, s.ass_a, s.ass_re, s.ass_pr, s.loc_a];
    parts(a).iter().zip(parts(b)).all(|(a, b)| (a - b).abs() < 1e-12)
}

proptest! {
    #[test]
    fn ids_and_row_order_change_no_measure(
        recording in vec((rows(6), rows(8)), 1..12),
        names in Just((100..108).collect::<Vec<u64>>()).prop_shuffle(),
    ) {
        let frames: Vec<Frame> = recording.iter().map(|(truths, tracks)| frame(truths, tracks)).collect();
        // Tracks get different ids in a different order, truths get greater ids, and rows are reversed.
        let renamed: Vec<Frame> = recording
            .iter()
            .map(|(truths, tracks)| {
                let truths: Vec<Object> =
                    truths.iter().rev().map(|truth| Object { id: 3 * truth.id + 1, ..*truth }).collect();
                let tracks: Vec<Object> =
                    tracks.iter().rev().map(|track| Object { id: names[track.id as usize], ..*track }).collect();
                frame(&truths, &tracks)
            })
            .collect();
        let (before, after) = (measured(&frames), measured(&renamed));
        prop_assert_eq!(before.0, after.0);
        prop_assert_eq!(before.1, after.1);
        prop_assert!(close(&before.2.mean(), &after.2.mean()), "{:?} {:?}", before.2.mean(), after.2.mean());
    }

    #[test]
    fn measures_stay_in_their_ranges(recording in vec((rows(6), rows(8)), 1..12)) {
        let frames: Vec<Frame> = recording.iter().map(|(truths, tracks)| frame(truths, tracks)).collect();
        let (clear_mot, identity, hota) = measured(&frames);
        let truths_len: usize = recording.iter().map(|(truths, _)| truths.len()).sum();
        let track_count: usize = recording.iter().map(|(_, tracks)| tracks.len()).sum();
        prop_assert_eq!(clear_mot.truths_len(), truths_len as u64);
        prop_assert_eq!(clear_mot.track_count(), track_count as u64);
        prop_assert_eq!(identity.true_count + identity.missed_count, truths_len as u64);
        prop_assert_eq!(identity.true_count + identity.false_count, track_count as u64);
        prop_assert!(clear_mot.motp_m().is_none_or(|m| (0.0..=GATE_M).contains(&m)));
        for score in hota.scores() {
            prop_assert!((0.0..=1.0).contains(&score.hota) && score.ass_a <= score.ass_re.min(score.ass_pr) + 1e-12);
        }
    }

    #[test]
    fn set_distances_are_metrics(
        a in points(),
        b in points(),
        c in points(),
        cutoff_m in 0.1..4.0,
        order in 1.0..3.0,
    ) {
        let distance = SetDistance::new(cutoff_m, order).unwrap();
        let gospa = |a: &[Object], b: &[Object]| distance.gospa(&frame(a, b)).distance_m;
        let ospa = |a: &[Object], b: &[Object]| distance.ospa(&frame(a, b));
        prop_assert!((gospa(&a, &b) - gospa(&b, &a)).abs() < 1e-9);
        prop_assert!((ospa(&a, &b) - ospa(&b, &a)).abs() < 1e-9);
        prop_assert_eq!((gospa(&a, &a), ospa(&a, &a)), (0.0, 0.0));
        prop_assert!(gospa(&a, &c) <= gospa(&a, &b) + gospa(&b, &c) + 1e-9);
        prop_assert!(ospa(&a, &c) <= ospa(&a, &b) + ospa(&b, &c) + 1e-9);
        prop_assert!(ospa(&a, &b) <= cutoff_m + 1e-12);
    }
}
