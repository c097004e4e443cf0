//! The learned state of one agent type at one speed.

use wire::AgentType;

use crate::blend::{Blend, Caution};
use crate::familiarity::Familiarity;
use crate::fan::{LearnedPattern, MIDDLES};
use crate::sets::{SetsAtSpeed, SetsOfType};
use crate::share::Shares;
use crate::width::{Correction, Widths};
use crate::{ContextPrior, KNOTS, OUTLIER, fading};

/// Weight of the prior, in deviations.
const DEVIATIONS_LEN: f64 = 10.0;
/// Initial shares of the forecasts for which the fan about each of the [`MIDDLES`] is the nearest.
const ABOUT_MIDDLES: [f32; MIDDLES.len()] = [0.25, 0.5, 0.25];
/// Weight of these shares, in forecasts.
const MIDDLES_LEN: f64 = 20.0;

/// The learned state of one type at one speed.
#[derive(Clone, Debug)]
pub(super) struct Knowledge {
    pub(super) blend: [Blend; KNOTS],
    pub(super) widths: [Widths; KNOTS],
    /// Sums of squares along and across the course, m², and their count.
    pub(super) squares: [([f64; 2], f64); KNOTS],
    /// How often the network and the fan had the nearest mode.
    pub(super) sets: SetsAtSpeed,
    /// How often the fan about each of the [`MIDDLES`] was the nearest.
    pub(super) of_middles: Shares<{ MIDDLES.len() }>,
    pub(super) pattern: LearnedPattern,
}

impl Knowledge {
    /// State before any forecast. The network knows the road with probability `known`.
    pub(super) fn new(agent_type: AgentType, prior: &ContextPrior, known: f64) -> Self {
        let widths = prior.log_width.map(|log| Widths::new(log.exp()));
        let caution = Caution::of(agent_type);
        let blend = prior.blend.each_ref().map(|prior| Blend::new(caution, prior, known));
        let squares = prior.deviation_m.map(|deviations| {
            (deviations.map(|deviation_m| DEVIATIONS_LEN * f64::from(deviation_m).powi(2)), DEVIATIONS_LEN)
        });
        let sets = SetsAtSpeed::new(prior.network_share);
        let of_middles = Shares::new(ABOUT_MIDDLES, MIDDLES_LEN);
        let pattern = LearnedPattern::new(&prior.pattern);
        Self { blend, widths, squares, sets, of_middles, pattern }
    }

    pub(super) fn discount(&mut self, kept: f64) {
        self.blend.iter_mut().for_each(|blend| blend.discount(kept));
        self.widths.iter_mut().for_each(|widths| widths.discount(kept));
        for (squares, len) in &mut self.squares {
            let kept = fading(kept, *len);
            squares.iter_mut().chain([len]).for_each(|sum| *sum *= kept);
        }
        self.sets.discount(kept);
        self.of_middles.discount(kept);
        self.pattern.discount(kept as f32);
    }

    /// Deviations from the fan's centre at a knot, m.
    pub(super) fn deviations_m(&self, knot: usize) -> [f32; 2] {
        let (squares, len) = self.squares[knot];
        squares.map(|sum| (sum / len).sqrt() as f32)
    }

    pub(super) fn solve(&mut self, known: f64) {
        self.blend.iter_mut().for_each(|blend| blend.solve(known));
    }

    /// Adds a residual at a knot along and across the course, clipped to [`OUTLIER`] deviations. The truth has
    /// these variances.
    pub(super) fn add_residual(
        &mut self,
        knot: usize,
        residual_m: [f32; 2],
        variances_m2: [f32; 2],
        floor_m: f32,
        weight: f32,
    ) {
        let deviations_m = self.deviations_m(knot);
        let (squares, len) = &mut self.squares[knot];
        for axis in 0..2 {
            let most_m = OUTLIER * deviations_m[axis].max(floor_m);
            let residual_m = residual_m[axis].clamp(-most_m, most_m);
            squares[axis] += f64::from(weight * (residual_m * residual_m + variances_m2[axis]));
        }
        *len += f64::from(weight);
    }
}

/// The learned state of one type at all speeds.
#[derive(Clone, Copy, Debug)]
pub(super) struct OfType {
    pub(super) familiarity: Familiarity,
    pub(super) sets: SetsOfType,
    pub(super) corrections: [Correction; KNOTS],
    /// Whether a forecast has matured since the experts' weights were computed.
    pub(super) is_stale: bool,
}

impl OfType {
    pub(super) const fn new() -> Self {
        Self {
            familiarity: Familiarity::new(),
            sets: SetsOfType::new(),
            corrections: [Correction::new(); KNOTS],
            is_stale: false,
        }
    }

    pub(super) fn discount(&mut self, passed_s: f64, kept: f64, under_way: f64) {
        self.sets.discount(kept);
        self.corrections.iter_mut().for_each(|correction| correction.discount(passed_s, under_way));
    }
}
