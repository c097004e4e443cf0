//! A generated scene: road users and pedestrians at an unsignalised intersection, and a sensor that observes
//! them.
//!
//! [`GeneratedScene`] advances by one frame at a time, without end and with bounded memory. The same options
//! give the same frames to the bit. Vehicles and cyclists drive on smooth routes by the intelligent-driver
//! model, take turns by gap acceptance, and stop for pedestrians. Pedestrians walk by the social-force model
//! from pavement to pavement. Motion is continuous. An agent that reaches the end of its route leaves, and
//! another agent enters.
//!
//! The *sensor* adds noise, misses agents, does not report agents that a vehicle occludes, and reports
//! clutter. It has its own random stream, so its options never change the truth.

mod layout;
mod options;
mod path;
mod pedestrian;
mod right_of_way;
mod road_user;
mod sensor;
mod traffic;
mod yielding;

pub use options::{OptionError, SceneOptions};

use wire::{AGENT_TYPES, AgentType, Truth};

use crate::{Frame, Recording};
use sensor::{Agent, Sensor};
use traffic::{Population, Traffic};

/// Time between two frames of a generated scene.
const FRAME_INTERVAL_NS: u64 = wire::TICK_NS;

/// Simulation steps per frame.
const STEPS: u16 = 2;
/// Frames that are simulated before the first returned one, so that traffic is at its steady level.
const WARM_UP_FRAMES: u16 = 625;

/// An endless scene that advances by one frame at a time.
#[derive(Clone, Debug)]
pub struct GeneratedScene {
    options: SceneOptions,
    traffic: Traffic,
    sensor: Sensor,
    agents: Vec<Agent>,
    frames_len: u64,
}

impl GeneratedScene {
    /// A scene with traffic at its steady level, before its first frame.
    ///
    /// # Errors
    /// [`OptionError`] names the option that is out of its range.
    pub fn new(options: SceneOptions) -> Result<Self, OptionError> {
        options.check()?;
        let population = Population::split(options.agents, options.vehicle_share, options.cyclist_share);
        let mut scene = Self {
            traffic: Traffic::new(population, options.seed),
            sensor: Sensor::new(options.seed),
            agents: Vec::with_capacity(options.agents),
            frames_len: 0,
            options,
        };
        for _ in 0..WARM_UP_FRAMES {
            scene.advance();
        }
        Ok(scene)
    }

    /// The next frame: the sensor's detections, and the truth. Stamps start at 0.
    pub fn next_frame(&mut self) -> Frame {
        self.advance();
        let mut truth: Vec<Truth> = self.agents.iter().map(Agent::truth).collect();
        truth.sort_by_key(|truth| (truth.agent_type, truth.id));
        let stamp_ns = self.frames_len as i64 * FRAME_INTERVAL_NS as i64;
        self.frames_len += 1;
        Frame {
            stamp_ns,
            observed_types: AGENT_TYPES.iter().fold(0, |bits, agent_type| bits | agent_type.bit()),
            ego: self.options.sensor,
            detections: self.sensor.detect(&self.agents, &self.options),
            truth,
            ..Frame::default()
        }
    }

    /// The next `ticks` frames as a recording.
    pub fn recording(mut self, ticks: usize) -> Recording {
        Recording {
            name: format!(
                "generated intersection, {} agents, seed {}",
                self.options.agents, self.options.seed
            ),
            interval_ns: FRAME_INTERVAL_NS,
            has_identities: self.options.identities,
            frames: (0..ticks).map(|_| self.next_frame()).collect(),
            ..Recording::default()
        }
    }

    fn advance(&mut self) {
        let dt_s = FRAME_INTERVAL_NS as f32 * 1e-9 / f32::from(STEPS);
        for _ in 0..STEPS {
            self.traffic.step(dt_s);
        }
        self.agents.clear();
        let traffic = &self.traffic;
        self.agents.extend(traffic.users.iter().map(|user| {
            let pose = traffic.pose(user);
            Agent {
                id: user.id,
                agent_type: user.agent_type(),
                position_m: pose.position_m,
                heading_rad: pose.heading_rad,
                speed_mps: user.speed_mps,
                length_m: user.length_m,
                width_m: user.width_m,
            }
        }));
        self.agents.extend(traffic.pedestrians.iter().map(|pedestrian| Agent {
            id: pedestrian.id,
            agent_type: AgentType::Pedestrian,
            position_m: pedestrian.position_m,
            heading_rad: pedestrian.velocity_mps[1].atan2(pedestrian.velocity_mps[0]),
            speed_mps: pedestrian.speed_mps(),
            length_m: 2.0 * pedestrian::BODY_M,
            width_m: 2.0 * pedestrian::BODY_M,
        }));
    }
}

impl Agent {
    fn truth(&self) -> Truth {
        Truth {
            id: self.id,
            agent_type: self.agent_type as u32,
            x_m: self.position_m[0],
            y_m: self.position_m[1],
            ..Truth::default()
        }
    }
}

#[cfg(test)]
mod tests;
