//! The forecasts of two builds, or with two weights, beside each other.

use std::collections::BTreeMap;

use metrics::Errors;
use scene::AgentType;
use wire::AGENT_TYPES;

use crate::fleet::Outcome;

/// Forecasts that are at most this far apart are the same: 0.1 mm.
const SAME_M: f64 = 1e-4;

/// The forecasts of an agent at a tick by two builds or with two weights.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// Time of the tick.
    pub stamp_ns: i64,
    /// Identity of the agent in the recording, or else its track.
    pub agent: u64,
    /// Type of the agent.
    pub agent_type: AgentType,
    /// Mean distance of the two single best forecasts over the steps that both have.
    pub apart_m: f64,
    /// Errors of the earlier and of the other forecast, if the recording shows them.
    pub errors: Option<[Errors; 2]>,
}

/// The forecasts of one type by two builds, in numbers that add up over recordings.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct DifferenceCounts {
    /// Pairs of forecasts.
    pub forecasts: u64,
    /// Pairs that differ by more than 0.1 mm.
    pub different: u64,
    /// Greatest mean distance of a pair.
    pub farthest_m: f64,
    /// Pairs of which the recording shows the errors.
    pub matured: u64,
    /// Pairs whose later forecast has a smaller ADE.
    pub better: u64,
    /// Pairs whose later forecast has a greater ADE.
    pub worse: u64,
    /// Sums of ADE and FDE over the matured pairs, of the earlier forecasts.
    pub before_m: [f64; 2],
    /// The same of the later forecasts.
    pub after_m: [f64; 2],
}

/// Counts pairs by the type of the agent, by its name.
#[must_use]
pub fn count_differences(differences: &[Difference]) -> BTreeMap<&'static str, DifferenceCounts> {
    let of_type = |agent_type: AgentType| {
        let mut counts = DifferenceCounts::default();
        for of in differences.iter().filter(|of| of.agent_type == agent_type) {
            counts.forecasts += 1;
            counts.different += u64::from(of.apart_m > SAME_M);
            counts.farthest_m = counts.farthest_m.max(of.apart_m);
            let Some([before, after]) = of.errors else { continue };
            counts.matured += 1;
            counts.better += u64::from(after.ade_m < before.ade_m);
            counts.worse += u64::from(after.ade_m > before.ade_m);
            for (sums, errors) in [(&mut counts.before_m, before), (&mut counts.after_m, after)] {
                *sums = [sums[0] + errors.ade_m, sums[1] + errors.fde_m];
            }
        }
        counts
    };
    AGENT_TYPES.iter().map(|agent_type| (agent_type.name(), of_type(*agent_type))).collect()
}

/// Pairs forecasts by tick and agent. Also returns the number of forecasts that only one side has.
#[must_use]
pub fn differences(before: &[Outcome], after: &[Outcome]) -> (Vec<Difference>, [u64; 2]) {
    let key = |of: &Outcome| (of.stamp_ns, if of.agent == 0 { of.track } else { of.agent });
    let mut of_before: BTreeMap<(i64, u64), &Outcome> = before.iter().map(|of| (key(of), of)).collect();
    let mut only_after = 0;
    let mut found = Vec::new();
    for b in after {
        let Some(a) = of_before.remove(&key(b)) else {
            only_after += 1;
            continue;
        };
        let distances = a
            .best_m
            .iter()
            .zip(&b.best_m)
            .map(|([ax, ay], [bx, by])| f64::from(bx - ax).hypot(f64::from(by - ay)));
        let (sum, len) = distances.fold((0.0, 0_u32), |(sum, len), distance_m| (sum + distance_m, len + 1));
        found.push(Difference {
            stamp_ns: b.stamp_ns,
            agent: key(b).1,
            agent_type: b.agent_type,
            apart_m: sum / f64::from(len.max(1)),
            errors: a.errors.zip(b.errors).map(|(a, b)| [a.best, b.best]),
        });
    }
    (found, [of_before.len() as u64, only_after])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outcome(agent: u64, stamp_ns: i64, x_m: f32, ade_m: Option<f64>) -> Outcome {
        let errors = ade_m.map(|ade_m| [ade_m, 2.0 * ade_m]);
        Outcome { best_m: vec![[x_m, 0.0]; 3], ..Outcome::example(agent, stamp_ns, errors) }
    }

    #[test]
    fn pairs_by_tick_and_agent_are_counted_once() {
        let before = [
            outcome(1, 0, 1.0, Some(1.0)),
            outcome(2, 0, 5.0, Some(0.5)),
            outcome(1, 80, 1.0, None),
            outcome(3, 80, 0.0, None),
        ];
        let after =
            [outcome(2, 0, 8.0, Some(0.75)), outcome(1, 0, 1.0, Some(1.0)), outcome(1, 80, 1.5, None)];
        let (found, alone) = differences(&before, &after);
        assert_eq!((found.len(), alone), (3, [1, 0]));
        let counts = count_differences(&found);
        assert_eq!(
            counts["vehicle"],
            DifferenceCounts {
                forecasts: 3,
                different: 2,
                farthest_m: 3.0,
                matured: 2,
                better: 0,
                worse: 1,
                before_m: [1.5, 3.0],
                after_m: [1.75, 3.5],
            }
        );
        assert_eq!(counts["pedestrian"], DifferenceCounts::default());
    }
}
