//! The noise of the detector, as tracks and forecasts publish it, and its changes.
//!
//! The tracker learns the noise from its newest few hundred measurements. [`Noise`] compares this estimate of
//! the positions' noise with the estimate so far, by type:
//!
//! 1. The reference is the mean of the estimate's logarithm, over the last [`MEMORY_S`] with the type.
//! 2. An estimate within [`NEAR`] times the reference updates it. Otherwise the reference stays.
//! 3. An estimate beyond [`FACTOR`] times the reference is a change. Its time is the end of the time near the
//!    reference. For [`SETTLING_S`] the reference is then the estimate itself, as at the start.

use serde::{Deserialize, Serialize};
use wire::AgentType;

use crate::finding::plural;
use crate::{Doubt, Found, TYPES};

/// Memory of the reference.
const MEMORY_S: f64 = 60.0;
/// Largest ratio of an estimate that belongs to the reference.
const NEAR: f64 = 1.3;
/// Smallest ratio of a change. It is below three, because an estimate scatters.
const FACTOR: f64 = 2.5;
/// Time that the estimate has to settle.
const SETTLING_S: f64 = 10.0;
/// Smaller deviations are equal: the tracker treats them as exact.
const EQUAL_M: f64 = 0.03;
/// Longest time that one tick counts.
const TICK_MAX_S: f64 = 1.0;

/// The noise of the detections of a type: standard deviations.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct TypeNoise {
    /// The type.
    #[serde(rename = "type")]
    pub agent_type: String,
    /// Of positions, per axis.
    pub position_m: f64,
    /// Of headings, modulo a half turn; `None` if it is unknown.
    pub heading_deg: Option<f64>,
    /// Of speeds; `None` if it is unknown.
    pub speed_mps: Option<f64>,
    /// Of the positions of each sensor, if there are several. Only a tracker knows them, so they are in the
    /// inspection of a recording alone.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub sensors: Vec<SensorNoise>,
}

/// The noise of one sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SensorNoise {
    /// Number of the sensor; 0 for detections without one.
    pub sensor: u8,
    /// Standard deviation of positions, per axis.
    pub position_m: f64,
}

/// A change of the noise of positions.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Change {
    from_m: f64,
    to_m: f64,
    at_s: f64,
    /// Whether the noise has changed again.
    again: bool,
}

/// The noise of one type.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct Watched {
    /// The newest deviations of position, heading and speed; 0 if unknown.
    noise: [f32; 3],
    /// Time of the newest estimate, and the time with the type since the last change.
    newest_s: f64,
    learned_s: f64,
    /// Logarithm of the reference, and the newest time near it.
    reference: f64,
    near_s: f64,
    change: Option<Change>,
    /// Whether the change is not logged yet.
    #[serde(skip)]
    is_new: bool,
}

impl Watched {
    fn add(&mut self, now_s: f64, noise: [f32; 3]) {
        let elapsed_s = (now_s - self.newest_s).clamp(0.0, TICK_MAX_S);
        self.learned_s += elapsed_s;
        (self.noise, self.newest_s) = (noise, now_s);
        let estimate = f64::from(noise[0]).max(EQUAL_M).ln();
        if self.learned_s <= SETTLING_S {
            (self.reference, self.near_s) = (estimate, now_s);
            if let Some(change) = self.change.as_mut().filter(|change| !change.again) {
                change.to_m = estimate.exp();
            }
            return;
        }
        let off = estimate - self.reference;
        if off.abs() < NEAR.ln() {
            self.near_s = now_s;
            self.reference += off * elapsed_s / self.learned_s.min(MEMORY_S);
        }
        if off.abs() < FACTOR.ln() {
            return;
        }
        self.learned_s = 0.0;
        match &mut self.change {
            Some(change) => change.again = true,
            None => {
                let [from_m, to_m] = [self.reference, estimate].map(f64::exp);
                self.change = Some(Change { from_m, to_m, at_s: self.near_s, again: false });
                self.is_new = true;
            }
        }
    }

    /// The change as a doubt.
    fn found(&self, agent_type: AgentType) -> Option<Found> {
        let Change { from_m, to_m, at_s, again } = self.change?;
        let verb = if to_m > from_m { "rose" } else { "fell" };
        let of = plural(agent_type);
        let [from, to] = [from_m, to_m].map(metres);
        let mut sentence = format!("the position noise of {of} {verb} from {from} to {to} at {at_s:.0} s");
        if again {
            sentence += ", and changed again";
        }
        sentence += &format!(": {}", Doubt::NoiseChanged.remedy());
        Some(Found { sentence, ..Found::of_kind(Doubt::NoiseChanged) })
    }

    fn of(&self, agent_type: AgentType) -> Option<TypeNoise> {
        let [position_m, heading_rad, speed_mps] = self.noise.map(f64::from);
        let known =
            |deviation: f64, unit: f64| (deviation > 0.0).then(|| (deviation * unit * 1e3).round() / 1e3);
        Some(TypeNoise {
            agent_type: agent_type.name().to_owned(),
            position_m: known(position_m, 1.0)?,
            heading_deg: known(heading_rad, 1.0_f64.to_degrees()),
            speed_mps: known(speed_mps, 1.0),
            sensors: Vec::new(),
        })
    }
}

/// The published noise of a run, see the module.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Noise {
    of_type: [Watched; TYPES.len()],
    /// Stamp of the first tick with an agent.
    first_ns: Option<i64>,
}

impl Noise {
    /// Adds the agents of a tick: number of the type, and published noise. Does not allocate.
    pub fn tick(&mut self, stamp_ns: i64, agents: impl Iterator<Item = (u32, [f32; 3])>) {
        let first_ns = *self.first_ns.get_or_insert(stamp_ns);
        let now_s = stamp_ns.saturating_sub(first_ns) as f64 * 1e-9;
        let mut newest = [[0.0; 3]; TYPES.len()];
        for (agent_type, noise) in agents {
            if let Some(newest) = newest.get_mut(agent_type as usize) {
                *newest = noise;
            }
        }
        for (watched, noise) in self.of_type.iter_mut().zip(newest).filter(|(_, noise)| noise[0] > 0.0) {
            watched.add(now_s, noise);
        }
    }

    /// The newest noise of each type for which it is known.
    pub fn types(&self) -> impl Iterator<Item = TypeNoise> {
        self.of_type.iter().zip(TYPES).filter_map(|(watched, agent_type)| watched.of(agent_type))
    }

    /// The changes, as doubts.
    pub fn changes(&self) -> impl Iterator<Item = Found> {
        self.of_type.iter().zip(TYPES).filter_map(|(watched, agent_type)| watched.found(agent_type))
    }

    /// The changes since the last call.
    pub fn take_new(&mut self) -> impl Iterator<Item = Found> {
        let of_type = self.of_type.iter_mut().zip(TYPES);
        of_type.filter_map(|(watched, agent_type)| {
            std::mem::take(&mut watched.is_new).then(|| watched.found(agent_type)).flatten()
        })
    }

    /// The bit of the doubt, or 0.
    #[must_use]
    pub fn doubts(&self) -> u32 {
        let has_changed = self.of_type.iter().any(|watched| watched.change.is_some());
        if has_changed { Doubt::NoiseChanged.bit() } else { 0 }
    }
}

/// The noise in words, such as `vehicles 0.11 m, headings 2.1°; pedestrians < 0.01 m`; `None` if it is unknown.
#[must_use]
pub fn noise_words(noise: &[TypeNoise]) -> Option<String> {
    let words = |of_type: &TypeNoise| {
        let agents = of_type.agent_type.parse().map_or("agents", plural);
        let mut words = format!("{agents} {}", metres(of_type.position_m));
        let of_sensors = of_type.sensors.iter().map(|SensorNoise { sensor, position_m }| {
            let position = metres(*position_m);
            if *sensor > 0 {
                format!("sensor {sensor} {position}")
            } else {
                format!("without a sensor {position}")
            }
        });
        let of_sensors = of_sensors.collect::<Vec<_>>().join(", ");
        if !of_sensors.is_empty() {
            words += &format!(" ({of_sensors})");
        }
        if let Some(heading_deg) = of_type.heading_deg {
            words += &format!(", headings {}", at_least(heading_deg, 1, "°"));
        }
        if let Some(speed_mps) = of_type.speed_mps {
            words += &format!(", speeds {}", at_least(speed_mps, 1, " m/s"));
        }
        words
    };
    (!noise.is_empty()).then(|| noise.iter().map(words).collect::<Vec<_>>().join("; "))
}

fn metres(deviation_m: f64) -> String {
    at_least(deviation_m, 2, " m")
}

/// A number with these decimals and its unit; `< 0.01` if it is smaller than they show.
fn at_least(value: f64, decimals: usize, unit: &str) -> String {
    let least = 0.1_f64.powi(decimals as i32);
    if value < least { format!("< {least:.decimals$}{unit}") } else { format!("{value:.decimals$}{unit}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The noise of a run of vehicles whose estimate at each time is `estimate_m`, at 10 Hz.
    fn noise(duration_s: f64, estimate_m: impl Fn(f64) -> f64) -> Noise {
        let mut noise = Noise::default();
        for tick in 0..(duration_s * 10.0) as i64 {
            let deviation = estimate_m(tick as f64 * 0.1) as f32;
            noise.tick(7_000_000_000 + tick * 100_000_000, [(0, [deviation, 0.0, 0.0])].into_iter());
        }
        noise
    }

    /// An estimate that follows the true deviation as the tracker's does, within about 3 s.
    fn following(from_m: f64, to_m: f64, at_s: f64) -> impl Fn(f64) -> f64 {
        move |time_s| {
            let share = 1.0 - (-(time_s - at_s).max(0.0) / 3.0).exp();
            (from_m.powi(2) + share * (to_m.powi(2) - from_m.powi(2))).sqrt()
        }
    }

    #[test]
    fn a_change_by_three_is_found_with_its_time() {
        for (from_m, to_m, words) in
            [(0.1, 0.35, "rose from 0.10 m to 0.35 m"), (0.3, 0.1, "fell from 0.30 m to 0.10 m")]
        {
            let mut noise = noise(90.0, following(from_m, to_m, 41.0));
            let [change] = &noise.changes().collect::<Vec<_>>()[..] else { panic!("one change") };
            let sentence = &change.sentence;
            assert!(
                sentence.starts_with(&format!("the position noise of vehicles {words} at 4")),
                "{sentence}"
            );
            let at_s: f64 =
                sentence.split(" at ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
            assert!((40.0..=44.0).contains(&at_s), "{sentence}");
            assert_eq!((change.kind.as_str(), change.doubtful), ("noise_changed", true));
            assert_eq!(noise.doubts(), Doubt::NoiseChanged.bit());
            assert_eq!([noise.take_new().count(), noise.take_new().count()], [1, 0]);
        }
    }

    #[test]
    fn smaller_and_slow_changes_and_changes_below_the_floor_are_no_doubt() {
        for estimate_m in [
            &following(0.1, 0.2, 41.0) as &dyn Fn(f64) -> f64,
            &following(0.001, 0.03, 41.0),
            &following(0.2, 0.6, 2.0),
            &|time_s| 0.1 * (0.3 * (time_s * 0.9).sin()).exp(),
        ] {
            let noise = noise(300.0, estimate_m);
            assert_eq!((noise.doubts(), noise.changes().count()), (0, 0));
        }
    }

    #[test]
    fn a_later_change_is_mentioned() {
        let noise = noise(120.0, |time_s| if (30.0..60.0).contains(&time_s) { 0.4 } else { 0.1 });
        let sentence = noise.changes().next().unwrap().sentence;
        let expected = "the position noise of vehicles rose from 0.10 m to 0.40 m at 30 s, and changed again";
        assert!(sentence.starts_with(expected), "{sentence}");
    }

    #[test]
    fn words_have_the_known_deviations() {
        let mut noise = Noise::default();
        assert_eq!(noise_words(&noise.types().collect::<Vec<_>>()), None);
        noise.tick(1, [(0, [0.112, 0.035, 0.3]), (2, [0.004, 0.0, 0.0]), (9, [1.0; 3])].into_iter());
        noise.tick(2, [(1, [0.0; 3])].into_iter());
        let mut types: Vec<TypeNoise> = noise.types().collect();
        assert_eq!(types.len(), 2);
        let words = noise_words(&types);
        assert_eq!(
            words.as_deref(),
            Some("vehicles 0.11 m, headings 2.0°, speeds 0.3 m/s; pedestrians < 0.01 m")
        );
        types.truncate(1);
        let of = |(sensor, position_m)| SensorNoise { sensor, position_m };
        types[0].sensors = [(0, 0.31), (2, 0.053)].map(of).to_vec();
        assert_eq!(
            noise_words(&types).as_deref(),
            Some("vehicles 0.11 m (without a sensor 0.31 m, sensor 2 0.05 m), headings 2.0°, speeds 0.3 m/s")
        );
    }
}
