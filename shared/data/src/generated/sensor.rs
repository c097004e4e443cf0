//! The reports of a fixed sensor: noise, misses, occlusion, clutter.

use kinematics::wrap_angle;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Poisson, StandardNormal};
use wire::{AGENT_TYPES, AgentType, DETECTIONS_MAX, Detection, detection_flags};

use super::options::SceneOptions;
use super::path::Point;

/// The true state of an agent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Agent {
    pub(super) id: u64,
    pub(super) agent_type: AgentType,
    pub(super) position_m: Point,
    pub(super) heading_rad: f32,
    pub(super) speed_mps: f32,
    pub(super) length_m: f32,
    pub(super) width_m: f32,
}

/// Clutter appears within this square around the centre.
const CLUTTER_WITHIN_M: f32 = 40.0;
/// Separates the sensor's random stream from the traffic's.
const STREAM: u64 = 1;

/// The sensor's random stream. The options contain its pose and its errors.
#[derive(Clone, Debug)]
pub(super) struct Sensor {
    rng: ChaCha8Rng,
    /// Scratch: the shadows of the vehicles.
    shadows: Vec<Shadow>,
}

/// The sector that a vehicle occludes.
#[derive(Clone, Copy, Debug)]
struct Shadow {
    id: u64,
    bearing_rad: f32,
    half_width_rad: f32,
    distance_m: f32,
}

impl Sensor {
    pub(super) fn new(seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(STREAM);
        Self { rng, shadows: Vec::new() }
    }

    /// One frame's detections, sorted by (type, id), or by position if there are no identities.
    pub(super) fn detect(&mut self, agents: &[Agent], options: &SceneOptions) -> Vec<Detection> {
        self.shadows.clear();
        let vehicles = agents.iter().filter(|a| options.occlusion && a.agent_type == AgentType::Vehicle);
        self.shadows.extend(vehicles.map(|vehicle| shadow(vehicle, options)));
        let mut detections = Vec::with_capacity(agents.len());
        for agent in agents {
            let missed = self.rng.random_bool(f64::from(options.miss_probability));
            // Drawn even if the agent is not reported, so that one option does not change all other draws.
            let detection = self.detection(agent, options);
            let occluded = self.shadows.iter().any(|shadow| shadow.occludes(agent, options));
            if !missed && !occluded {
                detections.push(detection);
            }
        }
        for _ in 0..self.clutter_count(options) {
            detections.push(self.clutter(options));
        }
        detections.truncate(DETECTIONS_MAX);
        detections.sort_by(|a, b| {
            let key = |d: &Detection| (d.agent_type, d.id);
            key(a).cmp(&key(b)).then(a.x_m.total_cmp(&b.x_m)).then(a.y_m.total_cmp(&b.y_m))
        });
        detections
    }

    fn noise(&mut self, sigma: f32) -> f32 {
        let normal: f32 = StandardNormal.sample(&mut self.rng);
        sigma * normal
    }

    fn detection(&mut self, agent: &Agent, options: &SceneOptions) -> Detection {
        use detection_flags::{HAS_HEADING, HAS_ID, HAS_SIZE, HAS_SPEED};
        let sigma_m = options.position_sigma_m[agent.agent_type.index()];
        let flipped = self.rng.random_bool(f64::from(options.yaw_flip_probability));
        let turned_rad = if flipped { std::f32::consts::PI } else { 0.0 };
        let on_wheels = agent.agent_type != AgentType::Pedestrian;
        let heading_rad = wrap_angle(agent.heading_rad + turned_rad + self.noise(options.heading_sigma_rad));
        let speed_mps = agent.speed_mps + self.noise(options.speed_sigma_mps);
        let has_speed = on_wheels && options.speeds;
        let flag = |has: bool, flag: u32| if has { flag } else { 0 };
        Detection {
            id: if options.identities { agent.id } else { 0 },
            x_m: agent.position_m[0] + self.noise(sigma_m),
            y_m: agent.position_m[1] + self.noise(sigma_m),
            heading_rad: if on_wheels { heading_rad } else { 0.0 },
            // A flipped heading changes the sign of the speed along it.
            speed_mps: if !has_speed {
                0.0
            } else if flipped {
                -speed_mps
            } else {
                speed_mps
            },
            length_m: self.size_m(agent.length_m, options),
            width_m: self.size_m(agent.width_m, options),
            score: (0.85 + self.noise(0.08)).clamp(0.3, 1.0),
            sigma_m,
            agent_type: agent.agent_type as u32,
            flags: flag(options.identities, HAS_ID)
                | flag(on_wheels, HAS_HEADING)
                | flag(has_speed, HAS_SPEED)
                | HAS_SIZE,
            ..Detection::default()
        }
    }

    fn size_m(&mut self, true_m: f32, options: &SceneOptions) -> f32 {
        true_m * (1.0 + self.noise(options.size_sigma_share)).max(0.1)
    }

    fn clutter_count(&mut self, options: &SceneOptions) -> usize {
        if options.clutter_mean == 0.0 {
            return 0;
        }
        let poisson = Poisson::new(options.clutter_mean).expect("the mean is positive and finite");
        let len: f32 = poisson.sample(&mut self.rng);
        len as usize
    }

    /// A false detection: at a random position, of a random type, with a low score and an id that no agent
    /// has.
    fn clutter(&mut self, options: &SceneOptions) -> Detection {
        let within = CLUTTER_WITHIN_M;
        let agent_type = AGENT_TYPES[self.rng.random_range(0..AGENT_TYPES.len())];
        let (length_m, width_m) = match agent_type {
            AgentType::Vehicle => (4.4, 1.8),
            AgentType::Cyclist => (1.8, 0.6),
            AgentType::Pedestrian => (0.5, 0.5),
        };
        let ghost = Agent {
            id: self.rng.random_range(u64::MAX / 2..u64::MAX),
            agent_type,
            position_m: [self.rng.random_range(-within..within), self.rng.random_range(-within..within)],
            heading_rad: self.rng.random_range(-std::f32::consts::PI..std::f32::consts::PI),
            speed_mps: 0.0,
            length_m,
            width_m,
        };
        let score = (0.45 + self.noise(0.12)).clamp(0.1, 0.9);
        Detection { score, ..self.detection(&ghost, options) }
    }
}

impl Shadow {
    fn occludes(&self, agent: &Agent, options: &SceneOptions) -> bool {
        let (bearing_rad, distance_m) = bearing(agent.position_m, options);
        agent.id != self.id
            && distance_m > self.distance_m
            && wrap_angle(bearing_rad - self.bearing_rad).abs() < self.half_width_rad
    }
}

fn bearing([x, y]: [f32; 2], options: &SceneOptions) -> (f32, f32) {
    let [sensor_x, sensor_y] = options.sensor.position_m;
    ((y - sensor_y).atan2(x - sensor_x), (x - sensor_x).hypot(y - sensor_y))
}

fn shadow(vehicle: &Agent, options: &SceneOptions) -> Shadow {
    let (bearing_rad, distance_m) = bearing(vehicle.position_m, options);
    let (sin, cos) = vehicle.heading_rad.sin_cos();
    let (half_length_m, half_width_m) = (vehicle.length_m / 2.0, vehicle.width_m / 2.0);
    let [x, y] = vehicle.position_m;
    let corner = |along_m: f32, aside_m: f32| {
        let position = [x + cos * along_m - sin * aside_m, y + sin * along_m + cos * aside_m];
        wrap_angle(bearing(position, options).0 - bearing_rad).abs()
    };
    let half_width_rad = [1.0, -1.0]
        .into_iter()
        .flat_map(|a| [1.0, -1.0].map(|b| corner(a * half_length_m, b * half_width_m)))
        .fold(0.0, f32::max);
    Shadow { id: vehicle.id, bearing_rad, half_width_rad, distance_m }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CLEAN: SceneOptions = SceneOptions {
        agents: 2,
        vehicle_share: 0.5,
        cyclist_share: 0.0,
        seed: 3,
        identities: true,
        speeds: true,
        position_sigma_m: [0.0; 3],
        heading_sigma_rad: 0.0,
        speed_sigma_mps: 0.0,
        size_sigma_share: 0.0,
        miss_probability: 0.0,
        clutter_mean: 0.0,
        yaw_flip_probability: 0.0,
        occlusion: true,
        sensor: crate::Ego { position_m: [0.0; 2], heading_rad: 0.0, is_sensor: true },
    };

    fn agent(id: u64, agent_type: AgentType, position_m: [f32; 2]) -> Agent {
        Agent { id, agent_type, position_m, heading_rad: 0.5, speed_mps: 2.0, length_m: 4.0, width_m: 2.0 }
    }

    #[test]
    fn a_clean_sensor_reports_the_truth() {
        let agents = [agent(7, AgentType::Vehicle, [10.0, 0.0]), agent(3, AgentType::Pedestrian, [0.0, 5.0])];
        let detections = Sensor::new(1).detect(&agents, &CLEAN);
        assert_eq!(detections.len(), 2);
        let [vehicle, pedestrian] = [detections[0], detections[1]];
        assert_eq!((vehicle.id, vehicle.x_m, vehicle.heading_rad, vehicle.speed_mps), (7, 10.0, 0.5, 2.0));
        assert_eq!((pedestrian.id, pedestrian.y_m), (3, 5.0));
        assert!(!pedestrian.has(detection_flags::HAS_HEADING) && !pedestrian.has(detection_flags::HAS_SPEED));
    }

    #[test]
    fn agents_behind_a_vehicle_are_occluded() {
        let agents = [
            agent(1, AgentType::Vehicle, [10.0, 0.0]),
            agent(2, AgentType::Pedestrian, [14.0, 0.5]),
            agent(3, AgentType::Pedestrian, [6.0, 0.0]),
            agent(4, AgentType::Pedestrian, [14.0, 6.0]),
        ];
        let ids = |options: &SceneOptions| -> Vec<u64> {
            Sensor::new(1).detect(&agents, options).iter().map(|d| d.id).collect()
        };
        assert_eq!(ids(&CLEAN), [1, 3, 4]);
        assert_eq!(ids(&SceneOptions { occlusion: false, ..CLEAN }), [1, 2, 3, 4]);
    }

    #[test]
    fn noise_misses_flips_and_clutter_have_the_stated_rates() {
        let options = SceneOptions {
            position_sigma_m: [0.2, 0.1, 0.1],
            miss_probability: 0.1,
            clutter_mean: 1.5,
            yaw_flip_probability: 0.3,
            ..CLEAN
        };
        let agents = [agent(1, AgentType::Vehicle, [10.0, 0.0])];
        let mut sensor = Sensor::new(5);
        let (mut seen, mut flips, mut clutter, mut squares) = (0, 0, 0, 0.0);
        let frames = 20_000;
        for _ in 0..frames {
            for detection in sensor.detect(&agents, &options) {
                if detection.id == 1 {
                    seen += 1;
                    flips += u32::from(wrap_angle(detection.heading_rad - 0.5).abs() > 1.0);
                    squares += f64::from((detection.x_m - 10.0).powi(2));
                } else {
                    clutter += 1;
                }
            }
        }
        let per = |count: u32, of: u32| f64::from(count) / f64::from(of);
        assert!((per(seen, frames) - 0.9).abs() < 0.01, "{seen}");
        assert!((per(flips, seen) - 0.3).abs() < 0.015, "{flips}");
        assert!((per(clutter, frames) - 1.5).abs() < 0.05, "{clutter}");
        assert!(((squares / f64::from(seen)).sqrt() - 0.2).abs() < 0.005, "{squares}");
    }

    #[test]
    fn detections_have_no_identity_unless_asked_for() {
        let agents = [agent(9, AgentType::Vehicle, [10.0, 0.0])];
        let options = SceneOptions { identities: false, clutter_mean: 3.0, ..CLEAN };
        let detections = Sensor::new(1).detect(&agents, &options);
        assert!(detections.iter().all(|d| d.id == 0 && !d.has(detection_flags::HAS_ID)));
    }
}
