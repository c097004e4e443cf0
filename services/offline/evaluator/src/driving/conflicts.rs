//! Conflicts: how well forecasts foretell the pairs of agents that come too close within the horizon.

use conflicts::{Body, CONFLICT_M, Moving, Odds, Outline, Room, SIGNS, Signs, are_judged};
use wire::Forecast;

/// Width of the logistic function that softens the bound of a conflict for independent modes.
const SOFT_M: f32 = 0.5;
/// Time between two looks at all pairs.
pub(crate) const EVERY_NS: i64 = 800_000_000;
/// Recall at which false alarms are counted.
pub(crate) const RECALL: f64 = 0.6;

/// What foretells conflicts.
pub(crate) const FORETELLERS: [&str; 4] =
    ["constant velocity", "single best", "independent modes", "published probability"];

/// A pair of agents at a time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pair {
    /// Time until the conflict, s; `None` without one.
    pub(crate) conflict_s: Option<f32>,
    /// The score by each of [`FORETELLERS`]: larger means that a conflict is more likely.
    pub(crate) scores: [f32; FORETELLERS.len()],
    /// What the forecasts say; `None` if no modes come near one another.
    pub(crate) signs: Option<[f32; SIGNS]>,
}

/// An agent whose future is known.
pub(crate) struct Known<'a> {
    pub(crate) forecast: &'a Forecast,
    /// Its position at each step.
    pub(crate) truth_m: Vec<[f32; 2]>,
}

/// All pairs of a tick.
pub(crate) fn pairs(agents: &[Known<'_>], dt_s: f32, odds: &Odds, out: &mut Vec<Pair>) {
    let drawn: Vec<Drawn> = agents.iter().filter_map(|agent| Drawn::new(agent, dt_s)).collect();
    let mut room = Box::<Room>::default();
    for (number, a) in drawn.iter().enumerate() {
        for b in &drawn[..number] {
            if !are_judged(&a.moving, &b.moving) {
                continue;
            }
            let (truth_m, step) = a.truth.gap(&b.truth);
            let signs = Signs::of(&a.moving, &b.moving, dt_s, &mut room);
            out.push(Pair {
                conflict_s: (truth_m < CONFLICT_M).then_some((step + 1) as f32 * dt_s),
                scores: [
                    -a.steady.gap(&b.steady).0,
                    -a.best.gap(&b.best).0,
                    of_modes(a, b),
                    signs.map_or(0.0, |signs| odds.probability(&signs)),
                ],
                signs: signs.map(|signs| signs.numbers()),
            });
        }
    }
}

/// The probability of a conflict by independent modes.
fn of_modes(a: &Drawn, b: &Drawn) -> f32 {
    let mut sum = 0.0;
    for (mode_a, p_a) in &a.modes {
        for (mode_b, p_b) in &b.modes {
            sum += p_a * p_b / (1.0 + ((mode_a.gap(mode_b).0 - CONFLICT_M) / SOFT_M).exp());
        }
    }
    sum
}

/// The outlines of an agent.
struct Drawn {
    truth: Outline,
    steady: Outline,
    best: Outline,
    modes: Vec<(Outline, f32)>,
    moving: Moving,
}

impl Drawn {
    fn new(agent: &Known<'_>, dt_s: f32) -> Option<Self> {
        let Known { forecast, truth_m } = agent;
        let (body, len) = (Body::of(forecast)?, truth_m.len());
        let [vx_mps, vy_mps] = [forecast.vx_mps, forecast.vy_mps];
        let steady: Vec<[f32; 2]> = (1..=len)
            .map(|step| step as f32 * dt_s)
            .map(|in_s| [forecast.x_m + in_s * vx_mps, forecast.y_m + in_s * vy_mps])
            .collect();
        let modes = forecast.modes[..forecast.modes_len as usize].iter().zip(&forecast.probability);
        Some(Self {
            truth: body.along([&truth_m[..]]),
            steady: body.along([&steady[..]]),
            best: body.along([&forecast.best[..len]]),
            modes: modes.map(|(mode, p)| (body.along([&mode[..len]]), *p)).collect(),
            moving: Moving::of(forecast, len)?,
        })
    }
}

/// How well a score foretells the conflicts of pairs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Foretold {
    pub(crate) average_precision: f64,
    /// Precision at [`RECALL`].
    pub(crate) precision: f64,
    /// False alarms at [`RECALL`].
    pub(crate) false_alarms: usize,
    /// Mean time from an alarm to its conflict at [`RECALL`], s.
    pub(crate) ahead_s: f64,
}

/// The mean of the precision over the conflicts, in the order of the scores.
fn average_precision(is_conflict: &[bool]) -> f64 {
    let (mut found, mut sum) = (0.0, 0.0);
    for (before, _) in is_conflict.iter().enumerate().filter(|(_, is)| **is) {
        found += 1.0;
        sum += found / (before + 1) as f64;
    }
    sum / found
}

impl Foretold {
    /// `None` without a conflict.
    pub(crate) fn of(pairs: &[Pair], foreteller: usize) -> Option<Self> {
        let mut sorted: Vec<&Pair> = pairs.iter().collect();
        sorted.sort_by(|a, b| b.scores[foreteller].total_cmp(&a.scores[foreteller]));
        let is_conflict: Vec<bool> = sorted.iter().map(|pair| pair.conflict_s.is_some()).collect();
        let conflict_count = is_conflict.iter().filter(|is| **is).count();
        let enough = (RECALL * conflict_count as f64).ceil() as usize;
        if enough == 0 {
            return None;
        }
        let mut found = 0;
        let alarms = is_conflict.iter().take_while(|is| {
            let goes_on = found < enough;
            found += usize::from(**is && goes_on);
            goes_on
        });
        let alarm_count = alarms.count();
        let times = sorted[..alarm_count].iter().filter_map(|pair| pair.conflict_s.map(f64::from));
        Some(Self {
            average_precision: average_precision(&is_conflict),
            precision: enough as f64 / alarm_count as f64,
            false_alarms: alarm_count - enough,
            ahead_s: times.sum::<f64>() / enough as f64,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn alarms_count_up_to_the_recall() {
        let pair = |score: f32, conflict_s: Option<f32>| Pair {
            conflict_s,
            scores: [score; FORETELLERS.len()],
            signs: None,
        };
        let pairs = [
            pair(0.9, None),
            pair(0.8, Some(2.0)),
            pair(0.7, None),
            pair(0.6, Some(4.0)),
            pair(0.1, Some(1.0)),
        ];
        let foretold = Foretold::of(&pairs, 0).expect("conflicts");
        assert_eq!(foretold.false_alarms, 2);
        assert_eq!((foretold.precision, foretold.ahead_s), (0.5, 3.0));
        let expected = (1.0 / 2.0 + 2.0 / 4.0 + 3.0 / 5.0) / 3.0;
        assert!((foretold.average_precision - expected).abs() < 1e-12, "{foretold:?}");
        assert_eq!(Foretold::of(&pairs[..1], 0), None);
    }
}
