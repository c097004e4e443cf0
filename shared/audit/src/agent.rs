//! The sequence of one agent's detections.

use wire::{AgentType, Detection, detection_flags};

use crate::headings::Directed;
use crate::motion::Motion;
use crate::speeds::{Chord, usual_mps};
use crate::tally::Place;

/// Shortest duration of a chord.
const CHORD_NS: i64 = 1_000_000_000;
/// Longest time between two detections of a chord.
pub(crate) const GAP_MAX_NS: i64 = 3_000_000_000;
/// Shortest path in m and lowest speed in m/s that have a direction.
const DIRECTED: [f64; 2] = [1.0, 0.8];
/// Smallest cosine of the angle between two chords of a steady motion.
const STEADY_COS: f64 = 0.7;
/// Speeds up to this one count as 0. An upstream tracker may add noise to a speed that it does not know.
pub const NEAR_ZERO_MPS: f64 = 0.1;
/// Slower agents may be measured at the same place again.
const MOVING_MPS: f64 = 1.0;
/// Shorter steps may come from coarsely rounded numbers.
const STEP_MIN_M: f64 = 0.08;
/// Number of repeated detections that count before the agent moves again, and its least speed. A detector may hang to
/// the end.
const HELD: u64 = 4;
const HELD_MPS: f64 = 3.0;
/// Positions are on a coarse grid if x alone and y alone have each changed within this time.
const GRID_NS: i64 = 2_000_000_000;
/// Longest first step of an agent without an identity.
const FIRST_STEP_M: f64 = 4.0;
/// Measurement error that is allowed in addition to the agent's motion.
const SLACK_M: f64 = 0.5;
/// Longest step, and measurement error, of a path that is too fast for its type.
const FAST_STEP_S: f64 = 1.0;
const FAST_SLACK_M: f64 = 0.1;
/// Coordinates that mark a missing position.
const PLACEHOLDERS_M: [f32; 2] = [0.0, -1.0];

/// Highest speed of a type, equal to the tracker's limits.
pub(crate) const fn limit_mps(agent_type: AgentType) -> f64 {
    match agent_type {
        AgentType::Vehicle => 70.0,
        AgentType::Cyclist => 25.0,
        AgentType::Pedestrian => 12.0,
    }
}

/// An agent at one time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Spot {
    pub stamp_ns: i64,
    pub position_m: [f32; 2],
    pub heading: Option<f64>,
    pub speed_mps: Option<f64>,
    pub sigma_m: f64,
    pub place: Place,
}

impl Spot {
    pub fn new(stamp_ns: i64, detection: &Detection, place: Place) -> Self {
        let given = |flag, value: f32| detection.has(flag).then_some(f64::from(value));
        Self {
            stamp_ns,
            position_m: [detection.x_m, detection.y_m],
            heading: given(detection_flags::HAS_HEADING, detection.heading_rad),
            speed_mps: given(detection_flags::HAS_SPEED, detection.speed_mps),
            sigma_m: f64::from(detection.sigma_m),
            place,
        }
    }

    /// Whether the position is a placeholder for a missing one.
    pub fn is_placeholder(&self) -> bool {
        let [x_m, y_m] = self.position_m;
        PLACEHOLDERS_M.into_iter().any(|placeholder| x_m == placeholder && y_m == placeholder)
    }

    fn position_m(&self) -> [f64; 2] {
        self.position_m.map(f64::from)
    }

    pub fn way_m(&self, to: &Self) -> [f64; 2] {
        [0, 1].map(|axis| f64::from(to.position_m[axis]) - f64::from(self.position_m[axis]))
    }

    pub fn distance_m(&self, to: &Self) -> f64 {
        let [x_m, y_m] = self.way_m(to);
        x_m.hypot(y_m)
    }

    fn speed_mps(&self, to: &Self) -> f64 {
        self.distance_m(to) / ((to.stamp_ns - self.stamp_ns) as f64 * 1e-9)
    }

    /// Whether an agent can have come from this spot to `to`.
    fn reaches(&self, to: &Self, agent_type: AgentType) -> bool {
        let elapsed_s = (to.stamp_ns - self.stamp_ns) as f64 * 1e-9;
        self.distance_m(to) <= limit_mps(agent_type) * elapsed_s + SLACK_M + 3.0 * to.sigma_m
    }
}

/// Detections that repeat the previous one of a moving agent.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Repeated {
    pub first: Place,
    pub rows: u64,
    /// Whether the agent's positions are on a coarse grid; `None` if it moves along an axis.
    pub on_grid: Option<bool>,
}

/// The effect of a detection on its agent.
#[derive(Debug, Default)]
pub(crate) struct Step {
    /// Time since the agent's previous detection.
    pub interval_ns: Option<i64>,
    /// Earlier detections that repeated their predecessor.
    pub repeated: Option<Repeated>,
    /// An earlier detection that was out of reach.
    pub outlier: Option<Place>,
    /// A placeholder.
    pub placeholder: Option<Place>,
    /// The first detection after the identity has jumped.
    pub jump: Option<Place>,
    /// A completed chord.
    pub chord: Option<Chord>,
    /// The same chord with the headings at its ends.
    pub directed: Option<Directed>,
    /// The same chord if it has a direction, with the numbers that all its rows have.
    pub constant: Option<Constant>,
    /// The speed of a path that is too fast for the agent's type. The detection belongs to no agent then.
    pub too_fast_mps: Option<f64>,
}

/// A chord with a direction, and the speed and the heading if they are equal in all its rows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Constant {
    pub speed: Option<f64>,
    pub heading: Option<f64>,
    pub way: Way,
    /// Direction of the agent's front.
    pub direction_rad: f64,
    /// Whether the motion continues the one of the previous chord.
    pub steady: bool,
}

/// The motion of a chord.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Way {
    /// Number of the agent, from 1 on.
    pub agent: u32,
    pub from_m: [f32; 2],
    pub from_ns: i64,
    pub velocity_mps: [f64; 2],
    pub elapsed_s: f64,
    pub rows: u64,
    pub place: Place,
}

impl Way {
    pub fn speed_mps(&self) -> f64 {
        self.velocity_mps[0].hypot(self.velocity_mps[1])
    }
}

/// An agent, followed by its identity or from place to place.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Agent {
    /// Number of the agent, from 1 on.
    number: u32,
    pub agent_type: AgentType,
    /// Time of its newest detection.
    pub seen_ns: i64,
    /// The newest detection within reach.
    pub last: Spot,
    /// Velocity of the step to `last`; `None` before the second detection.
    velocity_mps: Option<[f64; 2]>,
    motion: Motion,
    /// A detection that is out of reach.
    pending: Option<Spot>,
    /// Place of the first detection that repeats the newest one, and the number of such detections.
    held: Option<(Place, u64)>,
    /// Times at which x alone and y alone last changed, if they did.
    alone_ns: [Option<i64>; 2],
    first: Spot,
    /// Distance according to the reported speeds since `first`; `None` if a speed was missing.
    reported_m: Option<f64>,
    /// Whether all speeds and all headings since `first` are equal, if they are given.
    is_constant: [bool; 2],
    /// Velocity of the previous chord.
    chord_mps: Option<[f64; 2]>,
    /// Number of detections since `first`.
    rows: u64,
    /// A path of single detections that leads here and is too fast for the type: its velocity and steps.
    pub fast: Option<([f64; 2], u32)>,
}

impl Agent {
    pub fn new(number: u32, agent_type: AgentType, spot: Spot) -> Self {
        Self {
            number,
            agent_type,
            seen_ns: spot.stamp_ns,
            last: spot,
            velocity_mps: None,
            motion: Motion::new(spot.position_m()),
            pending: None,
            held: None,
            alone_ns: [None; 2],
            first: spot,
            reported_m: Some(0.0),
            is_constant: [true; 2],
            chord_mps: None,
            rows: 1,
            fast: None,
        }
    }

    /// The velocity and the steps of a path that is too fast for the type, if it leads from this single detection to
    /// the spot.
    pub fn leads_to(&self, spot: &Spot) -> Option<([f64; 2], u32)> {
        let elapsed_s = (spot.stamp_ns - self.last.stamp_ns) as f64 * 1e-9;
        let [_, _, most_mps] = usual_mps(self.agent_type);
        if self.velocity_mps.is_some() || !(0.0..=FAST_STEP_S).contains(&elapsed_s) || elapsed_s == 0.0 {
            return None;
        }
        let new @ [x_mps, y_mps] = self.last.way_m(spot).map(|way_m| way_m / elapsed_s);
        let speed_mps = x_mps.hypot(y_mps);
        (most_mps..limit_mps(AgentType::Vehicle)).contains(&speed_mps).then_some(())?;
        match self.fast {
            Some((old, steps)) => {
                let change_mps = (new[0] - old[0]).hypot(new[1] - old[1]);
                (change_mps <= 0.1 * speed_mps + FAST_SLACK_M / elapsed_s).then_some((new, steps + 1))
            }
            None => Some((new, 1)),
        }
    }

    /// The distance from the agent's expected position, if the spot is near.
    pub fn is_near(&self, spot: &Spot) -> Option<f64> {
        let elapsed_s = (spot.stamp_ns - self.last.stamp_ns) as f64 * 1e-9;
        let [x_m, y_m] = self.motion.off_m(spot.position_m(), elapsed_s);
        let distance_m = x_m.hypot(y_m);
        let most_m = match self.motion.velocity_mps {
            Some([x_mps, y_mps]) => SLACK_M + (0.5 * x_mps.hypot(y_mps)).max(3.0) * elapsed_s,
            None => self.first_step_m(elapsed_s),
        };
        (distance_m <= most_m).then_some(distance_m)
    }

    /// The distance from the newest detection, if an agent whose velocity is unknown may have moved by it.
    pub fn is_first_near(&self, spot: &Spot) -> Option<f64> {
        let elapsed_s = (spot.stamp_ns - self.last.stamp_ns) as f64 * 1e-9;
        Some(self.last.distance_m(spot)).filter(|distance_m| *distance_m <= self.first_step_m(elapsed_s))
    }

    fn first_step_m(&self, elapsed_s: f64) -> f64 {
        (SLACK_M + usual_mps(self.agent_type)[1] * elapsed_s).min(FIRST_STEP_M)
    }

    /// Whether the velocity is known, from two detections.
    pub const fn moves(&self) -> bool {
        self.velocity_mps.is_some()
    }

    /// Speed of the step to the newest detection.
    fn speed_mps(&self) -> f64 {
        self.velocity_mps.map_or(0.0, |[x_mps, y_mps]| x_mps.hypot(y_mps))
    }

    /// Adds the next detection. Only an agent with an identity can be out of reach.
    pub fn step(&mut self, spot: Spot, agent_type: AgentType, identified: bool) -> Step {
        let mut step = Step::default();
        let since_ns = spot.stamp_ns - self.seen_ns;
        if since_ns <= 0 {
            return step;
        }
        (self.seen_ns, self.agent_type) = (spot.stamp_ns, agent_type);
        step.interval_ns = Some(since_ns);
        if spot.stamp_ns - self.last.stamp_ns > GAP_MAX_NS {
            if identified && self.held.is_none() && !self.last.reaches(&spot, agent_type) {
                step.jump = Some(spot.place);
            }
            *self = Self::new(self.number, agent_type, spot);
            return step;
        }
        if spot.position_m == self.last.position_m {
            self.pending = None;
            self.hold(spot.place, &mut step);
            return step;
        }
        // After a step out of reach, both paths may have come into reach. The slower one is the agent's.
        let is_new_way = self.pending.is_some_and(|pending| {
            pending.reaches(&spot, agent_type) && pending.speed_mps(&spot) < self.last.speed_mps(&spot)
        });
        if identified && (is_new_way || !self.last.reaches(&spot, agent_type)) {
            self.out_of_reach(spot, agent_type, &mut step);
            return step;
        }
        step.outlier = self.pending.take().map(|pending| pending.place);
        self.reach(spot, &mut step);
        step
    }

    /// Adds a detection at the same position. A fast agent can't stop between two detections.
    fn hold(&mut self, place: Place, step: &mut Step) {
        let (first, rows) = self.held.map_or((place, 1), |(first, rows)| (first, rows + 1));
        self.held = Some((first, rows));
        let on_grid = self.on_grid(self.last.stamp_ns);
        if rows >= HELD && on_grid == Some(false) && self.speed_mps() >= HELD_MPS {
            step.repeated = Some(Repeated { first, rows, on_grid });
            self.held = Some((first, 0));
            self.rows += rows;
        }
    }

    fn out_of_reach(&mut self, spot: Spot, agent_type: AgentType, step: &mut Step) {
        if spot.is_placeholder() {
            step.placeholder = Some(spot.place);
            return;
        }
        match self.pending {
            Some(pending) if pending.reaches(&spot, agent_type) => {
                if self.last.is_placeholder() {
                    step.placeholder = Some(self.last.place);
                } else {
                    step.jump = Some(pending.place);
                }
                *self = Self::new(self.number, agent_type, pending);
                self.seen_ns = spot.stamp_ns;
                self.reach(spot, &mut Step::default());
            }
            pending => {
                step.outlier = pending.map(|pending| pending.place);
                self.pending = Some(spot);
            }
        }
    }

    /// Advances to a detection within reach.
    fn reach(&mut self, spot: Spot, step: &mut Step) {
        let elapsed_s = (spot.stamp_ns - self.last.stamp_ns) as f64 * 1e-9;
        let [x_m, y_m] = self.last.way_m(&spot);
        let way_m = x_m.hypot(y_m);
        match [x_m, y_m].map(|way_m| way_m == 0.0) {
            [false, true] => self.alone_ns[0] = Some(spot.stamp_ns),
            [true, false] => self.alone_ns[1] = Some(spot.stamp_ns),
            _ => {}
        }
        if let Some((first, rows)) = self.held.take() {
            let speed_mps = self.speed_mps().min(way_m / elapsed_s);
            let moves = speed_mps >= MOVING_MPS && way_m >= STEP_MIN_M;
            step.repeated = moves.then_some(Repeated { first, rows, on_grid: self.on_grid(spot.stamp_ns) });
            self.rows += rows;
        }
        let mean_mps = self.last.speed_mps.zip(spot.speed_mps).map(|(from, to)| (from + to) / 2.0);
        let reported_m = mean_mps.map(|mean_mps| mean_mps * elapsed_s);
        self.reported_m = self.reported_m.zip(reported_m).map(|(way_m, step_m)| way_m + step_m);
        let is_same_speed = match (spot.speed_mps, self.first.speed_mps) {
            (Some(speed_mps), Some(first_mps)) => (speed_mps - first_mps).abs() <= NEAR_ZERO_MPS,
            (speed_mps, first_mps) => speed_mps == first_mps,
        };
        let are_equal = [is_same_speed, spot.heading == self.first.heading];
        self.is_constant = [0, 1].map(|column| self.is_constant[column] && are_equal[column]);
        self.motion.advance(spot.position_m(), elapsed_s);
        (self.last, self.velocity_mps) = (spot, Some([x_m / elapsed_s, y_m / elapsed_s]));
        self.rows += 1;
        let elapsed_ns = spot.stamp_ns - self.first.stamp_ns;
        if elapsed_ns >= CHORD_NS {
            self.end_chord(elapsed_ns as f64 * 1e-9, step);
        }
    }

    fn on_grid(&self, now_ns: i64) -> Option<bool> {
        let alone = self.alone_ns.map(|seen_ns| seen_ns.is_some_and(|seen_ns| now_ns - seen_ns <= GRID_NS));
        (alone[0] == alone[1]).then_some(alone[0])
    }

    fn end_chord(&mut self, elapsed_s: f64, step: &mut Step) {
        let Self { first, last, reported_m, rows, .. } = *self;
        let [x_m, y_m] = first.way_m(&last);
        let way_m = x_m.hypot(y_m);
        let (rows, place) = (rows - 1, first.place);
        let [way_min_m, speed_min_mps] = DIRECTED;
        let is_directed = way_m >= way_min_m && way_m / elapsed_s >= speed_min_mps;
        let chord_mps = [x_m / elapsed_s, y_m / elapsed_s];
        let steady = self.chord_mps.replace(chord_mps).is_some_and(|before| is_steady(before, chord_mps));
        step.chord =
            Some(Chord { way_m, elapsed_s, reported_m: reported_m.map(f64::abs), rows, place, steady });
        // A number that stands for an unknown speed does not follow the motion.
        let is_reverse = reported_m.is_some_and(|reported_m| (0.5..2.0).contains(&(-reported_m / way_m)));
        let direction_rad = if is_reverse { (-y_m).atan2(-x_m) } else { y_m.atan2(x_m) };
        let [speed, heading] = [first.speed_mps, first.heading];
        step.constant = is_directed.then_some(Constant {
            speed: speed.filter(|_| self.is_constant[0]),
            heading: heading.filter(|_| self.is_constant[1]),
            way: Way {
                agent: self.number,
                from_m: first.position_m,
                from_ns: first.stamp_ns,
                velocity_mps: chord_mps,
                elapsed_s,
                rows,
                place,
            },
            direction_rad,
            steady,
        });
        if let (Some(from), Some(to)) = (first.heading, last.heading)
            && is_directed
        {
            let speed_mps = way_m / elapsed_s;
            step.directed = Some(Directed { direction_rad, speed_mps, headings: [from, to], rows, place });
        }
        (self.first, self.reported_m, self.rows) = (last, Some(0.0), 1);
        self.is_constant = [true; 2];
    }
}

/// Whether two consecutive chords of an agent show one motion. Noise around a place turns back.
fn is_steady(before_mps: [f64; 2], now_mps: [f64; 2]) -> bool {
    let [before, now] = [before_mps, now_mps].map(|[x_mps, y_mps]| x_mps.hypot(y_mps));
    let along = before_mps[0] * now_mps[0] + before_mps[1] * now_mps[1];
    along > STEADY_COS * before * now && before > 0.5 * now && now > 0.5 * before
}
