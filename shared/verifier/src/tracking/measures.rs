//! Tracking measures: the scenario in `gt.csv` and `tracks.csv`, and distances of sets.

use std::collections::BTreeMap;
use std::path::Path;

use metrics::tracking::{
    ClearMot, ClearMotCounts, Frame, Hota, HotaCounts, HotaScore, Identity, IdentityCounts, Object, Position,
    SetDistance, TrackingError, linear_similarity,
};
use serde::Deserialize;

use super::ledger::{EXACT, Ledger, Rule};
use super::part::{Part, document};
use super::table::Table;
use crate::VerifyError;

/// For measures that other programs round internally.
const MEASURE: Rule<'static> = Rule { tolerance: 1e-6, ..EXACT };

/// `mot_expected.json`: the results of other programs for the scenario, by the programs' own names.
#[derive(Deserialize)]
struct Expected {
    /// Largest distance of a pair, in metres.
    dist_threshold: f64,
    /// Formula of HOTA's similarity.
    similarity: String,
    #[serde(default)]
    motmetrics: BTreeMap<String, Figure>,
    #[serde(default, rename = "trackeval_HOTA")]
    hota: BTreeMap<String, Figure>,
    #[serde(default, rename = "trackeval_CLEAR")]
    clear: BTreeMap<String, Figure>,
    #[serde(default, rename = "trackeval_Identity")]
    identity: BTreeMap<String, Figure>,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum Figure {
    One(f64),
    PerAlpha(Vec<f64>),
}

/// A case of `gospa_ospa.json`.
#[derive(Deserialize)]
struct SetCase {
    truth: Vec<Position>,
    tracks: Vec<Position>,
    /// Cutoff in metres.
    c: f64,
    /// Order.
    p: f64,
    alpha: f64,
    gospa: f64,
    ospa: f64,
}

/// Figures by the names that the compared program uses.
type Found = BTreeMap<&'static str, Vec<f64>>;

pub(super) fn compare(part: &mut Part, ledger: &mut Ledger) -> Result<(), VerifyError> {
    compare_scenario(part, ledger)?;
    compare_sets(part, ledger)
}

fn compare_scenario(part: &mut Part, ledger: &mut Ledger) -> Result<(), VerifyError> {
    let Some(path) = part.find("mot_expected.json") else { return Ok(()) };
    let expected: Expected = document(&path)?;
    let zero_m = expected.similarity.strip_prefix("max(0,1-d/").and_then(|rest| rest.strip_suffix(')'));
    let zero_m = zero_m.and_then(|number| number.parse().ok()).ok_or_else(|| {
        let reason = format!("similarity \"{}\" is not of the form max(0,1-d/2)", expected.similarity);
        VerifyError::malformed(&path, reason)
    })?;
    let scenario = Scenario::measure(part, &path, expected.dist_threshold, zero_m)?;
    let groups = [
        ("motmetrics", expected.motmetrics, scenario.motmetrics()),
        ("HOTA", expected.hota, scenario.trackeval_hota()),
        ("CLEAR", expected.clear, scenario.trackeval_clear()),
        ("Identity", expected.identity, scenario.trackeval_identity()),
    ];
    for (group, expected, found) in groups {
        for (name, expected) in expected {
            let expected = match expected {
                Figure::One(figure) => vec![figure],
                Figure::PerAlpha(figures) => figures,
            };
            let wrong = |reason: &str| VerifyError::malformed(&path, format!("{group}, {name}: {reason}"));
            let found = found.get(name.as_str()).ok_or_else(|| wrong("nothing computes this figure"))?;
            if found.len() != expected.len() {
                return Err(wrong(&format!("{} figures, expected {}", expected.len(), found.len())));
            }
            let vector = part.vector(group, &name);
            ledger.compare(vector, &[found.len()], found, &expected, &MEASURE);
        }
    }
    Ok(())
}

fn compare_sets(part: &mut Part, ledger: &mut Ledger) -> Result<(), VerifyError> {
    let file = "gospa_ospa.json";
    let Some(path) = part.find(file) else { return Ok(()) };
    let cases: Vec<SetCase> = document(&path)?;
    let [mut gospa, mut ospa] = [Vec::new(), Vec::new()];
    for (number, case) in cases.iter().enumerate() {
        let wrong = |reason: &str| VerifyError::malformed(&path, format!("case {number}: {reason}"));
        if case.alpha != 2.0 {
            return Err(wrong(&format!("alpha {} is not 2", case.alpha)));
        }
        let refused = |error: TrackingError| wrong(&error.to_string());
        let frame = Frame::new(&objects(&case.truth), &objects(&case.tracks)).map_err(refused)?;
        let distance = SetDistance::new(case.c, case.p).map_err(refused)?;
        gospa.push(distance.gospa(&frame).distance_m);
        ospa.push(distance.ospa(&frame));
    }
    let expected: Vec<_> = cases.iter().map(|case| case.gospa).collect();
    ledger.compare(part.vector(file, "gospa"), &[cases.len()], &gospa, &expected, &EXACT);
    let expected: Vec<_> = cases.iter().map(|case| case.ospa).collect();
    ledger.compare(part.vector(file, "ospa"), &[cases.len()], &ospa, &expected, &EXACT);
    Ok(())
}

fn objects(positions: &[Position]) -> Vec<Object> {
    (0..).zip(positions).map(|(id, &position_m)| Object { id, position_m }).collect()
}

/// Our own measures of the scenario.
struct Scenario {
    clear: ClearMotCounts,
    identity: IdentityCounts,
    hota: HotaCounts,
    /// The distance at and beyond which the similarity is 0.
    zero_m: f64,
}

impl Scenario {
    fn measure(part: &mut Part, expected: &Path, gate_m: f64, zero_m: f64) -> Result<Self, VerifyError> {
        let refused = |error: TrackingError| VerifyError::caused(expected, "", error);
        let mut clear = ClearMot::new(gate_m).map_err(refused)?;
        let mut identity = Identity::new(gate_m).map_err(refused)?;
        let mut hota = Hota::default();
        for frame in frames(part)? {
            clear.add(&frame);
            identity.add(&frame);
            hota.add(&frame, |distance_m| linear_similarity(distance_m, zero_m));
        }
        Ok(Self { clear: clear.finish(), identity: identity.finish(), hota: hota.finish(), zero_m })
    }

    fn motmetrics(&self) -> Found {
        let (clear, identity) = (&self.clear, &self.identity);
        one_each([
            ("num_frames", count(clear.frames_len)),
            ("mota", clear.mota()),
            ("motp", clear.motp_m()),
            ("num_switches", count(clear.switch_count)),
            ("num_fragmentations", count(clear.fragmentation_count)),
            ("num_misses", count(clear.missed_count)),
            ("num_false_positives", count(clear.false_count)),
            ("num_detections", count(clear.matched_count)),
            ("num_objects", count(clear.truths_len())),
            ("num_transfer", count(clear.transfer_count)),
            ("num_ascend", count(clear.ascent_count)),
            ("num_migrate", count(clear.migration_count)),
            ("mostly_tracked", count(clear.mostly_tracked_count)),
            ("partially_tracked", count(clear.partly_tracked_count)),
            ("mostly_lost", count(clear.mostly_lost_count)),
            ("precision", clear.precision()),
            ("recall", clear.recall()),
            ("idf1", identity.idf1()),
            ("idp", identity.idp()),
            ("idr", identity.idr()),
            ("idtp", count(identity.true_count)),
            ("idfp", count(identity.false_count)),
            ("idfn", count(identity.missed_count)),
        ])
    }

    fn trackeval_clear(&self) -> Found {
        let clear = &self.clear;
        let [truths, switches, matched] =
            [clear.truths_len(), clear.switch_count, clear.matched_count].map(|len| len as f64);
        let lives =
            (clear.mostly_tracked_count + clear.partly_tracked_count + clear.mostly_lost_count) as f64;
        // Sum over distances below the gate, where the similarity is linear.
        let similarity_sum = matched - clear.distance_sum_m / self.zero_m;
        one_each([
            ("MOTA", clear.mota()),
            ("MODA", clear.moda()),
            ("MOTAL", clear.moda().map(|moda| moda - switches.max(1.0).log10() / truths)),
            ("MOTP", clear.motp_m().map(|motp_m| linear_similarity(motp_m, self.zero_m))),
            ("MOTP_sum", Some(similarity_sum)),
            ("sMOTA", Some((similarity_sum - clear.false_count as f64 - switches) / truths)),
            ("CLR_Re", clear.recall()),
            ("CLR_Pr", clear.precision()),
            ("CLR_F1", clear.f1()),
            ("CLR_TP", Some(matched)),
            ("CLR_FN", count(clear.missed_count)),
            ("CLR_FP", count(clear.false_count)),
            ("FP_per_frame", Some(clear.false_count as f64 / clear.frames_len as f64)),
            ("CLR_Frames", count(clear.frames_len)),
            ("IDSW", Some(switches)),
            ("Frag", count(clear.fragmentation_count)),
            ("MT", count(clear.mostly_tracked_count)),
            ("PT", count(clear.partly_tracked_count)),
            ("ML", count(clear.mostly_lost_count)),
            ("MTR", Some(clear.mostly_tracked_count as f64 / lives)),
            ("PTR", Some(clear.partly_tracked_count as f64 / lives)),
            ("MLR", Some(clear.mostly_lost_count as f64 / lives)),
        ])
    }

    fn trackeval_identity(&self) -> Found {
        one_each([
            ("IDF1", self.identity.idf1()),
            ("IDP", self.identity.idp()),
            ("IDR", self.identity.idr()),
            ("IDTP", count(self.identity.true_count)),
            ("IDFP", count(self.identity.false_count)),
            ("IDFN", count(self.identity.missed_count)),
        ])
    }

    fn trackeval_hota(&self) -> Found {
        let scores = self.hota.scores();
        let of = |figure: fn(&HotaScore) -> f64| scores.iter().map(figure).collect::<Vec<_>>();
        let matched = || self.hota.alphas.iter().map(|alpha| alpha.matched_count);
        let less_than = |all: u64| matched().map(|len| (all - len) as f64).collect();
        let [first, ..] = scores;
        BTreeMap::from([
            ("HOTA", of(|score| score.hota)),
            ("DetA", of(|score| score.det_a)),
            ("DetRe", of(|score| score.det_re)),
            ("DetPr", of(|score| score.det_pr)),
            ("AssA", of(|score| score.ass_a)),
            ("AssRe", of(|score| score.ass_re)),
            ("AssPr", of(|score| score.ass_pr)),
            ("LocA", of(|score| score.loc_a)),
            ("OWTA", of(|score| score.owta)),
            ("HOTA_TP", matched().map(|len| len as f64).collect()),
            ("HOTA_FN", less_than(self.hota.truths_len)),
            ("HOTA_FP", less_than(self.hota.track_count)),
            ("HOTA(0)", vec![first.hota]),
            ("LocA(0)", vec![first.loc_a]),
            ("HOTALocA(0)", vec![first.hota * first.loc_a]),
        ])
    }
}

fn count(len: u64) -> Option<f64> {
    Some(len as f64)
}

/// Figures of one number each. A figure without a value is NaN.
fn one_each<const N: usize>(figures: [(&'static str, Option<f64>); N]) -> Found {
    figures.into_iter().map(|(name, figure)| (name, vec![figure.unwrap_or(f64::NAN)])).collect()
}

/// The frames of the scenario.
fn frames(part: &mut Part) -> Result<Vec<Frame>, VerifyError> {
    let mut frames = BTreeMap::<u64, [Vec<Object>; 2]>::new();
    for (side, file) in ["gt.csv", "tracks.csv"].into_iter().enumerate() {
        let table = Table::read(&part.expect(file)?)?;
        let (numbers, ids) = (table.whole_numbers("frame")?, table.whole_numbers("id")?);
        for ((number, id), position_m) in numbers.into_iter().zip(ids).zip(table.number_rows(["x", "y"])?) {
            frames.entry(number).or_default()[side].push(Object { id, position_m });
        }
    }
    let frame = |(number, [truths, tracks]): (u64, [Vec<Object>; 2])| {
        Frame::new(&truths, &tracks)
            .map_err(|error| VerifyError::caused(part.path(), &format!("frame {number}"), error))
    };
    frames.into_iter().map(frame).collect()
}
