use wire::AGENTS_MAX;

/// Agents that are served for being the nearest.
pub const NEAREST_LEN: usize = 32;
/// Most agents that are served before these for being on a conflicting path.
pub const CONFLICTS_MAX: usize = 8;
/// Time ahead in which a path can be in conflict with the ego's: the horizon of a forecast.
pub const CONFLICT_S: f32 = 4.8;
/// Paths conflict where they come closer than this, m: half a car's length and some.
const CONFLICT_M: f32 = 3.0;
/// One turn of this many goes by waiting alone.
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
    /// Its place in the frame, below [`AGENTS_MAX`].
    pub place: usize,
    /// Position in the world frame; finite.
    pub position_m: [f32; 2],
    /// Velocity in the world frame; finite.
    pub velocity_mps: [f32; 2],
    /// Age of its newest learned forecast, or the time since it could first be forecast.
    pub waiting_ns: u64,
}

impl Candidate {
    fn distance_m(&self, ego: &Ego) -> f32 {
        let [x, y] = [0, 1].map(|axis| self.position_m[axis] - ego.position_m[axis]);
        x.hypot(y)
    }

    /// Time until the agent and the ego come closer than [`CONFLICT_M`], if they do within [`CONFLICT_S`], where
    /// both keep their velocities.
    fn conflict_s(&self, ego: &Ego) -> Option<f32> {
        let apart_m = [0, 1].map(|axis| self.position_m[axis] - ego.position_m[axis]);
        let closing_mps = [0, 1].map(|axis| self.velocity_mps[axis] - ego.velocity_mps[axis]);
        let dot = |a: [f32; 2], b: [f32; 2]| a[0] * b[0] + a[1] * b[1];
        // |apart + closing t|² = CONFLICT_M², its first solution.
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

/// The order in which agents are served; keeps scratch memory alone.
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
    /// The places of the candidates in the order of their turns; does not depend on the order in which they come.
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

/// Most ticks from one learned forecast of an agent to the next where each tick serves the first `served_len` of
/// at most `agents_len` agents; none where too few fit a tick for a turn by waiting, or no agents are there.
///
/// Whoever is served by waiting has waited longer than this agent, and waits less than it from then on: each of the
/// others comes before it once at most, as many in a tick as there are turns by waiting.
#[must_use]
pub const fn wait_ticks_max(agents_len: usize, served_len: usize) -> Option<usize> {
    if agents_len == 0 || served_len < WAITING_EVERY && served_len < agents_len {
        return None;
    }
    if agents_len <= served_len {
        return Some(1);
    }
    let left = served_len.saturating_sub(CONFLICTS_MAX + NEAREST_LEN);
    let by_waiting = if left > served_len / WAITING_EVERY { left } else { served_len / WAITING_EVERY };
    Some((agents_len - 1) / by_waiting + 1)
}
