//! The worst ticks of a recording, for people who look for scenes to learn from.

use wire::Cause;

use crate::fleet::Outcome;

wire::named! {
    /// What makes a tick a bad one. A larger value is worse.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum Criterion {
        /// Final error of the single best forecast, m. Forecasts of young tracks are left out here and for the
        /// surprise: they announce that they know nothing.
        Error => "error",
        /// Negative logarithm of the forecast's density at the agent's place at the end of the horizon.
        Surprise => "surprise",
        /// Deceleration that avoids a contact with another agent, m/s².
        NearCollision => "near-collision",
    }
}

impl Criterion {
    fn value(self, of: &Outcome) -> Option<f64> {
        let errors = of.errors.filter(|_| of.cause != Cause::Young as u32);
        let value = match self {
            Self::Error => errors?.best.fde_m,
            Self::Surprise => errors?.nll,
            Self::NearCollision => f64::from(of.contact?.deceleration_mps2),
        };
        value.is_finite().then_some(value)
    }
}

/// A tick, with the agent that makes it a bad one.
#[derive(Clone, Debug, PartialEq)]
pub struct WorstTick {
    /// The reason.
    pub criterion: Criterion,
    /// Its value.
    pub value: f64,
    /// Number of the tick.
    pub seq: u64,
    /// Time of the tick.
    pub stamp_ns: i64,
    /// Identity of the agent in the recording.
    pub agent: u64,
    /// The agent that it nearly collides with.
    pub other: Option<u64>,
    /// Position of the agent.
    pub position_m: [f32; 2],
}

/// The `count` worst ticks by each criterion, the worst first. Ticks of one criterion are at least `apart_ns`
/// apart, so that each is another scene.
#[must_use]
pub fn worst(outcomes: &[Outcome], count: usize, apart_ns: u64) -> Vec<WorstTick> {
    let mut found = Vec::new();
    for criterion in Criterion::ALL {
        let mut ranked: Vec<(f64, &Outcome)> =
            outcomes.iter().filter_map(|of| Some((criterion.value(of)?, of))).collect();
        ranked.sort_by(|(a, of_a), (b, of_b)| {
            b.total_cmp(a).then((of_a.stamp_ns, of_a.agent).cmp(&(of_b.stamp_ns, of_b.agent)))
        });
        let begin = found.len();
        for (value, of) in ranked {
            if found.len() == begin + count {
                break;
            }
            let is_near = |other: &WorstTick| other.stamp_ns.abs_diff(of.stamp_ns) < apart_ns;
            if found[begin..].iter().any(is_near) {
                continue;
            }
            found.push(WorstTick {
                criterion,
                value,
                seq: of.seq,
                stamp_ns: of.stamp_ns,
                agent: of.agent,
                other: of.contact.map(|of| of.with).filter(|_| criterion == Criterion::NearCollision),
                position_m: of.position_m,
            });
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fleet::{Contact, OutcomeErrors};

    fn outcome(agent: u64, stamp_s: i64, fde_m: f64, deceleration_mps2: Option<f32>) -> Outcome {
        let example = Outcome::example(agent, stamp_s * 1_000_000_000, Some([0.5 * fde_m, fde_m]));
        let errors = example.errors.map(|errors| OutcomeErrors { nll: -fde_m, ..errors });
        let contact = |deceleration_mps2| Contact { with: 7, after_s: 1.0, deceleration_mps2 };
        Outcome {
            seq: stamp_s as u64,
            track: agent,
            errors,
            contact: deceleration_mps2.map(contact),
            ..example
        }
    }

    #[test]
    fn each_criterion_has_its_own_worst_ticks_which_are_apart() {
        let rows = [
            outcome(1, 0, 9.0, None),
            outcome(2, 1, 10.0, Some(2.0)),
            outcome(3, 8, 4.0, Some(8.0)),
            outcome(4, 20, 6.0, None),
            Outcome { cause: Cause::Young as u32, ..outcome(5, 40, 99.0, None) },
        ];
        let found = worst(&rows, 2, 5_000_000_000);
        let of = |criterion| {
            let ticks = found.iter().filter(move |tick| tick.criterion == criterion);
            ticks.map(|tick| (tick.agent, tick.value, tick.other)).collect::<Vec<_>>()
        };
        // The first agent's tick is the second worst, but it is the same scene.
        assert_eq!(of(Criterion::Error), [(2, 10.0, None), (4, 6.0, None)]);
        assert_eq!(of(Criterion::Surprise), [(3, -4.0, None), (4, -6.0, None)]);
        assert_eq!(of(Criterion::NearCollision), [(3, 8.0, Some(7)), (2, 2.0, Some(7))]);
    }
}
