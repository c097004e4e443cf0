//! A recording as reported by a noisy sensor with gaps.

#[cfg(test)]
pub(crate) mod tests;

use std::collections::BTreeMap;

use data::Recording;
use kinematics::Normals;
use metrics::tracking::PlanarState;
use wire::{AgentType, detection_flags};

use super::Place;

/// Minimum time for which a vehicle is measured before its first gap.
const MEASURED_FIRST_S: f64 = 3.0;
/// Time for which a vehicle is measured between two gaps.
const MEASURED_BETWEEN_S: f64 = 4.0;

/// The sensor's errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Sensor {
    /// Standard deviation of a measured position per axis.
    pub(crate) sigma_m: f64,
    /// Length of a gap; 0 for no gaps.
    pub(crate) gap_s: f64,
    /// Seed of the noise and of the gaps' phases.
    pub(crate) seed: u64,
}

/// An agent at one time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    pub(crate) id: u64,
    pub(crate) agent_type: AgentType,
    pub(crate) length_m: Option<f32>,
    /// `None` at the ends of a track, because its velocity is unknown there.
    pub(crate) truth: Option<PlanarState>,
    /// Position, if it was measured.
    pub(crate) measured_m: Option<[f64; 2]>,
}

/// All agents at one time, ordered by id.
#[derive(Clone, Debug)]
pub(crate) struct Instant {
    pub(crate) stamp_ns: i64,
    /// Position of the sensor.
    pub(crate) ego_m: [f32; 2],
    pub(crate) agents: Vec<Seen>,
}

/// Instants in time order.
#[derive(Clone, Debug)]
pub(crate) struct Course<'a> {
    pub(crate) sensor: Sensor,
    /// Prior knowledge of the site.
    pub(crate) place: &'a Place<'a>,
    pub(crate) instants: Vec<Instant>,
}

impl<'a> Course<'a> {
    /// The frames between two times of a recording with identities, as the sensor reports them.
    ///
    /// The true velocity is the central difference of positions. Unlike the recording's velocity it is
    /// neither late nor smoothed.
    pub(crate) fn new(
        recording: &Recording,
        [from_ns, to_ns]: [i64; 2],
        sensor: Sensor,
        place: &'a Place<'a>,
    ) -> Self {
        let mut positions: BTreeMap<(u64, i64), [f64; 2]> = BTreeMap::new();
        let frames = || recording.frames.iter().filter(|frame| (from_ns..=to_ns).contains(&frame.stamp_ns));
        let mut born: BTreeMap<u64, i64> = BTreeMap::new();
        for frame in frames() {
            for detection in &frame.detections {
                let position_m = [detection.x_m, detection.y_m].map(f64::from);
                positions.insert((detection.id, frame.stamp_ns), position_m);
                born.entry(detection.id).or_insert(frame.stamp_ns);
            }
        }
        let interval_ns = recording.interval_ns.cast_signed();
        let truth = |id: u64, stamp_ns: i64| {
            let before = positions.get(&(id, stamp_ns - interval_ns))?;
            let after = positions.get(&(id, stamp_ns + interval_ns))?;
            let elapsed_s = 2.0 * interval_ns as f64 / 1e9;
            Some(PlanarState {
                position_m: positions[&(id, stamp_ns)],
                velocity_mps: [0, 1].map(|axis| (after[axis] - before[axis]) / elapsed_s),
            })
        };
        let seen = |detection: &wire::Detection, stamp_ns: i64| {
            let (id, agent_type) = (detection.id, detection.agent_type().ok()?);
            let age_s = (stamp_ns - born[&id]) as f64 / 1e9;
            let occluded = agent_type == AgentType::Vehicle && sensor.occludes(id, age_s);
            let sized = detection.flags & detection_flags::HAS_SIZE != 0;
            Some(Seen {
                id,
                agent_type,
                length_m: sized.then_some(detection.length_m),
                truth: truth(id, stamp_ns),
                measured_m: (!occluded).then(|| sensor.measure(id, stamp_ns, positions[&(id, stamp_ns)])),
            })
        };
        let instants = frames().map(|frame| {
            let mut agents: Vec<Seen> =
                frame.detections.iter().filter_map(|detection| seen(detection, frame.stamp_ns)).collect();
            agents.sort_by_key(|agent| agent.id);
            Instant { stamp_ns: frame.stamp_ns, ego_m: frame.ego.position_m, agents }
        });
        Self { sensor, place, instants: instants.collect() }
    }
}

impl Instant {
    /// Whether an agent is measured at this instant.
    pub(crate) fn measures(&self, id: u64) -> bool {
        let place = self.agents.binary_search_by_key(&id, |seen| seen.id);
        place.is_ok_and(|place| self.agents[place].measured_m.is_some())
    }
}

impl Sensor {
    /// Whether an agent is in a gap `age_s` after its first frame.
    fn occludes(&self, id: u64, age_s: f64) -> bool {
        let period_s = MEASURED_BETWEEN_S + self.gap_s;
        // A phase from 0 to 1.
        let phase = f64::from(Normals::new(self.seed, id, 0).draw().abs()).fract();
        let since_s = age_s - MEASURED_FIRST_S - phase * MEASURED_BETWEEN_S;
        since_s >= 0.0 && since_s.rem_euclid(period_s) < self.gap_s
    }

    fn measure(&self, id: u64, stamp_ns: i64, position_m: [f64; 2]) -> [f64; 2] {
        let mut normals = Normals::new(self.seed, id, stamp_ns.cast_unsigned());
        position_m.map(|value| value + self.sigma_m * f64::from(normals.draw()))
    }
}
