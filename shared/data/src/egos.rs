//! Poses of the sensor at their own times, and the pose at any other time.

use std::collections::BTreeMap;
use std::ops::Bound;

use crate::{Ego, text};

/// Largest time between a frame's stamp and a pose of a moving sensor that is used for it. It is also half of
/// the longest gap between two poses that is interpolated.
pub(crate) const POSE_MAX_NS: i64 = 1_000_000_000;

/// The poses of a sensor.
#[derive(Debug, Default)]
pub(crate) struct Egos {
    /// By time, with the lines that they were read from.
    poses: BTreeMap<i64, (Ego, usize)>,
}

impl Egos {
    /// Stores a pose, or returns the line of an earlier pose with the same stamp.
    pub fn insert(&mut self, stamp_ns: i64, ego: Ego, line: usize) -> Result<(), usize> {
        self.poses.insert(stamp_ns, (ego, line)).map_or(Ok(()), |(_, first)| Err(first))
    }

    /// The pose at each of the frames' stamps, and the number of frames without a pose near enough in time.
    ///
    /// 1. Between two poses at most 2 s apart, the pose is interpolated, and the heading along the shortest
    ///    arc.
    /// 2. Otherwise the nearest pose is used if it is at most 1 s away.
    /// 3. A sensor that does not move keeps its last pose for any time. It moves if poses that are at most 2
    ///    s apart differ.
    /// 4. Otherwise the last pose (or `before`, if there is none) is the scene's centre and not the sensor.
    pub fn at(&self, stamps_ns: impl Iterator<Item = i64>, before: Ego) -> (Vec<Ego>, usize) {
        let moves = self.moves();
        let mut missing_count = 0;
        let egos = stamps_ns.map(|stamp_ns| {
            self.near(stamp_ns, moves).unwrap_or_else(|| {
                missing_count += usize::from(moves);
                let last = self.poses.range(..stamp_ns).next_back();
                last.map_or(before, |(_, (ego, _))| Ego { is_sensor: false, ..*ego })
            })
        });
        let egos = egos.collect();
        (egos, missing_count)
    }

    fn near(&self, stamp_ns: i64, moves: bool) -> Option<Ego> {
        let last = self.poses.range(..=stamp_ns).next_back().map(|(&at_ns, &(ego, _))| (at_ns, ego));
        let next = self.poses.range((Bound::Excluded(stamp_ns), Bound::Unbounded)).next();
        let next = next.map(|(&at_ns, &(ego, _))| (at_ns, ego));
        if let (Some((last_ns, from)), Some((next_ns, to))) = (last, next) {
            let gap_ns = next_ns - last_ns;
            if from == to || last_ns == stamp_ns {
                return Some(from);
            }
            if gap_ns <= 2 * POSE_MAX_NS && from.is_sensor == to.is_sensor {
                return Some(between(from, to, (stamp_ns - last_ns) as f64 / gap_ns as f64));
            }
        }
        let distance_ns = |(at_ns, _): &(i64, Ego)| at_ns.abs_diff(stamp_ns);
        let usable = |pose: &(i64, Ego)| distance_ns(pose) <= POSE_MAX_NS.unsigned_abs();
        match last {
            Some(last) if !moves => Some(last.1),
            _ => last.into_iter().chain(next).filter(usable).min_by_key(distance_ns).map(|(_, ego)| ego),
        }
    }

    /// Whether the sensor moves while its poses are known.
    fn moves(&self) -> bool {
        self.poses.iter().zip(self.poses.iter().skip(1)).any(|(last, next)| {
            let ((last_ns, (from, _)), (next_ns, (to, _))) = (last, next);
            next_ns - last_ns <= 2 * POSE_MAX_NS && from != to
        })
    }
}

fn between(from: Ego, to: Ego, share: f64) -> Ego {
    let mix = |a: f32, b: f32| (f64::from(a) + (f64::from(b) - f64::from(a)) * share) as f32;
    let turn_rad = text::wrapped(f64::from(to.heading_rad) - f64::from(from.heading_rad));
    Ego {
        position_m: [0, 1].map(|axis| mix(from.position_m[axis], to.position_m[axis])),
        heading_rad: text::wrapped(f64::from(from.heading_rad) + turn_rad * share) as f32,
        is_sensor: from.is_sensor,
    }
}
