//! Orders the agents for ticks that may not have time for all of them.

use ports::shedding::{Candidate, Ego, Turns};
use wire::{AGENTS_MAX, AgentFeatures, Header, Track};

/// The agents of the scene, and how long each has waited for a learned forecast.
pub(crate) struct Queue {
    turns: Turns,
    candidates: Vec<Candidate>,
    known: Vec<Known>,
    /// Stamp and position of the ego in the last tick.
    ego: Option<(i64, [f32; 2])>,
}

/// An agent that can be forecast.
#[derive(Clone, Copy)]
struct Known {
    id: u64,
    /// Stamp of the first tick in which the agent was forecastable.
    first_ns: i64,
    /// Stamp of the last tick in which the agent was not shed here.
    sent_ns: Option<i64>,
    /// Whether the agent is in the current tick.
    is_there: bool,
}

impl Queue {
    pub(crate) fn new() -> Self {
        Self {
            turns: Turns::default(),
            candidates: Vec::with_capacity(AGENTS_MAX),
            known: Vec::with_capacity(2 * AGENTS_MAX),
            ego: None,
        }
    }

    /// Forgets all agents.
    pub(crate) fn clear(&mut self) {
        self.turns = Turns::default();
        self.known.clear();
        self.ego = None;
    }

    /// Gives the agents of a tick, one per track, their turns. Agents after the first `served_max` are marked
    /// as shed.
    pub(crate) fn choose(
        &mut self,
        header: &Header,
        tracks: &[Track],
        served_max: usize,
        agents: &mut [AgentFeatures],
    ) {
        let ego = self.ego(header);
        self.known.iter_mut().for_each(|known| known.is_there = false);
        self.candidates.clear();
        for (place, track) in tracks.iter().enumerate().filter(|(_, track)| track.forecastable != 0) {
            let known = self.know(track.id, header.stamp_ns);
            let (position_m, velocity_mps) = ([track.x_m, track.y_m], [track.vx_mps, track.vy_mps]);
            let waiting_ns = known.waiting_ns(header, track);
            self.candidates.push(Candidate { place, position_m, velocity_mps, waiting_ns });
        }
        self.known.retain(|known| known.is_there);
        for (turn, &place) in self.turns.order(&ego, &self.candidates).iter().enumerate() {
            agents[place].turn = turn as u32 + 1;
            agents[place].shed = u32::from(turn >= served_max);
            if turn < served_max
                && let Some(known) = self.known.iter_mut().find(|known| known.id == tracks[place].id)
            {
                known.sent_ns = Some(header.stamp_ns);
            }
        }
    }

    /// The ego, or the scene's centre. The velocity comes from the last two positions.
    fn ego(&mut self, header: &Header) -> Ego {
        let position_m = header.ego_m;
        let last = self.ego.replace((header.stamp_ns, position_m));
        let velocity_mps = last.filter(|(last_ns, _)| *last_ns < header.stamp_ns).map(|(last_ns, last_m)| {
            let dt_s = (header.stamp_ns - last_ns) as f64 * 1e-9;
            [0, 1].map(|axis| (f64::from(position_m[axis] - last_m[axis]) / dt_s) as f32)
        });
        Ego { position_m, velocity_mps: velocity_mps.unwrap_or_default() }
    }

    /// The entry of an agent of the current tick, added if it is new.
    fn know(&mut self, id: u64, now_ns: i64) -> Known {
        let place = self.known.iter().position(|known| known.id == id).unwrap_or_else(|| {
            self.known.push(Known { id, first_ns: now_ns, sent_ns: None, is_there: true });
            self.known.len() - 1
        });
        self.known[place].is_there = true;
        self.known[place]
    }
}

impl Known {
    /// The age of the agent's newest learned forecast. Before the first one, the time since the agent became
    /// forecastable.
    ///
    /// The tracker reports the learned age of each agent as of the newest forecasts that it has received. An
    /// agent that was sent on after those forecasts counts as served. Without feedback from the tracker,
    /// every agent that was sent on counts as served.
    fn waiting_ns(&self, header: &Header, track: &Track) -> u64 {
        let since = |then_ns: i64| u64::try_from(header.stamp_ns.saturating_sub(then_ns)).unwrap_or(0);
        let is_told = |sent_ns: i64| header.feedback_age_ns > 0 && since(sent_ns) >= header.feedback_age_ns;
        match self.sent_ns {
            Some(sent_ns) if !is_told(sent_ns) => since(sent_ns),
            _ if track.learned_age_ns > 0 => track.learned_age_ns,
            // One more, so that this agent precedes one that was served when this one appeared.
            _ => since(self.first_ns).saturating_add(1),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    const TICK_NS: i64 = 80_000_000;

    /// Returns the ids that are sent on in a tick. Ticks differ only in the ages of the forecasts.
    fn sent(
        queue: &mut Queue,
        tick: i64,
        feedback_ticks: u64,
        learned_ticks: &[u64],
        served_max: usize,
    ) -> Vec<u64> {
        let track = |(i, ticks): (usize, &u64)| Track {
            id: i as u64,
            forecastable: 1,
            x_m: 50.0 + i as f32,
            learned_age_ns: ticks * TICK_NS as u64,
            ..Track::zeroed()
        };
        let tracks: Vec<Track> = learned_ticks.iter().enumerate().map(track).collect();
        let mut agents: Vec<_> = tracks
            .iter()
            .map(|t| AgentFeatures { id: t.id, forecastable: 1, ..AgentFeatures::zeroed() })
            .collect();
        let feedback_age_ns = feedback_ticks * TICK_NS as u64;
        let header = Header { feedback_age_ns, ..Header::new(1, tick as u64, tick * TICK_NS) };
        queue.choose(&header, &tracks, served_max, &mut agents);
        agents.iter().filter(|agent| agent.shed == 0).map(|agent| agent.id).collect()
    }

    #[test]
    fn who_was_left_out_further_on_comes_again() {
        let mut queue = Queue::new();
        // Of 40 agents, the nearest 32 have the same turns in each tick. The others get turns by waiting.
        let mut ages = [1_u64; 40];
        ages[39] = 9;
        assert_eq!(sent(&mut queue, 20, 1, &ages, 6), [0, 1, 2, 3, 4, 39]);
        // The decoder had no time for agent 39. The tracker's newest forecasts are from tick 20.
        ages[39] = 10;
        assert_eq!(sent(&mut queue, 21, 1, &ages, 6), [0, 1, 2, 3, 4, 39]);
        // The forecasts of tick 21 have not arrived, so agent 39 counts as served.
        ages[39] = 11;
        ages[35] = 5;
        assert_eq!(sent(&mut queue, 22, 2, &ages, 6), [0, 1, 2, 3, 4, 35]);
    }

    #[test]
    fn without_the_trackers_word_all_that_were_sent_on_count_as_served() {
        let mut queue = Queue::new();
        let ages = [0; 12];
        let mut by_waiting: Vec<u64> = Vec::new();
        for tick in 0..7 {
            by_waiting.extend(sent(&mut queue, tick, 0, &ages, 6).into_iter().filter(|id| *id > 4));
        }
        assert_eq!(by_waiting, [5, 6, 7, 8, 9, 10, 11]);
    }
}
