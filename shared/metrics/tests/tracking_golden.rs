//! Compares the tracking measures with py-motmetrics, `TrackEval` and Stone Soup on recorded scenarios.

use std::collections::BTreeMap;
use std::path::Path;

use metrics::tracking::{
    ClearMot, ClearMotCounts, Frame, Hota, HotaScore, Identity, Object, SetDistance, linear_similarity,
};
use serde_json::Value;

type Part = fn(&HotaScore) -> f64;

/// Largest distance of a pair. `ZERO_M` is the distance at which the similarity is 0.
const GATE_M: f64 = 1.0;
const ZERO_M: f64 = 2.0;

fn golden(name: &str) -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/tracking").join(name))
        .unwrap()
}

fn expected() -> Value {
    serde_json::from_str(&golden("mot_expected.json")).unwrap()
}

/// Objects by frame, from a table of frame, id, x, y.
fn objects(name: &str) -> BTreeMap<u64, Vec<Object>> {
    let mut frames = BTreeMap::<u64, Vec<Object>>::new();
    for line in golden(name).lines().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        let position_m = [cells[2].parse().unwrap(), cells[3].parse().unwrap()];
        let object = Object { id: cells[1].parse().unwrap(), position_m };
        frames.entry(cells[0].parse().unwrap()).or_default().push(object);
    }
    frames
}

fn frames() -> Vec<Frame> {
    let (truths, mut tracks) = (objects("gt.csv"), objects("tracks.csv"));
    let frames: Vec<Frame> = truths
        .iter()
        .map(|(frame, truths)| Frame::new(truths, &tracks.remove(frame).unwrap_or_default()).unwrap())
        .collect();
    assert!(tracks.is_empty(), "every frame has a truth");
    frames
}

fn assert_all(expected: &Value, figures: &[(&str, f64)]) {
    for &(name, figure) in figures {
        let expected = expected[name].as_f64().unwrap();
        assert!((figure - expected).abs() < 1e-6, "{name}: {figure}, expected {expected}");
    }
}

fn clear_mot() -> ClearMotCounts {
    let mut clear_mot = ClearMot::new(GATE_M).unwrap();
    frames().iter().for_each(|frame| clear_mot.add(frame));
    clear_mot.finish()
}

#[test]
fn clear_mot_equals_motmetrics() {
    let counts = clear_mot();
    let figures = [
        ("num_frames", counts.frames_len as f64),
        ("mota", counts.mota().unwrap()),
        ("motp", counts.motp_m().unwrap()),
        ("num_switches", counts.switch_count as f64),
        ("num_fragmentations", counts.fragmentation_count as f64),
        ("num_misses", counts.missed_count as f64),
        ("num_false_positives", counts.false_count as f64),
        ("num_detections", counts.matched_count as f64),
        ("num_objects", counts.truths_len() as f64),
        ("num_transfer", counts.transfer_count as f64),
        ("num_ascend", counts.ascent_count as f64),
        ("num_migrate", counts.migration_count as f64),
        ("mostly_tracked", counts.mostly_tracked_count as f64),
        ("partially_tracked", counts.partly_tracked_count as f64),
        ("mostly_lost", counts.mostly_lost_count as f64),
        ("precision", counts.precision().unwrap()),
        ("recall", counts.recall().unwrap()),
    ];
    assert_all(&expected()["motmetrics"], &figures);
}

#[test]
fn clear_mot_equals_trackeval_where_definitions_agree() {
    let counts = clear_mot();
    let truths = counts.truths_len() as f64;
    // A similarity of 1 − d / 2, linear in the distance below the gate.
    let similarity_sum = counts.matched_count as f64 - counts.distance_sum_m / ZERO_M;
    let truths_len =
        (counts.mostly_tracked_count + counts.partly_tracked_count + counts.mostly_lost_count) as f64;
    let figures = [
        ("MOTA", counts.mota().unwrap()),
        ("MODA", counts.moda().unwrap()),
        ("MOTAL", counts.moda().unwrap() - (counts.switch_count as f64).log10() / truths),
        ("MOTP", linear_similarity(counts.motp_m().unwrap(), ZERO_M)),
        ("MOTP_sum", similarity_sum),
        ("sMOTA", (similarity_sum - (counts.false_count + counts.switch_count) as f64) / truths),
        ("CLR_Re", counts.recall().unwrap()),
        ("CLR_Pr", counts.precision().unwrap()),
        ("CLR_F1", counts.f1().unwrap()),
        ("CLR_TP", counts.matched_count as f64),
        ("CLR_FN", counts.missed_count as f64),
        ("CLR_FP", counts.false_count as f64),
        ("FP_per_frame", counts.false_count as f64 / counts.frames_len as f64),
        ("CLR_Frames", counts.frames_len as f64),
        ("IDSW", counts.switch_count as f64),
        ("Frag", counts.fragmentation_count as f64),
        ("MT", counts.mostly_tracked_count as f64),
        ("PT", counts.partly_tracked_count as f64),
        ("ML", counts.mostly_lost_count as f64),
        ("MTR", counts.mostly_tracked_count as f64 / truths_len),
        ("PTR", counts.partly_tracked_count as f64 / truths_len),
        ("MLR", counts.mostly_lost_count as f64 / truths_len),
    ];
    assert_all(&expected()["trackeval_CLEAR"], &figures);
}

#[test]
fn identity_equals_motmetrics_and_trackeval() {
    let mut identity = Identity::new(GATE_M).unwrap();
    frames().iter().for_each(|frame| identity.add(frame));
    let counts = identity.finish();
    let (idf1, idp, idr) = (counts.idf1().unwrap(), counts.idp().unwrap(), counts.idr().unwrap());
    let [idtp, idfp, idfn] =
        [counts.true_count, counts.false_count, counts.missed_count].map(|len| len as f64);
    let figures =
        [("idf1", idf1), ("idp", idp), ("idr", idr), ("idtp", idtp), ("idfp", idfp), ("idfn", idfn)];
    assert_all(&expected()["motmetrics"], &figures);
    let figures =
        [("IDF1", idf1), ("IDP", idp), ("IDR", idr), ("IDTP", idtp), ("IDFP", idfp), ("IDFN", idfn)];
    assert_all(&expected()["trackeval_Identity"], &figures);
}

#[test]
fn hota_equals_trackeval_at_every_alpha() {
    let mut hota = Hota::default();
    frames().iter().for_each(|frame| hota.add(frame, |distance_m| linear_similarity(distance_m, ZERO_M)));
    let counts = hota.finish();
    let expected = &expected()["trackeval_HOTA"];
    let parts: [(&str, Part); 9] = [
        ("HOTA", |score| score.hota),
        ("DetA", |score| score.det_a),
        ("DetRe", |score| score.det_re),
        ("DetPr", |score| score.det_pr),
        ("AssA", |score| score.ass_a),
        ("AssRe", |score| score.ass_re),
        ("AssPr", |score| score.ass_pr),
        ("LocA", |score| score.loc_a),
        ("OWTA", |score| score.owta),
    ];
    let scores = counts.scores();
    for (name, part) in parts {
        let expected: Vec<f64> =
            expected[name].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
        assert_eq!(expected.len(), scores.len());
        for (score, expected) in scores.iter().zip(&expected) {
            assert!((part(score) - expected).abs() < 1e-6, "{name}: {}, expected {expected}", part(score));
        }
        let mean = expected.iter().sum::<f64>() / expected.len() as f64;
        assert!((part(&counts.mean()) - mean).abs() < 1e-6, "mean {name}");
    }
    for (i, alpha) in counts.alphas.iter().enumerate() {
        assert_eq!(Some(alpha.matched_count as f64), expected["HOTA_TP"][i].as_f64());
        assert_eq!(Some((counts.truths_len - alpha.matched_count) as f64), expected["HOTA_FN"][i].as_f64());
        assert_eq!(Some((counts.track_count - alpha.matched_count) as f64), expected["HOTA_FP"][i].as_f64());
    }
    let first = scores[0];
    let figures =
        [("HOTA(0)", first.hota), ("LocA(0)", first.loc_a), ("HOTALocA(0)", first.hota * first.loc_a)];
    assert_all(expected, &figures);
}

#[test]
fn gospa_and_ospa_equal_stone_soup() {
    let cases: Vec<Value> = serde_json::from_str(&golden("gospa_ospa.json")).unwrap();
    assert_eq!(cases.len(), 126);
    for case in cases {
        let set = |name: &str| -> Vec<Object> {
            let positions: Vec<[f64; 2]> = serde_json::from_value(case[name].clone()).unwrap();
            positions.into_iter().zip(0..).map(|(position_m, id)| Object { id, position_m }).collect()
        };
        let frame = Frame::new(&set("truth"), &set("tracks")).unwrap();
        let distance = SetDistance::new(case["c"].as_f64().unwrap(), case["p"].as_f64().unwrap()).unwrap();
        let (gospa, ospa) = (distance.gospa(&frame), distance.ospa(&frame));
        assert!((gospa.distance_m - case["gospa"].as_f64().unwrap()).abs() < 1e-9, "{gospa:?}: {case}");
        assert!((ospa - case["ospa"].as_f64().unwrap()).abs() < 1e-9, "{ospa}: {case}");
    }
}
