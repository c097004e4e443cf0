//! Keys of the memory, the similarity of two keys, and the buckets that group nearby keys.

use std::f32::consts::TAU;

use kinematics::MotionKind;
use scene::{AgentFrame, MOVING_MPS, State, turn, turn_rates};

/// Side of a bucket's cell, by kind of motion.
const CELL_M: [f32; 2] = [2.0, 5.0];
/// Sectors of heading by which buckets divide bicycles.
const DIRECTIONS: i32 = 8;
/// Width of a sector.
const SECTOR_RAD: f32 = TAU / DIRECTIONS as f32;
/// The sector of agents that move by displacements. Their buckets ignore the heading.
const ANY_DIRECTION: i32 = -1;

/// Support of the kernel, by kind of motion: half of the squared distance above which the similarity is 0. It
/// is smaller for displacements, which have many more agents.
const REACH: [f32; 2] = [7.0, 4.0];
/// Bicycles are not similar if their headings differ by more than this: 0.12 √(2 · 7), plus a margin.
const TURN_MAX_RAD: f32 = 0.46;
/// Width of a displacement key's position in the kernel of means. In the kernel of single neighbours it is
/// larger: a path some metres away can still be followed, although its residuals differ on average.
const MEAN_WIDTH_M: f32 = 2.5;
/// The same in the kernel of single neighbours: see [`MEAN_WIDTH_M`].
const NEIGHBOUR_WIDTH_M: f32 = 4.0;
/// Factor on all widths of a bicycle's key in the kernel of single neighbours.
const NEIGHBOUR_WIDER: f32 = 1.4;
/// Width of a displacement key's velocity.
const VELOCITY_WIDTH_MPS: f32 = 0.3;

/// Numbers of a key in a file; a bicycle's key uses all of them.
pub(crate) const COMPONENTS: usize = 6;

/// Identifies a bucket of nearby keys.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Bucket {
    pub(crate) kind: MotionKind,
    /// Cell and direction.
    cell: [i32; 3],
}

/// Values of the similarity kernel for two keys, from 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Similarity {
    /// Weight in the mean of residuals.
    pub(crate) in_mean: f32,
    /// Weight of a single neighbour: a wider kernel.
    pub(crate) as_neighbour: f32,
}

/// The key of a memory entry: position and motion of an agent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Key {
    /// Key of an agent that moves as a bicycle.
    Bicycle(BicycleKey),
    /// Key of an agent that moves by displacements.
    Displacement(DisplacementKey),
}

/// The key of an agent that moves as a bicycle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BicycleKey {
    /// Position in the world frame.
    pub position_m: [f32; 2],
    /// Heading.
    pub heading_rad: f32,
    /// Speed along the heading.
    pub speed_mps: f32,
    /// Mean change of the speed over the last step.
    pub acceleration_mps2: f32,
    /// Mean turn rate over the last step.
    pub turn_rate_radps: f32,
}

/// The key of an agent that moves by displacements, or stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DisplacementKey {
    /// Position in the world frame.
    pub position_m: [f32; 2],
    /// Velocity in the world frame.
    pub velocity_mps: [f32; 2],
}

impl Key {
    /// The key of an agent at the end of its history with steps of `dt_s`; `None` if the agent is absent
    /// then.
    ///
    /// A bicycle at rest has no key, because the paths of others do not show when it will start. An agent
    /// that moves by displacements has no key if it was absent at the previous step, because its velocity is
    /// unknown.
    #[must_use]
    pub fn new(kind: MotionKind, history: &[Option<State>], dt_s: f32) -> Option<Self> {
        match kind {
            MotionKind::Bicycle => BicycleKey::new(history, dt_s).map(Self::Bicycle),
            MotionKind::Displacement => {
                let [.., Some(_), Some(State { position_m, velocity_mps, .. })] = *history else {
                    return None;
                };
                Some(Self::Displacement(DisplacementKey { position_m, velocity_mps }))
            }
        }
    }

    /// The key's numbers in the order of its fields; a displacement's are padded with zeros.
    pub(crate) const fn components(&self) -> [f32; COMPONENTS] {
        match *self {
            Self::Bicycle(BicycleKey {
                position_m: [x, y],
                heading_rad,
                speed_mps,
                acceleration_mps2,
                turn_rate_radps,
            }) => [x, y, heading_rad, speed_mps, acceleration_mps2, turn_rate_radps],
            Self::Displacement(DisplacementKey { position_m: [x, y], velocity_mps: [vx, vy] }) => {
                [x, y, vx, vy, 0.0, 0.0]
            }
        }
    }

    /// The inverse of [`Key::components`].
    pub(crate) const fn of_components(kind: MotionKind, components: &[f32; COMPONENTS]) -> Self {
        let &[x, y, third, fourth, acceleration_mps2, turn_rate_radps] = components;
        match kind {
            MotionKind::Bicycle => Self::Bicycle(BicycleKey {
                position_m: [x, y],
                heading_rad: third,
                speed_mps: fourth,
                acceleration_mps2,
                turn_rate_radps,
            }),
            MotionKind::Displacement => {
                Self::Displacement(DisplacementKey { position_m: [x, y], velocity_mps: [third, fourth] })
            }
        }
    }

    pub(crate) const fn position_m(&self) -> [f32; 2] {
        match self {
            Self::Bicycle(key) => key.position_m,
            Self::Displacement(key) => key.position_m,
        }
    }

    /// The agent's kind of motion.
    pub const fn kind(&self) -> MotionKind {
        match self {
            Self::Bicycle(_) => MotionKind::Bicycle,
            Self::Displacement(_) => MotionKind::Displacement,
        }
    }

    /// The similarity of another key; `None` if its kind differs or it is outside the kernel's support.
    ///
    /// ```text
    /// k = exp(−d²/2)
    /// d² = (Δy/0.8)² + (Δx/1.0)² + (Δψ/0.12)² + (Δv/1.5)² + (Δa/0.8)² + (Δω/0.1)²      bicycle, x along
    ///                            the heading, y across it; all widths × 1.4 as a neighbour
    /// d² = |Δp|²/σ² + |Δv|²/0.3²      displacement, σ = 2.5 m in means, 4 m as a neighbour
    /// ```
    pub(crate) fn similarity(&self, other: &Self) -> Option<Similarity> {
        let reach = REACH[self.kind() as usize];
        match (self, other) {
            (Self::Bicycle(own), Self::Bicycle(other)) => {
                let distance = own.distance(other, reach).filter(|distance| *distance <= reach)?;
                let as_neighbour = (-distance / (NEIGHBOUR_WIDER * NEIGHBOUR_WIDER)).exp();
                Some(Similarity { in_mean: (-distance).exp(), as_neighbour })
            }
            (Self::Displacement(own), Self::Displacement(other)) => own.similarity(other, reach),
            _ => None,
        }
    }

    /// The bucket of keys like this one.
    pub fn bucket(&self) -> Bucket {
        let [x, y] = self.position_m().map(|value| (value / CELL_M[self.kind() as usize]).floor() as i32);
        match self {
            Self::Displacement(_) => Bucket { kind: MotionKind::Displacement, cell: [x, y, ANY_DIRECTION] },
            Self::Bicycle(key) => {
                let direction = key.sectors() as i32 % DIRECTIONS;
                Bucket { kind: MotionKind::Bicycle, cell: [x, y, direction] }
            }
        }
    }

    /// The buckets that may contain keys near this one.
    pub(crate) fn buckets_around(&self) -> impl Iterator<Item = Bucket> + use<> {
        let Bucket { kind, cell: [x, y, direction] } = self.bucket();
        let turns = match self {
            Self::Displacement(_) => 0..=0,
            Self::Bicycle(key) => {
                let into = key.sectors().fract();
                let [before, behind] = [into, 1.0 - into].map(|sectors| sectors * SECTOR_RAD <= TURN_MAX_RAD);
                -i32::from(before)..=i32::from(behind)
            }
        };
        turns.flat_map(move |turn| {
            let direction = if direction == ANY_DIRECTION {
                ANY_DIRECTION
            } else {
                (direction + turn).rem_euclid(DIRECTIONS)
            };
            (0..9).map(move |cell| Bucket { kind, cell: [x + cell % 3 - 1, y + cell / 3 - 1, direction] })
        })
    }
}

impl BicycleKey {
    fn new(history: &[Option<State>], dt_s: f32) -> Option<Self> {
        let along = |state: State| {
            AgentFrame::new(state.position_m, state.heading_rad).rotate_into(state.velocity_mps)[0]
        };
        let now = (*history.last()?)?;
        let speed_mps = along(now);
        if speed_mps.abs() < MOVING_MPS {
            return None;
        }
        let before = history.len().checked_sub(2).and_then(|step| history[step]);
        Some(Self {
            position_m: now.position_m,
            heading_rad: now.heading_rad,
            speed_mps,
            acceleration_mps2: before.map_or(0.0, |before| (speed_mps - along(before)) / dt_s),
            turn_rate_radps: turn_rates(history, dt_s)[0],
        })
    }

    /// The heading as a number of sectors, from 0 to [`DIRECTIONS`].
    fn sectors(&self) -> f32 {
        self.heading_rad.rem_euclid(TAU) / TAU * DIRECTIONS as f32
    }

    /// Half of the squared distance d²; `None` if it certainly exceeds `reach`.
    fn distance(&self, other: &Self, reach: f32) -> Option<f32> {
        let offset = [0, 1].map(|axis| other.position_m[axis] - self.position_m[axis]);
        let of_motion = half_square([
            turn(self.heading_rad, other.heading_rad) / 0.12,
            (other.speed_mps - self.speed_mps) / 1.5,
            (other.acceleration_mps2 - self.acceleration_mps2) / 0.8,
            (other.turn_rate_radps - self.turn_rate_radps) / 0.1,
        ]);
        // Most keys are too far in any direction, and sine and cosine of the frame cost more than all other
        // operations.
        if of_motion + half_square(offset) > reach {
            return None;
        }
        let frame = AgentFrame::new(self.position_m, self.heading_rad);
        let [along, across] = frame.rotate_into(offset);
        Some(of_motion + half_square([across / 0.8, along]))
    }
}

impl DisplacementKey {
    fn similarity(&self, other: &Self, reach: f32) -> Option<Similarity> {
        let apart = |axis: usize| other.position_m[axis] - self.position_m[axis];
        let faster = |axis: usize| (other.velocity_mps[axis] - self.velocity_mps[axis]) / VELOCITY_WIDTH_MPS;
        let (of_place, of_motion) = (half_square([0, 1].map(apart)), half_square([0, 1].map(faster)));
        let kernel = |width_m: f32| {
            let distance = of_place / (width_m * width_m) + of_motion;
            if distance <= reach { (-distance).exp() } else { 0.0 }
        };
        let as_neighbour = kernel(NEIGHBOUR_WIDTH_M);
        (as_neighbour > 0.0).then(|| Similarity { in_mean: kernel(MEAN_WIDTH_M), as_neighbour })
    }
}

fn half_square<const N: usize>(parts: [f32; N]) -> f32 {
    0.5 * parts.iter().map(|part| part * part).sum::<f32>()
}
