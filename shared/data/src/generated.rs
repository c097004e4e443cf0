//! A generated scene: road users and pedestrians at an unsignalised intersection, and a sensor that watches them.
//!
//! [`GeneratedScene`] moves everybody on by one frame at a time, without end and with bounded memory; the same options
//! give the same frames to the bit. Vehicles and cyclists follow smooth routes with the intelligent-driver model, take
//! turns by gap acceptance and stop for pedestrians; pedestrians walk by the social-force model from pavement to
//! pavement. Nobody jumps, and everybody leaves at the end of their way while others enter.
//!
//! The *sensor* sees them with noise, misses some, does not see who is hidden behind a vehicle, and reports clutter: it
//! draws from a random stream of its own, so that its options never change the truth.

mod layout;
mod options;
mod path;
mod right_of_way;
mod road_user;
mod sensor;
mod traffic;
mod walker;
mod yielding;

pub use options::{OptionError, SceneOptions};

use wire::{AGENT_TYPES, AgentType, Truth};

use crate::{Frame, Recording};
use sensor::Sensor;
use traffic::{Population, Traffic};

/// Time between two frames of a generated scene.
pub const FRAME_INTERVAL_NS: u64 = wire::TICK_NS;

/// Steps of the simulation in a frame.
const STEPS: u16 = 2;
/// Frames that pass unseen before the first, so that it shows a scene in full swing.
const WARM_UP_FRAMES: u16 = 625;

type Point = [f32; 2];

/// An agent as it really is.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Agent {
    id: u64,
    agent_type: AgentType,
    position_m: Point,
    heading_rad: f32,
    speed_mps: f32,
    length_m: f32,
    width_m: f32,
}

/// An endless scene; it moves on by one frame at a time.
#[derive(Clone, Debug)]
pub struct GeneratedScene {
    options: SceneOptions,
    traffic: Traffic,
    sensor: Sensor,
    agents: Vec<Agent>,
    frames_len: u64,
}

impl GeneratedScene {
    /// A scene in full swing, before its first frame.
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

    /// The next frame: what the sensor sees, and where everybody really is. Stamps start at 0.
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
        self.agents.extend(traffic.walkers.iter().map(|walker| Agent {
            id: walker.id,
            agent_type: AgentType::Pedestrian,
            position_m: walker.position_m,
            heading_rad: walker.velocity_mps[1].atan2(walker.velocity_mps[0]),
            speed_mps: walker.speed_mps(),
            length_m: 2.0 * walker::BODY_M,
            width_m: 2.0 * walker::BODY_M,
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
