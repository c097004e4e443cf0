use super::frame::{Frame, TrackingError, check};
use super::pairing::{Edge, best_pairs};

/// Distances between the tracks and the truths of one instant, as sets of points without ids: GOSPA and OSPA.
///
/// The pairing minimises the sum of `d^p` over the pairs plus the cost of unpaired points. No pair is farther
/// apart than the cutoff `c`. For a recording, take the [`Mean`](crate::Mean) over its frames. Both distances
/// are metrics: they are symmetric, are 0 only for equal sets, and satisfy the triangle inequality.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SetDistance {
    cutoff_m: f64,
    order: f64,
}

/// GOSPA (α = 2) of one instant, and its components.
///
/// ```text
/// distance_m^p = localisation + missed + false_tracks
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Gospa {
    /// The distance.
    pub distance_m: f64,
    /// Sum of `d^p` over the pairs.
    pub localisation: f64,
    /// `c^p / 2` for each truth without a track.
    pub missed: f64,
    /// `c^p / 2` for each track without a truth.
    pub false_tracks: f64,
    /// Number of pairs.
    pub pair_count: usize,
}

impl SetDistance {
    /// Distances with cutoff `c` in metres, which sets the cost of a miss, and order `p`, which sets the
    /// weight of outliers.
    ///
    /// # Errors
    /// If the cutoff is not above 0, the order is below 1, or `c^p` is not a normal number.
    pub fn new(cutoff_m: f64, order: f64) -> Result<Self, TrackingError> {
        check("cutoff_m", cutoff_m, cutoff_m.is_finite() && cutoff_m > 0.0, "finite and above 0")?;
        check("order", order, order.is_finite() && order >= 1.0, "finite and at least 1")?;
        let power = cutoff_m.powf(order);
        check("cutoff_m to the power of order", power, power.is_normal(), "an ordinary number")?;
        Ok(Self { cutoff_m, order })
    }

    /// The generalised optimal sub-pattern assignment distance with α = 2; 0 for two empty sets.
    #[must_use]
    pub fn gospa(&self, frame: &Frame) -> Gospa {
        let (pair_count, localisation) = self.localisation(frame);
        let half = self.cutoff_m.powf(self.order) / 2.0;
        let missed = half * (frame.truths().len() - pair_count) as f64;
        let false_tracks = half * (frame.tracks().len() - pair_count) as f64;
        let distance_m = (localisation + missed + false_tracks).powf(self.order.recip());
        Gospa { distance_m, localisation, missed, false_tracks, pair_count }
    }

    /// The optimal sub-pattern assignment distance in metres: 0 for equal (or two empty) sets, and at most
    /// the cutoff.
    #[must_use]
    pub fn ospa(&self, frame: &Frame) -> f64 {
        let object_count = frame.truths().len().max(frame.tracks().len());
        if object_count == 0 {
            return 0.0;
        }
        let (pair_count, localisation) = self.localisation(frame);
        let unpaired = self.cutoff_m.powf(self.order) * (object_count - pair_count) as f64;
        ((localisation + unpaired) / object_count as f64).powf(self.order.recip())
    }

    /// Number of optimal pairs and the sum of their `d^p`. Both distances have the same optimal pairs,
    /// because one pair saves `c^p − d^p` in either.
    fn localisation(&self, frame: &Frame) -> (usize, f64) {
        let power = self.cutoff_m.powf(self.order);
        let mut powers = Vec::new();
        let mut edges = Vec::new();
        for (truth, track, distance_m) in frame.pairs() {
            if distance_m < self.cutoff_m {
                let distance_power = distance_m.powf(self.order);
                powers.push(distance_power);
                edges.push(Edge { truth: truth.id, track: track.id, gain: power - distance_power });
            }
        }
        let chosen = best_pairs(&edges);
        (chosen.len(), chosen.iter().map(|&i| powers[i]).sum())
    }
}
