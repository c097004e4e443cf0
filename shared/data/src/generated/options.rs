use thiserror::Error;
use wire::AGENTS_MAX;

use crate::Ego;

/// The agents of a generated scene and the errors of its sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneOptions {
    /// Agents present at the same time, 1 to [`AGENTS_MAX`]. One or two may be missing while an entrance is
    /// blocked.
    pub agents: usize,
    /// Share of vehicles among them, 0 to 1, limited to the number that fits the lanes without a jam to their
    /// ends.
    pub vehicle_share: f32,
    /// Share of cyclists. All others are pedestrians.
    pub cyclist_share: f32,
    /// Seed of the scene. The same seed gives the same scene to the bit.
    pub seed: u64,
    /// Whether detections contain the true identities. Without them, a tracker has to associate.
    pub identities: bool,
    /// Whether detections of vehicles and cyclists contain a speed.
    pub speeds: bool,
    /// Standard deviation of the detected position per axis, by type (vehicle, cyclist, pedestrian).
    pub position_sigma_m: [f32; 3],
    /// Standard deviation of the detected heading.
    pub heading_sigma_rad: f32,
    /// Standard deviation of the detected speed.
    pub speed_sigma_mps: f32,
    /// Standard deviation of the detected length and width, as a share of them.
    pub size_sigma_share: f32,
    /// Probability that a visible agent is not detected.
    pub miss_probability: f32,
    /// Mean number of false detections in a frame.
    pub clutter_mean: f32,
    /// Probability that a detected heading is turned by π.
    pub yaw_flip_probability: f32,
    /// Whether agents behind a vehicle, as seen from the sensor, are occluded.
    pub occlusion: bool,
    /// Pose of the sensor.
    pub sensor: Ego,
}

impl Default for SceneOptions {
    /// 32 agents under a good detector on a corner mast.
    fn default() -> Self {
        Self {
            agents: 32,
            vehicle_share: 0.3,
            cyclist_share: 0.15,
            seed: 1,
            identities: false,
            speeds: false,
            position_sigma_m: [0.15, 0.12, 0.08],
            heading_sigma_rad: 0.04,
            speed_sigma_mps: 0.3,
            size_sigma_share: 0.03,
            miss_probability: 0.05,
            clutter_mean: 0.5,
            yaw_flip_probability: 0.0,
            occlusion: true,
            sensor: Ego {
                position_m: [13.0, 13.0],
                heading_rad: -0.75 * std::f32::consts::PI,
                is_sensor: true,
            },
        }
    }
}

/// Noise of the headings and of the speeds, per metre of noise on each axis of the positions.
const HEADING_RAD_PER_M: f32 = 2_f32.to_radians() / 0.1;
const SPEED_MPS_PER_M: f32 = 0.2 / 0.1;
/// The same for lengths and widths, as a share of them.
const SIZE_SHARE_PER_M: f32 = 0.03 / 0.1;

/// An option of a generated scene that is out of its range.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("generated scene: {option} = {value}, expected {least} to {most}")]
pub struct OptionError {
    /// The option's name.
    pub option: &'static str,
    /// Its value.
    pub value: f64,
    /// Smallest value allowed.
    pub least: f64,
    /// Largest value allowed.
    pub most: f64,
}

impl SceneOptions {
    /// A scene whose agents are all detected in every frame, with their identities. Nothing else is detected.
    #[must_use]
    pub fn complete(agents: usize) -> Self {
        Self {
            agents,
            identities: true,
            miss_probability: 0.0,
            clutter_mean: 0.0,
            occlusion: false,
            ..Self::default()
        }
    }

    /// Largest noise of [`Self::with_noise`].
    pub const NOISE_MAX_M: f32 = 1.0;

    /// The same scene with position noise of `noise_m` on each axis, for all types. The other measurements
    /// have noise in proportion: at 0.1 m headings have 2°, speeds 0.2 m/s, lengths and widths 3 %. At 0 the
    /// detections are exact; missed and false detections remain.
    #[must_use]
    pub fn with_noise(self, noise_m: f32) -> Self {
        Self {
            position_sigma_m: [noise_m; 3],
            heading_sigma_rad: noise_m * HEADING_RAD_PER_M,
            speed_sigma_mps: noise_m * SPEED_MPS_PER_M,
            size_sigma_share: noise_m * SIZE_SHARE_PER_M,
            ..self
        }
    }

    /// Refuses options out of their ranges, NaN included.
    pub(super) fn check(&self) -> Result<(), OptionError> {
        let [vehicle_m, cyclist_m, pedestrian_m] = self.position_sigma_m;
        let ranges = [
            ("agents", self.agents as f32, 1.0, AGENTS_MAX as f32),
            ("vehicle_share", self.vehicle_share, 0.0, 1.0),
            ("cyclist_share", self.cyclist_share, 0.0, 1.0),
            ("vehicle_share + cyclist_share", self.vehicle_share + self.cyclist_share, 0.0, 1.0),
            ("position_sigma_m of vehicles", vehicle_m, 0.0, 10.0),
            ("position_sigma_m of cyclists", cyclist_m, 0.0, 10.0),
            ("position_sigma_m of pedestrians", pedestrian_m, 0.0, 10.0),
            ("heading_sigma_rad", self.heading_sigma_rad, 0.0, std::f32::consts::PI),
            ("speed_sigma_mps", self.speed_sigma_mps, 0.0, 10.0),
            ("size_sigma_share", self.size_sigma_share, 0.0, 0.5),
            ("miss_probability", self.miss_probability, 0.0, 1.0),
            ("clutter_mean", self.clutter_mean, 0.0, 100.0),
            ("yaw_flip_probability", self.yaw_flip_probability, 0.0, 1.0),
            ("sensor x", self.sensor.position_m[0], -1000.0, 1000.0),
            ("sensor y", self.sensor.position_m[1], -1000.0, 1000.0),
            ("sensor heading", self.sensor.heading_rad, -10.0, 10.0),
        ];
        match ranges.into_iter().find(|(_, value, least, most)| !(*least..=*most).contains(value)) {
            None => Ok(()),
            Some((option, value, least, most)) => Err(OptionError {
                option,
                value: f64::from(value),
                least: f64::from(least),
                most: f64::from(most),
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_valid() {
        assert_eq!(SceneOptions::default().check(), Ok(()));
    }

    #[test]
    fn noise_of_a_tenth_of_a_metre_turns_headings_by_two_degrees() {
        let scene = SceneOptions::default().with_noise(0.1);
        assert_eq!(scene.position_sigma_m, [0.1; 3]);
        let others = [scene.heading_sigma_rad.to_degrees(), scene.speed_sigma_mps, scene.size_sigma_share];
        let expected = [2.0, 0.2, 0.03];
        assert!(others.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{others:?}");
        let exact = SceneOptions::default().with_noise(0.0);
        assert_eq!((exact.heading_sigma_rad, exact.speed_sigma_mps, exact.size_sigma_share), (0.0, 0.0, 0.0));
    }

    #[test]
    fn the_largest_noise_is_valid() {
        assert_eq!(SceneOptions::default().with_noise(SceneOptions::NOISE_MAX_M).check(), Ok(()));
    }

    #[test]
    fn options_out_of_range_are_named() {
        let fine = SceneOptions::default();
        for (options, name) in [
            (SceneOptions { agents: 0, ..fine }, "agents"),
            (SceneOptions { agents: AGENTS_MAX + 1, ..fine }, "agents"),
            (
                SceneOptions { vehicle_share: 0.9, cyclist_share: 0.2, ..fine },
                "vehicle_share + cyclist_share",
            ),
            (SceneOptions { miss_probability: f32::NAN, ..fine }, "miss_probability"),
            (SceneOptions { clutter_mean: f32::INFINITY, ..fine }, "clutter_mean"),
            (SceneOptions { position_sigma_m: [0.1, -0.1, 0.1], ..fine }, "position_sigma_m of cyclists"),
        ] {
            let error = options.check().expect_err(name);
            assert_eq!(error.option, name, "{error}");
        }
    }
}
