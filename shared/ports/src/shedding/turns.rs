use wire::AGENTS_MAX;

/// Maximum number of agents that are served because they are the nearest.
pub const NEAREST_LEN: usize = 32;
/// Maximum number of agents that are served first because they are on a conflicting path.
pub const CONFLICTS_MAX: usize = 8;
/// Time ahead in which paths are checked for a conflict with the ego's path: the horizon of a forecast.
pub const CONFLICT_S: f32 = 4.8;
/// Paths conflict if they come closer than this, m. Half a car's length, plus a margin.
const CONFLICT_M: f32 = 3.0;
/// One turn in this many goes by waiting time only.
const WAITING_EVERY: usize = 6;

/// The ego, or the scene's centre at rest.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ego {
    /// Position in the world frame.
    pub position_m: [f32; 2],
    /// Velocity in the world frame.
    pub velocity_mps: [f32; 2],
}

/// An agent that can be forecast.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Candidate {
    /// Place in the frame, below [`AGENTS_MAX`].
    pub place: usize,
    /// Position in the world frame; finite.
    pub position_m: [f32; 2],
    /// Velocity in the world frame; finite.
    pub velocity_mps: [f32; 2],
    /// Age of the newest learned forecast. Before the first one, the time since the agent became
    /// forecastable.
    pub waiting_ns: u64,
}

impl Candidate {
    fn distance_m(&self, ego: &Ego) -> f32 {
        let [x, y] = [0, 1].map(|axis| self.position_m[axis] - ego.position_m[axis]);
        x.hypot(y)
    }

    /// Time until the agent and the ego come closer than [`CONFLICT_M`] at constant velocities; `None` if
    /// that takes longer than [`CONFLICT_S`].
    fn conflict_s(&self, ego: &Ego) -> Option<f32> {
        let apart_m = [0, 1].map(|axis| self.position_m[axis] - ego.position_m[axis]);
        let closing_mps = [0, 1].map(|axis| self.velocity_mps[axis] - ego.velocity_mps[axis]);
        let dot = |a: [f32; 2], b: [f32; 2]| a[0] * b[0] + a[1] * b[1];
        // The first solution of |apart + closing t|² = CONFLICT_M².
        let (a, b) = (dot(closing_mps, closing_mps), dot(apart_m, closing_mps));
        let c = dot(apart_m, apart_m) - CONFLICT_M * CONFLICT_M;
        if c <= 0.0 {
            return Some(0.0);
        }
        let discriminant = b * b - a * c;
        if b >= 0.0 || discriminant < 0.0 {
            return None;
        }
        let time_s = c / (discriminant.sqrt() - b);
        (time_s <= CONFLICT_S).then_some(time_s)
    }
}

/// Computes the order in which agents are served. Holds scratch memory only.
#[derive(Clone, Debug)]
pub struct Turns {
    /// (time to conflict, place).
    conflicts: Vec<(f32, usize)>,
    /// (distance, place).
    nearest: Vec<(f32, usize)>,
    /// (waiting, distance, place).
    waiting: Vec<(u64, f32, usize)>,
    order: Vec<usize>,
}

impl Default for Turns {
    fn default() -> Self {
        let room = AGENTS_MAX;
        Self {
            conflicts: Vec::with_capacity(room),
            nearest: Vec::with_capacity(room),
            waiting: Vec::with_capacity(room),
            order: Vec::with_capacity(room),
        }
    }
}

impl Turns {
    /// Returns the places of the candidates in the order of their turns. The result does not depend on the
    /// order of `candidates`.
    ///
    /// # Panics
    /// If a place is not below [`AGENTS_MAX`].
    pub fn order(&mut self, ego: &Ego, candidates: &[Candidate]) -> &[usize] {
        self.sort(ego, candidates);
        let Self { conflicts, nearest, waiting, order } = self;
        order.clear();
        let mut served = [false; AGENTS_MAX];
        let nearest = nearest.iter().take(NEAREST_LEN).map(|&(_, place)| place);
        let mut first = conflicts.iter().take(CONFLICTS_MAX).map(|&(_, place)| place).chain(nearest);
        let mut waiting = waiting.iter().map(|&(.., place)| place);
        while order.len() < candidates.len() {
            let open = |place: &usize| !served[*place];
            let by_waiting = order.len() % WAITING_EVERY == WAITING_EVERY - 1;
            let chosen = if by_waiting { None } else { first.find(open) };
            let Some(place) = chosen.or_else(|| waiting.find(open)) else { break };
            served[place] = true;
            order.push(place);
        }
        order
    }

    fn sort(&mut self, ego: &Ego, candidates: &[Candidate]) {
        let Self { conflicts, nearest, waiting, .. } = self;
        conflicts.clear();
        nearest.clear();
        waiting.clear();
        for candidate in candidates {
            let (place, distance_m) = (candidate.place, candidate.distance_m(ego));
            conflicts.extend(candidate.conflict_s(ego).map(|time_s| (time_s, place)));
            nearest.push((distance_m, place));
            waiting.push((candidate.waiting_ns, distance_m, place));
        }
        let by_value = |a: &(f32, usize), b: &(f32, usize)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        conflicts.sort_unstable_by(by_value);
        nearest.sort_unstable_by(by_value);
        waiting.sort_unstable_by(|a, b| b.0.cmp(&a.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
    }
}

/// Maximum number of ticks between two learned forecasts of an agent, if each tick serves the first
/// `served_count` of at most `agents_len` agents. Returns `None` if there are no agents, or if a tick serves
/// too few agents for a turn by waiting.
///
/// An agent that is served by waiting had waited at least as long as this agent. From then on, it has waited
/// less. Each other agent therefore precedes this agent at most once. Each tick serves one of them per turn
/// by waiting.
#[must_use]
pub const fn wait_ticks_max(agents_len: usize, served_count: usize) -> Option<usize> {
    if agents_len == 0 || served_count < WAITING_EVERY && served_count < agents_len {
        return None;
    }
    if agents_len <= served_count {
        return Some(1);
    }
    let left = served_count.saturating_sub(CONFLICTS_MAX + NEAREST_LEN);
    let by_waiting = if left > served_count / WAITING_EVERY { left } else { served_count / WAITING_EVERY };
    Some((agents_len - 1) / by_waiting + 1)
}
