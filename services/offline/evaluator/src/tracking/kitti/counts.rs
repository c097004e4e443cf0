use metrics::Mean;
use metrics::tracking::{
    ClearMot, ClearMotCounts, Frame, Hota, HotaCounts, Identity, IdentityCounts, SetDistance, TrackingError,
    linear_similarity,
};

use crate::table::Entry;

/// Maximum distance of a track from its truth. At this distance the similarity of HOTA is 0, and GOSPA and
/// OSPA are cut off.
pub(crate) const GATE_M: f64 = 2.0;
/// The order p of GOSPA and OSPA.
const ORDER: f64 = 2.0;

/// The counts of all measures for the tracks of one class. Counts of several sequences can be merged.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Counts {
    clear: ClearMotCounts,
    identity: IdentityCounts,
    hota: HotaCounts,
    gospa_m: Mean,
    ospa_m: Mean,
}

wire::named! {
    /// A figure computed from [`Counts`].
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub(crate) enum KittiMeasure {
        Mota => "MOTA",
        Idf1 => "IDF1",
        Hota => "HOTA",
        Gospa => "GOSPA, m",
        Ospa => "OSPA, m",
        Missed => "misses",
        False => "false",
        Switches => "switches",
    }
}

impl Counts {
    /// Counts the frames of a sequence.
    pub(crate) fn of(frames: &[Frame]) -> Result<Self, TrackingError> {
        let (mut clear, mut identity) = (ClearMot::new(GATE_M)?, Identity::new(GATE_M)?);
        let (mut hota, distance) = (Hota::default(), SetDistance::new(GATE_M, ORDER)?);
        let (mut gospa_m, mut ospa_m) = (Mean::default(), Mean::default());
        for frame in frames {
            clear.add(frame);
            identity.add(frame);
            hota.add(frame, |distance_m| linear_similarity(distance_m, GATE_M));
            // Frames without truths and tracks would only dilute the mean.
            if !(frame.truths().is_empty() && frame.tracks().is_empty()) {
                gospa_m.add(distance.gospa(frame).distance_m);
                ospa_m.add(distance.ospa(frame));
            }
        }
        Ok(Self { clear: clear.finish(), identity: identity.finish(), hota: hota.finish(), gospa_m, ospa_m })
    }

    /// Adds the counts of another sequence.
    pub(crate) fn merge(&mut self, other: &Self) {
        self.clear.merge(&other.clear);
        self.identity.merge(&other.identity);
        self.hota.merge(&other.hota);
        self.gospa_m.merge(&other.gospa_m);
        self.ospa_m.merge(&other.ospa_m);
    }

    /// The sum of several counts.
    pub(crate) fn sum<'a>(counts: impl Iterator<Item = &'a Self>) -> Self {
        counts.fold(Self::default(), |mut sum, counts| {
            sum.merge(counts);
            sum
        })
    }

    /// Number of truths in all frames together.
    pub(crate) const fn truths_len(&self) -> u64 {
        self.clear.truths_len()
    }

    /// A figure; `None` if there is nothing to count.
    pub(crate) fn figure(&self, measure: KittiMeasure) -> Option<f64> {
        let count = |len: u64| Some(len as f64);
        match measure {
            KittiMeasure::Mota => self.clear.mota(),
            KittiMeasure::Idf1 => self.identity.idf1(),
            KittiMeasure::Hota => (self.clear.truths_len() > 0).then(|| self.hota.mean().hota),
            KittiMeasure::Gospa => self.gospa_m.value(),
            KittiMeasure::Ospa => self.ospa_m.value(),
            KittiMeasure::Missed => count(self.clear.missed_count),
            KittiMeasure::False => count(self.clear.false_count),
            KittiMeasure::Switches => count(self.clear.switch_count),
        }
    }
}

impl KittiMeasure {
    /// The measures in the comparison of trackers.
    pub(crate) const COMPARED: [Self; 5] = [Self::Mota, Self::Idf1, Self::Hota, Self::Gospa, Self::Ospa];

    /// The figure as an entry of a table; `None` if there is nothing to count.
    pub(crate) fn entry(self, counts: &Counts) -> Option<Entry> {
        let figure = counts.figure(self)?;
        let truths = (self == Self::Missed).then(|| ("truths", counts.truths_len() as f64));
        let text = Entry::number(figure, if Self::COMPARED.contains(&self) { 3 } else { 0 }).text;
        Some(Entry::new(text, std::iter::once((self.name(), figure)).chain(truths)))
    }
}
