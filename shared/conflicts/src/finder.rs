use std::fmt;

use wire::{AGENTS_MAX, CONFLICTS_MAX, Forecast, ForeseenConflict};

use crate::{Moving, Odds, OddsOfSources, Room, Signs};

/// Less probable conflicts are not reported.
const PROBABILITY_MIN: f32 = 0.01;

/// Finds the conflicts of the agents of a tick.
pub struct Finder {
    odds: Odds,
    /// Agents of the tick, and of earlier ones that had more.
    agents: Vec<Moving>,
    /// Place of each of the tick's agents among the forecasts.
    places: Vec<usize>,
    room: Box<Room>,
}

impl Default for Finder {
    /// With the shipped odds.
    fn default() -> Self {
        let odds = OddsOfSources::shipped().all;
        Self {
            odds,
            agents: Vec::with_capacity(AGENTS_MAX),
            places: Vec::with_capacity(AGENTS_MAX),
            room: Box::default(),
        }
    }
}

impl fmt::Debug for Finder {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("Finder").field("odds", &self.odds).finish_non_exhaustive()
    }
}

/// Two agents that may have a conflict.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// Places of the agents among the forecasts, the smaller one first.
    pub places: [usize; 2],
    /// Probability of the conflict.
    pub probability: f32,
    /// Probability by the modes, as if neither agent reacted to the other.
    pub if_nobody_reacts: f32,
    /// Mean time until the conflict, s.
    pub in_s: f32,
    /// Where the most probable two modes that meet are closest to a conflict, m: the middle between both agents.
    pub at_m: [f32; 2],
}

impl Finder {
    /// Writes into each forecast the conflicts of its agent, the most probable first. Of equal ones, that with
    /// the earlier forecast comes first.
    pub fn write(&mut self, forecasts: &mut [Forecast], horizon_len: usize, dt_s: f32) {
        for forecast in forecasts.iter_mut() {
            forecast.conflicts_len = 0;
            forecast.conflicts = Default::default();
        }
        self.follow(&*forecasts, horizon_len);
        self.judge(dt_s, |[agent, other], signs, probability, _| {
            if probability < PROBABILITY_MIN {
                return;
            }
            let [.., if_nobody_reacts] = signs.conflict;
            let foreseen =
                ForeseenConflict { probability, if_nobody_reacts, in_s: signs.in_s, ..Default::default() };
            for (of, with) in [(agent, other), (other, agent)] {
                let other_id = forecasts[with].id;
                insert(&mut forecasts[of], ForeseenConflict { other_id, ..foreseen });
            }
        });
    }

    /// The pairs whose modes meet with at least a probability, in no order of their probabilities.
    pub fn pairs<'a>(
        &mut self,
        forecasts: impl IntoIterator<Item = &'a Forecast>,
        horizon_len: usize,
        dt_s: f32,
        if_nobody_reacts_min: f32,
    ) -> Vec<Pair> {
        self.follow(forecasts, horizon_len);
        let mut pairs = Vec::new();
        self.judge(dt_s, |[place, earlier], signs, probability, at_m| {
            let [.., if_nobody_reacts] = signs.conflict;
            if if_nobody_reacts >= if_nobody_reacts_min {
                let (places, in_s) = ([earlier, place], signs.in_s);
                pairs.push(Pair { places, probability, if_nobody_reacts, in_s, at_m: at_m() });
            }
        });
        pairs
    }

    /// Takes the agents of the forecasts.
    fn follow<'a>(&mut self, forecasts: impl IntoIterator<Item = &'a Forecast>, horizon_len: usize) {
        self.places.clear();
        for (place, forecast) in forecasts.into_iter().enumerate() {
            let number = self.places.len();
            let follows = match self.agents.get_mut(number) {
                Some(agent) => agent.follow(forecast, horizon_len),
                None => Moving::of(forecast, horizon_len).map(|agent| self.agents.push(agent)).is_some(),
            };
            if follows {
                self.places.push(place);
            }
        }
    }

    /// Passes on each pair that comes near: its places, the later one first, its signs, its probability, and what
    /// computes its place.
    fn judge(&mut self, dt_s: f32, mut take: impl FnMut([usize; 2], &Signs, f32, &dyn Fn() -> [f32; 2])) {
        let agents = &self.agents[..self.places.len()];
        for (number, (agent, place)) in agents.iter().zip(&self.places).enumerate() {
            for (other, other_place) in agents[..number].iter().zip(&self.places) {
                let Some(signs) = Signs::of(agent, other, dt_s, &mut self.room) else { continue };
                let probability = self.odds.probability(&signs);
                take([*place, *other_place], &signs, probability, &|| self.room.meeting_m(agent, other));
            }
        }
    }
}

/// Inserts a conflict behind all that are at least as probable. The least probable one gives way.
fn insert(forecast: &mut Forecast, conflict: ForeseenConflict) {
    let len = forecast.conflicts_len as usize;
    let at = forecast.conflicts[..len].partition_point(|of| of.probability >= conflict.probability);
    if at < CONFLICTS_MAX {
        forecast.conflicts[at..].rotate_right(1);
        forecast.conflicts[at] = conflict;
        forecast.conflicts_len = (len + 1).min(CONFLICTS_MAX) as u32;
    }
}

#[cfg(test)]
mod tests {
    use wire::AgentType;

    use super::*;

    /// A pedestrian who walks straight on.
    fn walking(id: u64, at_m: [f32; 2], v_mps: [f32; 2]) -> Forecast {
        let mut forecast =
            Forecast { id, agent_type: AgentType::Pedestrian as u32, modes_len: 1, ..Forecast::default() };
        [forecast.x_m, forecast.y_m] = at_m;
        [forecast.vx_mps, forecast.vy_mps] = v_mps;
        forecast.heading_rad = v_mps[1].atan2(v_mps[0]);
        forecast.probability[0] = 1.0;
        for step in 0..12 {
            let in_s = (step + 1) as f32 * 0.4;
            forecast.modes[0][step] = [0, 1].map(|axis| at_m[axis] + in_s * v_mps[axis]);
        }
        forecast
    }

    fn others(forecast: &Forecast) -> Vec<u64> {
        forecast.conflicts[..forecast.conflicts_len as usize].iter().map(|of| of.other_id).collect()
    }

    #[test]
    fn both_of_a_pair_have_their_conflict() {
        let mut forecasts = [
            walking(7, [0.0, 0.0], [1.0, 0.0]),
            walking(8, [6.0, 0.2], [-1.0, 0.0]),
            walking(9, [0.0, 30.0], [1.0, 0.0]),
        ];
        forecasts[2].conflicts_len = 1;
        Finder::default().write(&mut forecasts, 12, 0.4);
        assert_eq!(forecasts.each_ref().map(others), [vec![8], vec![7], vec![]]);
        let conflict = forecasts[0].conflicts[0];
        assert_eq!(conflict.probability, forecasts[1].conflicts[0].probability);
        assert!((0.05..0.9).contains(&conflict.probability), "{conflict:?}");
        assert_eq!(conflict.if_nobody_reacts, 1.0);
        // 6 m apart, they close 2 m a second and touch at 0.6 m.
        assert!((conflict.in_s - 2.8).abs() < 1e-5, "{conflict:?}");
    }

    #[test]
    fn a_pair_has_its_time_and_the_place_between_both() {
        let forecasts = [
            walking(7, [0.0, 30.0], [1.0, 0.0]),
            walking(8, [0.0, 0.0], [1.0, 0.0]),
            walking(9, [6.0, 0.2], [-1.0, 0.0]),
        ];
        let mut finder = Finder::default();
        let pairs = finder.pairs(&forecasts, 12, 0.4, 0.1);
        let [pair] = pairs[..] else { panic!("{pairs:?}") };
        assert_eq!((pair.places, pair.if_nobody_reacts), ([1, 2], 1.0));
        assert!((pair.in_s - 2.8).abs() < 1e-5, "{pair:?}");
        assert!((pair.at_m[0] - 3.0).abs() < 1e-5 && (pair.at_m[1] - 0.1).abs() < 1e-5, "{pair:?}");
        assert!(finder.pairs(&forecasts, 12, 0.4, 1.1).is_empty());
    }

    #[test]
    fn the_most_probable_conflicts_remain_in_their_order() {
        let mut forecast = walking(1, [0.0; 2], [1.0, 0.0]);
        for (other_id, probability) in [(2, 0.2), (3, 0.5), (4, 0.2), (5, 0.1), (6, 0.9)] {
            insert(&mut forecast, ForeseenConflict { other_id, probability, ..Default::default() });
        }
        assert_eq!(others(&forecast), [6, 3]);
    }
}
