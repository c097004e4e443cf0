//! Identities that are none: agents continue, but under another identity.
//!
//! An agent keeps its identity if the next detection with this identity is near its expected position. If no agent
//! with this identity is near, the detection may continue another agent that this frame has not continued yet. This is
//! a *handover*. Trackers make few of them. A detector that numbers its detections in each frame from the start, or in a
//! random order, makes little else.

use wire::{AgentType, Detection, detection_flags};

use crate::agent::{Agent, GAP_MAX_NS, Spot};
use crate::doubt::Doubt;
use crate::finding::{Detail, Finding};
use crate::tally::{Place, Tally};

/// Largest number of identities that are followed. A new one replaces the least recently seen one.
const IDENTITIES_MAX: usize = 2 * wire::DETECTIONS_MAX;
/// Longest time that a handover takes.
const HANDOVER_MAX_NS: i64 = 1_000_000_000;
/// Marks an identity whose agent another one has continued.
const HANDED_OVER: u64 = u64::MAX;
/// Smallest number of frames and of handovers, or of identities that were seen once.
const FRAMES_MIN: u64 = 8;
const ROWS_MIN: u64 = 20;
/// Agents change their identity more often than once in this time.
const LIFE_MIN_S: f64 = 2.0;
/// Share of the detections whose identity is new, if agents can't be followed.
const NEW_SHARE: f64 = 0.8;

/// An identity with its agent, and the frame that continued the agent under any identity.
#[derive(Clone, Copy, Debug)]
struct Identity {
    agent: Agent,
    continued: u64,
}

/// Counts how often agents change their identity.
#[derive(Clone, Debug)]
pub struct Handovers {
    /// The identities, and their agents in the same order.
    ids: Vec<u64>,
    identities: Vec<Identity>,
    frame: u64,
    /// Detections of the present frame.
    rows: Vec<(u64, AgentType, Spot)>,
    frames: u64,
    /// Detections, and those with a new identity.
    seen: u64,
    new: Tally,
    handed: Tally,
    /// Time over which agents were followed.
    followed_s: f64,
}

impl Default for Handovers {
    fn default() -> Self {
        Self {
            ids: Vec::with_capacity(IDENTITIES_MAX),
            identities: Vec::with_capacity(IDENTITIES_MAX),
            frame: 0,
            rows: Vec::with_capacity(wire::DETECTIONS_MAX),
            frames: 0,
            seen: 0,
            new: Tally::default(),
            handed: Tally::default(),
            followed_s: 0.0,
        }
    }
}

impl Handovers {
    /// Discards the counts and continues with the same agents.
    pub(crate) fn clear(&mut self) {
        (self.frames, self.seen, self.followed_s) = (0, 0, 0.0);
        (self.new, self.handed) = Default::default();
    }

    /// Forgets the agents.
    pub(crate) fn end_session(&mut self) {
        self.ids.clear();
        self.identities.clear();
        self.rows.clear();
    }

    /// Adds a detection of a frame. Detections without an identity are ignored, and so are those beyond the limit of a
    /// frame.
    pub fn detection(&mut self, frame: u64, stamp_ns: i64, detection: &Detection, place: Place) {
        let Ok(agent_type) = detection.agent_type() else { return };
        if frame != self.frame {
            self.end_frame();
            self.frame = frame;
        }
        if detection.has(detection_flags::HAS_ID) && self.rows.len() < wire::DETECTIONS_MAX {
            self.rows.push((detection.id, agent_type, Spot::new(stamp_ns, detection, place)));
        }
    }

    /// The doubt about the identities, if agents change them too often or nearly every detection has a new one.
    #[must_use]
    pub fn doubt(&self) -> Option<Finding> {
        if self.frames < FRAMES_MIN {
            return None;
        }
        let found = |tally, detail| Some(Finding::new(Doubt::IdentitiesChange, tally, self.seen, detail));
        let interval_s = self.followed_s / self.handed.rows.max(1) as f64;
        if self.handed.rows >= ROWS_MIN && interval_s < LIFE_MIN_S {
            return found(self.handed, Detail::Interval { interval_s });
        }
        let are_new = self.new.rows >= ROWS_MIN && self.new.rows as f64 >= NEW_SHARE * self.seen as f64;
        if are_new { found(self.new, Detail::None) } else { None }
    }

    fn end_frame(&mut self) {
        let Self { ids, identities, rows, frame, .. } = self;
        self.frames += u64::from(!rows.is_empty());
        self.seen += rows.len() as u64;
        // Agents under their own identities come first.
        rows.retain(|(id, agent_type, spot)| {
            let Some(place) = ids.iter().position(|own| own == id) else { return true };
            let own = &mut identities[place];
            let is_kept = own.age_ns(spot) <= GAP_MAX_NS && own.agent.is_near(spot).is_some();
            if is_kept {
                self.followed_s += own.age_ns(spot) as f64 * 1e-9;
                own.agent.step(*spot, *agent_type, false);
                own.continued = *frame;
            }
            !is_kept
        });
        for place in 0..self.rows.len() {
            let (id, _, spot) = self.rows[place];
            self.hand_over(id, &spot);
        }
        for place in 0..self.rows.len() {
            self.begin(self.rows[place]);
        }
        self.rows.clear();
    }

    /// Examines whether a detection continues the agent of another identity.
    fn hand_over(&mut self, id: u64, spot: &Spot) {
        let own = self.place(id);
        let is_recent = |own: &Identity| own.age_ns(spot) <= GAP_MAX_NS;
        // The second detection of a fast agent may be anywhere.
        if own.map(|own| &self.identities[own]).is_some_and(|own| is_recent(own) && !own.agent.moves()) {
            return;
        }
        let frame = self.frame;
        let others = (0..).zip(&mut self.identities).filter(|(place, _)| Some(*place) != own);
        let others = others.map(|(_, other)| other).filter(|other| {
            let is_free = ![frame, HANDED_OVER].contains(&other.continued);
            is_free && (1..=HANDOVER_MAX_NS).contains(&other.age_ns(spot))
        });
        let distance_m = |agent: &Agent| agent.is_near(spot).or_else(|| agent.is_first_near(spot));
        let near = others.filter_map(|other| Some((distance_m(&other.agent)?, other)));
        if let Some((_, other)) = near.min_by(|(a_m, _), (b_m, _)| a_m.total_cmp(b_m)) {
            other.continued = HANDED_OVER;
            self.followed_s += other.age_ns(spot) as f64 * 1e-9;
            self.handed.add(1, spot.place);
        }
    }

    /// Follows an identity from this detection on.
    fn begin(&mut self, (id, agent_type, spot): (u64, AgentType, Spot)) {
        let continued = self.frame;
        if let Some(place) = self.place(id) {
            let own = &mut self.identities[place];
            own.agent.step(spot, agent_type, true);
            own.continued = continued;
            return;
        }
        let new = Identity { agent: Agent::new(0, agent_type, spot), continued };
        self.new.add(1, spot.place);
        let is_full = self.identities.len() == IDENTITIES_MAX;
        let oldest = (0..).zip(&self.identities).filter(|_| is_full);
        match oldest.min_by_key(|(_, other)| other.agent.seen_ns) {
            Some((oldest, _)) => (self.ids[oldest], self.identities[oldest]) = (id, new),
            None => {
                self.ids.push(id);
                self.identities.push(new);
            }
        }
    }

    fn place(&self, id: u64) -> Option<usize> {
        self.ids.iter().position(|own| *own == id)
    }
}

impl Identity {
    /// Time since the newest detection.
    const fn age_ns(&self, spot: &Spot) -> i64 {
        spot.stamp_ns - self.agent.seen_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Audit;

    /// The doubts about four agents on lanes 4 m apart that are seen for 10 s. `id` returns the identity of an agent in
    /// a frame.
    fn doubts(agent_type: AgentType, hz: u64, id: impl Fn(u64, u64) -> u64) -> u32 {
        let mut audit = Audit::new(64, None);
        let speed_mps = if agent_type == AgentType::Vehicle { 9.0 } else { 1.3 };
        for frame in 0..10 * hz {
            audit.frame();
            for agent in 0..4 {
                let x_m = (speed_mps + 0.2 * agent as f32) * frame as f32 / hz as f32;
                let detection = Detection {
                    id: id(frame, agent),
                    x_m,
                    y_m: 4.0 * agent as f32,
                    agent_type: agent_type as u32,
                    flags: detection_flags::HAS_ID,
                    ..Detection::default()
                };
                let stamp_ns = (frame * 1_000_000_000 / hz) as i64;
                audit.detection(stamp_ns, &detection, Place { file: 0, line: frame });
            }
        }
        audit.doubts()
    }

    #[test]
    fn identities_that_change_every_few_frames_are_found() {
        for agent_type in [AgentType::Vehicle, AgentType::Pedestrian] {
            for hz in [5, 10, 25] {
                for frames in [1, 2, 3, 7] {
                    let found = doubts(agent_type, hz, |frame, agent| frame / frames * 4 + agent);
                    assert_ne!(found & Doubt::IdentitiesChange.bit(), 0, "{agent_type:?} {hz} Hz {frames}");
                }
                assert_eq!(doubts(agent_type, hz, |_, agent| agent), 0, "{agent_type:?} {hz} Hz");
                // A tracker that loses each agent every 4 s.
                let lost = doubts(agent_type, hz, |frame, agent| (frame + agent) / (4 * hz) * 4 + agent);
                assert_eq!(lost, 0, "{agent_type:?} {hz} Hz");
            }
        }
    }

    #[test]
    fn identities_in_another_order_are_found() {
        for agent_type in [AgentType::Vehicle, AgentType::Pedestrian] {
            for frames in [1, 2, 5] {
                // A detector that numbers its detections in the order of their scores.
                let found =
                    doubts(agent_type, 10, |frame, agent| (agent * 3 + (frame / frames) * 7 % 11) % 4);
                assert_ne!(found & Doubt::IdentitiesChange.bit(), 0, "{agent_type:?} {frames}");
            }
        }
    }

    /// Agents that are missing in every fifth frame, in turn.
    #[test]
    fn placeholders_hand_nothing_over() {
        let mut audit = Audit::new(64, None);
        for frame in 0..200_u64 {
            audit.frame();
            for agent in 0..4 {
                let is_missing = (frame + agent).is_multiple_of(5);
                let [x_m, y_m] = [0.9 * frame as f32, 4.0 * agent as f32];
                let [x_m, y_m] = if is_missing { [-999.0; 2] } else { [x_m, y_m] };
                let flags = detection_flags::HAS_ID;
                let detection = Detection { id: agent, x_m, y_m, flags, ..Detection::default() };
                audit.detection(frame as i64 * 100_000_000, &detection, Place::default());
            }
        }
        assert_eq!(audit.doubts(), Doubt::Outliers.bit());
    }

    #[test]
    fn fast_agents_with_new_identities_are_found() {
        // 9 m from frame to frame.
        let found = doubts(AgentType::Vehicle, 1, |frame, agent| 4 * frame + agent);
        assert_ne!(found & Doubt::IdentitiesChange.bit(), 0);
        assert_eq!(doubts(AgentType::Vehicle, 1, |_, agent| agent) & Doubt::IdentitiesChange.bit(), 0);
    }
}
