use wire::AgentType;

use crate::agent::{Agent, GAP_MAX_NS, Spot, Step};

/// Number of places in a set, among which an identity is looked up.
const WAYS: usize = 4;
/// Smallest number of steps of a path that is too fast for its type. Single false detections make shorter ones.
const FAST_STEPS_MIN: u32 = 3;
/// Largest number of agents without identities.
const LOOSE_MAX: usize = wire::DETECTIONS_MAX;

/// The followed agents, in bounded memory. A new identity replaces the least recently seen agent of its set.
#[derive(Clone, Debug)]
pub(crate) struct Agents {
    /// Sets of [`WAYS`] places, by the identity's hash.
    identified: Vec<Option<(u64, Agent)>>,
    /// Agents without an identity, with the number of the last frame that detected them.
    loose: Vec<(Agent, u64)>,
    /// Number of the newest agent.
    newest: u32,
}

impl Agents {
    /// Room for this number of identities, rounded up to a power of two.
    pub fn with_capacity(len: usize) -> Self {
        let identified = vec![None; len.next_power_of_two().max(WAYS)];
        Self { identified, loose: Vec::with_capacity(LOOSE_MAX), newest: 0 }
    }

    /// Forgets all agents.
    pub fn clear(&mut self) {
        self.identified.fill(None);
        self.loose.clear();
    }

    /// Adds a detection with an identity. Returns `None` if the identity is new.
    pub fn identified(&mut self, id: u64, agent_type: AgentType, spot: Spot) -> Option<Step> {
        let sets = self.identified.len() / WAYS;
        // Fibonacci hashing: neighbouring identities go to different sets.
        let hash = id.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32;
        let set = hash as usize % sets * WAYS;
        let set = &mut self.identified[set..set + WAYS];
        let known = set.iter_mut().flatten().find(|(known, _)| *known == id);
        if let Some((_, agent)) = known {
            return Some(agent.step(spot, agent_type, true));
        }
        let age = |place: &&mut Option<(u64, Agent)>| place.map_or(i64::MIN, |(_, agent)| agent.seen_ns);
        if let Some(oldest) = set.iter_mut().min_by_key(age) {
            self.newest = self.newest.wrapping_add(1).max(1);
            *oldest = Some((id, Agent::new(self.newest, agent_type, spot)));
        }
        None
    }

    /// Adds a detection without an identity to the nearest agent of its type that this frame has not detected
    /// yet. Returns `None` if the agent is new.
    pub fn loose(&mut self, frame: u64, agent_type: AgentType, spot: Spot) -> Option<Step> {
        let mut nearest: Option<(f64, usize)> = None;
        // The path with most steps.
        let mut fast: Option<([f64; 2], u32)> = None;
        let mut place = 0;
        while let Some((agent, seen)) = self.loose.get(place) {
            // Detections of a frame are in any order.
            if spot.stamp_ns.abs_diff(agent.seen_ns) > GAP_MAX_NS.unsigned_abs() {
                self.loose.swap_remove(place);
                continue;
            }
            if *seen != frame && agent.agent_type == agent_type && agent.seen_ns <= spot.stamp_ns {
                match agent.is_near(&spot) {
                    Some(distance_m) if nearest.is_none_or(|(least_m, _)| distance_m < least_m) => {
                        nearest = Some((distance_m, place));
                    }
                    Some(_) => {}
                    None => {
                        let found = agent.leads_to(&spot);
                        let steps = |path: Option<([f64; 2], u32)>| path.map_or(0, |(_, steps)| steps);
                        fast = if steps(found) > steps(fast) { found } else { fast };
                    }
                }
            }
            place += 1;
        }
        if let Some((_, place)) = nearest {
            let (agent, seen) = &mut self.loose[place];
            *seen = frame;
            return Some(agent.step(spot, agent_type, false));
        }
        if self.loose.len() < LOOSE_MAX {
            self.newest = self.newest.wrapping_add(1).max(1);
            let mut agent = Agent::new(self.newest, agent_type, spot);
            agent.fast = fast;
            self.loose.push((agent, frame));
        }
        let ([x_mps, y_mps], _) = fast.filter(|(_, steps)| *steps >= FAST_STEPS_MIN)?;
        Some(Step { too_fast_mps: Some(x_mps.hypot(y_mps)), ..Step::default() })
    }
}
