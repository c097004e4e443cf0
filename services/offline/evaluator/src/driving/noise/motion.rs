//! Generated agents whose true motion is a formula.

use std::f64::consts::{FRAC_PI_2, TAU};

use data::{Frame, Recording};
use filters::wrapped;
use scene::AgentType;
use wire::{Detection, detection_flags};

/// Number of agents in a scene. Each has its own direction.
pub(crate) const AGENTS: u64 = 12;
/// Distance between the starts of two agents. None comes near another one.
const APART_M: f64 = 250.0;
/// Highest rate of frames. Faster sensors add measurements to a frame, as in a run.
const FRAMES_MAX_HZ: u32 = 10;
/// Time at which the first agent begins its manoeuvre. The others follow within a frame.
const BEGINS_S: f64 = 5.0;
/// Duration of the turn of 90 degrees.
const TURN_S: f64 = 3.0;
/// Acceleration of the braking and of the start, m/s², and their durations.
const BRAKING: (f64, f64) = (-3.0, 1.0);
const STARTING: (f64, f64) = (2.0, 1.5);

/// What the agents of a scene do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Motion {
    /// Straight on at constant speed.
    Straight,
    /// A turn of 90 degrees within 3 s at constant speed.
    Turn,
    /// 3 m/s slower within 1 s.
    Braking,
    /// 3 m/s faster within 1.5 s.
    Starting,
}

/// A scene of equal agents.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Scene {
    pub(crate) agent_type: AgentType,
    pub(crate) motion: Motion,
    /// Speed before the manoeuvre.
    pub(crate) speed_mps: f64,
    /// Rate of the measurements.
    pub(crate) rate_hz: u32,
}

/// True position, heading and speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Moving {
    pub(crate) position_m: [f64; 2],
    pub(crate) heading_rad: f64,
    pub(crate) speed_mps: f64,
}

impl Motion {
    /// The acceleration of a manoeuvre along the path, m/s², and its duration, s.
    const fn acceleration(self) -> (f64, f64) {
        match self {
            Self::Braking => BRAKING,
            Self::Starting => STARTING,
            Self::Straight | Self::Turn => (0.0, 0.0),
        }
    }
}

impl Scene {
    /// The true motion of an agent.
    pub(crate) fn state(&self, agent: u64, time_s: f64) -> Moving {
        let v = self.speed_mps;
        let course_rad = TAU * agent as f64 / AGENTS as f64 + 0.3;
        let since_s = time_s - begins_s(agent);
        // Along and across the first course, turned angle, and speed.
        let (along_m, across_m, turned_rad, speed_mps) = match self.motion {
            Motion::Straight => (v * time_s, 0.0, 0.0, v),
            Motion::Turn => {
                let rate = FRAC_PI_2 / TURN_S;
                let turned = (rate * since_s).clamp(0.0, FRAC_PI_2);
                let straight_m = v * time_s.min(begins_s(agent));
                let after_m = v * (since_s - TURN_S).max(0.0);
                let radius_m = v / rate;
                (straight_m + radius_m * turned.sin(), radius_m * (1.0 - turned.cos()) + after_m, turned, v)
            }
            Motion::Braking | Motion::Starting => {
                let (rate, duration_s) = self.motion.acceleration();
                let changing_s = since_s.clamp(0.0, duration_s);
                let rest_s = (since_s - duration_s).max(0.0);
                let gained_m = rate * changing_s * (0.5 * changing_s + rest_s);
                (v * time_s + gained_m, 0.0, 0.0, v + rate * changing_s)
            }
        };
        let (sin, cos) = course_rad.sin_cos();
        let start = [agent % 4, agent / 4].map(|cell| APART_M * cell as f64);
        Moving {
            position_m: [
                start[0] + along_m * cos - across_m * sin,
                start[1] + along_m * sin + across_m * cos,
            ],
            heading_rad: wrapped(course_rad + turned_rad),
            speed_mps,
        }
    }

    /// Time at which half of an agent's manoeuvre is done.
    pub(crate) fn half_s(&self, agent: u64) -> f64 {
        let duration_s = if self.motion == Motion::Turn { TURN_S } else { self.motion.acceleration().1 };
        begins_s(agent) + duration_s / 2.0
    }

    /// Whether a published course or speed is beyond the middle of the manoeuvre.
    pub(crate) fn is_past_half(&self, agent: u64, velocity_mps: [f32; 2]) -> bool {
        let [vx, vy] = velocity_mps.map(f64::from);
        match self.motion {
            Motion::Turn => {
                let before_rad = self.state(agent, 0.0).heading_rad;
                wrapped(vy.atan2(vx) - before_rad) > FRAC_PI_2 / 2.0
            }
            Motion::Braking | Motion::Starting => {
                let (rate, duration_s) = self.motion.acceleration();
                let beyond = vx.hypot(vy) - (self.speed_mps + rate * duration_s / 2.0);
                beyond * rate > 0.0
            }
            Motion::Straight => false,
        }
    }

    /// The exact recording of the first `seconds`, with identities, headings and speeds.
    ///
    /// A sensor of more than 10 Hz has several measurements of an agent in a frame, each with its own time.
    pub(crate) fn recording(&self, name: &str, seconds: f64) -> Recording {
        let per_frame = self.rate_hz.div_ceil(FRAMES_MAX_HZ);
        let frame_s = f64::from(per_frame) / f64::from(self.rate_hz);
        let interval_ns = (frame_s * 1e9).round() as i64;
        let frame = |number: i64| {
            let mut detections = Vec::new();
            for agent in 1..=AGENTS {
                for earlier in (0..per_frame).rev() {
                    let offset_ns = -(i64::from(earlier) * interval_ns / i64::from(per_frame));
                    let time_s = (number * interval_ns + offset_ns) as f64 * 1e-9;
                    detections.push(self.detection(agent, time_s, offset_ns));
                }
            }
            Frame {
                stamp_ns: number * interval_ns,
                observed_types: self.agent_type.bit(),
                detections,
                ..Frame::default()
            }
        };
        let frame_count = (seconds / frame_s).round() as i64 + 1;
        Recording {
            name: name.to_owned(),
            interval_ns: interval_ns.cast_unsigned(),
            has_identities: true,
            // The first frame has no measurement before it.
            frames: (1..=frame_count).map(frame).collect(),
            ..Recording::default()
        }
    }

    fn detection(&self, agent: u64, time_s: f64, offset_ns: i64) -> Detection {
        let Moving { position_m, heading_rad, speed_mps } = self.state(agent, time_s);
        let [length_m, width_m] = match self.agent_type {
            AgentType::Vehicle => [4.5, 1.8],
            AgentType::Cyclist => [1.8, 0.6],
            AgentType::Pedestrian => [0.5, 0.5],
        };
        Detection {
            id: agent,
            x_m: position_m[0] as f32,
            y_m: position_m[1] as f32,
            heading_rad: heading_rad as f32,
            speed_mps: speed_mps as f32,
            length_m,
            width_m,
            score: 1.0,
            agent_type: self.agent_type as u32,
            flags: detection_flags::HAS_ID
                | detection_flags::HAS_HEADING
                | detection_flags::HAS_SPEED
                | detection_flags::HAS_SIZE,
            offset_ns,
            ..Detection::default()
        }
    }
}

/// Time at which an agent begins its manoeuvre. The agents differ by parts of a frame, so that delays are
/// not whole frames.
fn begins_s(agent: u64) -> f64 {
    BEGINS_S + 0.1 * agent as f64 / AGENTS as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOTIONS: [Motion; 4] = [Motion::Straight, Motion::Turn, Motion::Braking, Motion::Starting];

    fn scene(motion: Motion) -> Scene {
        let speed_mps = if motion == Motion::Starting { 0.0 } else { 8.0 };
        Scene { agent_type: AgentType::Vehicle, motion, speed_mps, rate_hz: 10 }
    }

    #[test]
    fn speed_and_heading_are_the_derivative_of_the_position() {
        for motion in MOTIONS {
            for agent in [1, 6, AGENTS] {
                for tenth in 1..150 {
                    let (time_s, step_s) = (f64::from(tenth) * 0.1 + 0.003, 1e-4);
                    let [before, now, after] =
                        [-step_s, 0.0, step_s].map(|dt_s| scene(motion).state(agent, time_s + dt_s));
                    for axis in 0..2 {
                        let rate = (after.position_m[axis] - before.position_m[axis]) / (2.0 * step_s);
                        let direction = [now.heading_rad.cos(), now.heading_rad.sin()][axis];
                        let expected = now.speed_mps * direction;
                        assert!((rate - expected).abs() < 2e-3, "{motion:?} {agent} {time_s}: {rate}");
                    }
                }
            }
        }
    }

    #[test]
    fn the_manoeuvre_is_half_done_at_its_middle() {
        for motion in [Motion::Turn, Motion::Braking, Motion::Starting] {
            let scene = scene(motion);
            for agent in 1..=AGENTS {
                let is_past = |time_s: f64| {
                    let Moving { heading_rad, speed_mps, .. } = scene.state(agent, time_s);
                    let velocity = [heading_rad.cos(), heading_rad.sin()].map(|of| (of * speed_mps) as f32);
                    scene.is_past_half(agent, velocity)
                };
                let half_s = scene.half_s(agent);
                assert!(!is_past(half_s - 0.01) && is_past(half_s + 0.01) && is_past(half_s + 5.0));
            }
        }
    }

    #[test]
    fn a_fast_sensor_adds_measurements_to_frames_of_10_hz() {
        for (rate_hz, per_frame, frame_count) in [(2, 1, 25), (5, 1, 61), (10, 1, 121), (20, 2, 121)] {
            let recording = Scene { rate_hz, ..scene(Motion::Straight) }.recording("a", 12.0);
            assert_eq!(recording.frames.len(), frame_count, "{rate_hz} Hz");
            assert!(recording.frames.iter().all(|frame| frame.detections.len() as u64 == per_frame * AGENTS));
            let tracks = data::tracks(&recording);
            let (first, last) = (tracks[0].states[0].0, tracks[0].states.last().unwrap().0);
            let measured = tracks[0].states.len() as f64 - 1.0;
            let rate = measured / ((last - first) as f64 * 1e-9);
            assert!((rate - f64::from(rate_hz)).abs() < 1e-6, "{rate}");
        }
    }
}
