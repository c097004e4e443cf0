use crate::motion::wrapped;
use crate::{AgentFrame, MOVING_MPS, State, turn_rates};

/// Side of a cell, for those who drive and for those who walk.
const CELL_M: [f32; 2] = [2.0, 5.0];
/// Directions of driving that are told apart.
const DIRECTIONS: i32 = 8;
/// Stands for a direction where it is not told apart.
const ANY_DIRECTION: i32 = -1;

/// Half of the squared distance between two moments beyond which one tells nothing of the other, driving and walking: of walkers
/// there are many more.
const REACH: [f32; 2] = [7.0, 4.0];
/// Widths of a walker's place: who came by farther off says little of what all have in common there, but still where one can go.
const IN_COMMON_M: f32 = 2.5;
/// See [`IN_COMMON_M`].
const PATH_M: f32 = 4.0;
/// For the path that a driver took, all widths are so much larger.
const PATH_WIDER: f32 = 1.4;
/// Width of a walker's velocity.
const VELOCITY_MPS: f32 = 0.3;

/// Numbers of a moment in a file: those of who drives.
pub(super) const COMPONENTS: usize = 6;

/// How an agent goes, and with it what moments of it are compared by, and how a path departs from its forecast.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Gait {
    /// Along a heading: speed and curvature depart.
    Driving,
    /// Any way: steps depart.
    Walking,
}

/// Names a bucket: gait, cell and direction.
pub(super) type Key = (Gait, [i32; 3]);

/// How much alike two moments are, from 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Alike {
    /// For what those who were there had in common.
    pub(super) in_common: f32,
    /// For the path that one of them took.
    pub(super) path: f32,
}

/// Where an agent is, and how it moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Moment {
    /// Of one that goes along its heading.
    Driving(Driving),
    /// Of one that steps wherever it likes.
    Walking(Walking),
}

/// A moment of an agent that drives.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Driving {
    /// Position in the world frame.
    pub position_m: [f32; 2],
    /// Heading.
    pub heading_rad: f32,
    /// Speed along the heading.
    pub speed_mps: f32,
    /// Its mean change over the last step.
    pub acceleration_mps2: f32,
    /// Mean turn rate over the last step.
    pub turn_rate_radps: f32,
}

/// A moment of an agent that walks, or stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Walking {
    /// Position in the world frame.
    pub position_m: [f32; 2],
    /// Velocity in the world frame.
    pub velocity_mps: [f32; 2],
}

impl Moment {
    /// The moment at the end of a driver's history with steps of `dt_s`; none of an agent that is absent then, or stands: when it
    /// will go on, others do not tell.
    #[must_use]
    pub fn driving(history: &[Option<State>], dt_s: f32) -> Option<Self> {
        let along = |state: State| {
            AgentFrame::new(state.position_m, state.heading_rad).rotate_into(state.velocity_mps)[0]
        };
        let now = (*history.last()?)?;
        let speed_mps = along(now);
        if speed_mps.abs() < MOVING_MPS {
            return None;
        }
        let before = history.len().checked_sub(2).and_then(|step| history[step]);
        Some(Self::Driving(Driving {
            position_m: now.position_m,
            heading_rad: now.heading_rad,
            speed_mps,
            acceleration_mps2: before.map_or(0.0, |before| (speed_mps - along(before)) / dt_s),
            turn_rate_radps: turn_rates(history, dt_s)[0],
        }))
    }

    /// The moment at the end of a walker's history; none of an agent that is absent then or a step before: its velocity is not
    /// known.
    #[must_use]
    pub fn walking(history: &[Option<State>]) -> Option<Self> {
        let [.., Some(_), Some(State { position_m, velocity_mps, .. })] = *history else { return None };
        Some(Self::Walking(Walking { position_m, velocity_mps }))
    }

    /// The moment's numbers in the order of its fields; zeros follow those of who walks.
    pub(super) const fn components(&self) -> [f32; COMPONENTS] {
        match *self {
            Self::Driving(Driving {
                position_m: [x, y],
                heading_rad,
                speed_mps,
                acceleration_mps2,
                turn_rate_radps,
            }) => [x, y, heading_rad, speed_mps, acceleration_mps2, turn_rate_radps],
            Self::Walking(Walking { position_m: [x, y], velocity_mps: [vx, vy] }) => [x, y, vx, vy, 0.0, 0.0],
        }
    }

    /// The reverse of [`Moment::components`].
    pub(super) const fn of_components(gait: Gait, components: &[f32; COMPONENTS]) -> Self {
        let &[x, y, third, fourth, acceleration_mps2, turn_rate_radps] = components;
        match gait {
            Gait::Driving => Self::Driving(Driving {
                position_m: [x, y],
                heading_rad: third,
                speed_mps: fourth,
                acceleration_mps2,
                turn_rate_radps,
            }),
            Gait::Walking => Self::Walking(Walking { position_m: [x, y], velocity_mps: [third, fourth] }),
        }
    }

    pub(super) const fn position_m(&self) -> [f32; 2] {
        match self {
            Self::Driving(moment) => moment.position_m,
            Self::Walking(moment) => moment.position_m,
        }
    }

    /// How the agent goes.
    #[must_use]
    pub const fn gait(&self) -> Gait {
        match self {
            Self::Driving(_) => Gait::Driving,
            Self::Walking(_) => Gait::Walking,
        }
    }

    /// How much alike another moment is; none where it is of another gait, or so far that it tells nothing.
    ///
    /// ```text
    /// exp(−d²/2)
    /// d² = (Δy/0.8)² + (Δx/1.0)² + (Δψ/0.12)² + (Δv/1.5)² + (Δa/0.8)² + (Δω/0.1)²      driving, x along the heading, y across it;
    ///                            for a path all widths × 1.4
    /// d² = |Δp|²/σ² + |Δv|²/0.3²      walking, σ = 2.5 m for what is in common, 4 m for a path
    /// ```
    pub(super) fn alike(&self, other: &Self) -> Option<Alike> {
        let reach = REACH[self.gait() as usize];
        match (self, other) {
            (Self::Driving(own), Self::Driving(other)) => {
                let distance = own.distance(other, reach).filter(|distance| *distance <= reach)?;
                let path = (-distance / (PATH_WIDER * PATH_WIDER)).exp();
                Some(Alike { in_common: (-distance).exp(), path })
            }
            (Self::Walking(own), Self::Walking(other)) => own.alike(other, reach),
            _ => None,
        }
    }

    /// The key of the bucket that moments like this one lie in.
    pub(super) fn key(&self) -> Key {
        let [x, y] = self.position_m().map(|value| (value / CELL_M[self.gait() as usize]).floor() as i32);
        match self {
            Self::Walking(_) => (Gait::Walking, [x, y, ANY_DIRECTION]),
            Self::Driving(Driving { heading_rad, .. }) => {
                let turn = heading_rad.rem_euclid(std::f32::consts::TAU) / std::f32::consts::TAU;
                (Gait::Driving, [x, y, (turn * DIRECTIONS as f32) as i32 % DIRECTIONS])
            }
        }
    }

    /// The keys of the buckets in which moments near this one may lie.
    pub(super) fn keys_around(&self) -> impl Iterator<Item = Key> + use<> {
        let (gait, [x, y, direction]) = self.key();
        let turns = if direction == ANY_DIRECTION { 0..=0 } else { -1..=1 };
        turns.flat_map(move |turn| {
            let direction = if direction == ANY_DIRECTION {
                ANY_DIRECTION
            } else {
                (direction + turn).rem_euclid(DIRECTIONS)
            };
            (0..9).map(move |place| (gait, [x + place % 3 - 1, y + place / 3 - 1, direction]))
        })
    }
}

impl Driving {
    fn distance(&self, other: &Self, reach: f32) -> Option<f32> {
        let offset = [0, 1].map(|axis| other.position_m[axis] - self.position_m[axis]);
        let of_motion = half_square([
            wrapped(other.heading_rad - self.heading_rad) / 0.12,
            (other.speed_mps - self.speed_mps) / 1.5,
            (other.acceleration_mps2 - self.acceleration_mps2) / 0.8,
            (other.turn_rate_radps - self.turn_rate_radps) / 0.1,
        ]);
        // Most are too far whichever way they lie: the frame's sine and cosine cost more than all the rest.
        if of_motion + half_square(offset) > reach {
            return None;
        }
        let frame = AgentFrame::new(self.position_m, self.heading_rad);
        let [along, across] = frame.rotate_into(offset);
        Some(of_motion + half_square([across / 0.8, along]))
    }
}

impl Walking {
    fn alike(&self, other: &Self, reach: f32) -> Option<Alike> {
        let apart = |axis: usize| other.position_m[axis] - self.position_m[axis];
        let faster = |axis: usize| (other.velocity_mps[axis] - self.velocity_mps[axis]) / VELOCITY_MPS;
        let (of_place, of_motion) = (half_square([0, 1].map(apart)), half_square([0, 1].map(faster)));
        let weight = |width_m: f32| {
            let distance = of_place / (width_m * width_m) + of_motion;
            if distance <= reach { (-distance).exp() } else { 0.0 }
        };
        let path = weight(PATH_M);
        (path > 0.0).then(|| Alike { in_common: weight(IN_COMMON_M), path })
    }
}

fn half_square<const N: usize>(parts: [f32; N]) -> f32 {
    0.5 * parts.iter().map(|part| part * part).sum::<f32>()
}
