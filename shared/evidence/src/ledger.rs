//! The pending forecasts, and the sums over the matured ones.

mod kept;
mod knowledge;
pub(crate) mod numbers;
mod pending;
#[cfg(test)]
mod tests;

use std::collections::{HashMap, VecDeque, hash_map};

use wire::{AGENT_TYPES, AGENTS_MAX, AgentType, EXPERTS_MAX, Expert, HORIZON_MAX, MODES_MAX, POSITION_MAX_M};

use self::kept::Kept;
pub use self::kept::Mixture;
use self::knowledge::{Knowledge, OfType};
use self::pending::Pending;
use crate::blend::Outcome;
use crate::choice::{BOTH_MAX, Choice};
use crate::due::{Matured, Waiting};
use crate::fan::{MIDDLES, centre_m};
use crate::paths::weighted_m;
use crate::width::Widths;
use crate::{BANDS, Context, ContextPrior, EXPERTS, Fan, KNOTS, Paths, Pattern, Prior, SLOTS, knots};

/// Time constant of the fading of evidence.
const FADING_S: f64 = 120.0;
/// Deviation of a true position at the first step; it grows with the square root of the steps.
const DEVIATION_M: f32 = 0.1;
/// An agent that was not observed for this many steps counts as a new agent.
const GAP_STEPS: i64 = 2;
/// Maximum number of agents that are followed at a time.
const TRACES_MAX: usize = 4 * AGENTS_MAX;
/// Maximum number of pending forecasts with stored mixtures, enough for all agents of a payload.
const MIXTURES_MAX: usize = AGENTS_MAX * (HORIZON_MAX + 1);
/// Exponent of [`Shares::decided`](crate::share::Shares::decided) for the fan's centre. A larger exponent
/// moves the centre more decidedly to the position whose fans have been nearest.
const MIDDLES_POWER: i32 = 4;

/// An agent at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Agent {
    /// Number, the same throughout a session.
    pub id: u64,
    /// Type.
    pub agent_type: AgentType,
    /// Speed.
    pub speed_mps: f32,
    /// Cosine and sine of its course.
    pub course: [f32; 2],
}

/// The position of an agent as the tracker estimates it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observed {
    /// Estimated position, m.
    pub position_m: [f32; 2],
    /// Covariance of the estimate as (xx, xy, yy), m².
    pub covariance_m2: [f32; 3],
}

impl Observed {
    /// Variance of the position in a direction, by the direction's cosine and sine.
    fn variance_m2(&self, [cos, sin]: [f32; 2]) -> f32 {
        let [xx, xy, yy] = self.covariance_m2;
        (cos * cos * xx + 2.0 * cos * sin * xy + sin * sin * yy).max(0.0)
    }

    /// One of four positions with equal probability. Their mean is `about_m`, and their covariance is that of
    /// the estimate.
    fn sigma_point(&self, about_m: [f32; 2], number: usize) -> [f32; 2] {
        let [xx, xy, yy] = self.covariance_m2;
        let first = xx.max(0.0).sqrt();
        let slope = if first > 0.0 { xy / first } else { 0.0 };
        let root = [[first, slope], [0.0, (yy - slope * slope).max(0.0).sqrt()]][number % 2];
        let sign = if number < 2 { std::f32::consts::SQRT_2 } else { -std::f32::consts::SQRT_2 };
        [0, 1].map(|axis| about_m[axis] + sign * root[axis])
    }
}

/// The last observation of an agent, and its pending forecasts.
#[derive(Clone, Debug)]
struct Trace {
    stamp_ns: i64,
    position_m: [f32; 2],
    pending: VecDeque<Pending>,
}

/// Evidence of all agents: see the [crate](crate).
#[derive(Clone, Debug)]
pub struct Evidence {
    horizon_len: usize,
    step_ns: i64,
    /// Step index of each knot.
    knots: [usize; KNOTS],
    known: [[Knowledge; BANDS]; 3],
    of_types: [OfType; 3],
    traces: HashMap<u64, Trace>,
    spare: Vec<VecDeque<Pending>>,
    mixtures: Vec<Kept>,
    free: Vec<usize>,
    waiting: Waiting,
    now_ns: i64,
}

impl Evidence {
    /// State before any forecast, for forecasts of `horizon_len` steps of `step_ns`.
    ///
    /// # Panics
    /// If a forecast has no step or more steps than a payload holds.
    #[must_use]
    pub fn new(horizon_len: usize, step_ns: u64, prior: &Prior) -> Self {
        assert!((1..=HORIZON_MAX).contains(&horizon_len), "horizon of {horizon_len} steps");
        let of_types = [OfType::new(); 3];
        Self {
            horizon_len,
            step_ns: step_ns.cast_signed().max(1),
            knots: knots(horizon_len),
            known: AGENT_TYPES.map(|agent_type| {
                let of_type = agent_type.index();
                let known = of_types[of_type].familiarity.probability();
                std::array::from_fn(|band| Knowledge::new(agent_type, &prior.0[of_type][band], known))
            }),
            of_types,
            traces: HashMap::with_capacity(2 * TRACES_MAX),
            spare: (0..TRACES_MAX).map(|_| VecDeque::with_capacity(horizon_len + 1)).collect(),
            mixtures: vec![Kept::empty(); MIXTURES_MAX],
            free: (0..MIXTURES_MAX).collect(),
            waiting: Waiting::new(),
            now_ns: i64::MIN,
        }
    }

    /// Ends a session. Learned state remains, time restarts, and all later agents are new.
    pub fn end_session(&mut self) {
        let Self { traces, spare, free, .. } = self;
        for (_, trace) in traces.drain() {
            release(trace, spare, free);
        }
        self.waiting.clear();
        self.now_ns = i64::MIN;
    }

    /// Records the positions of agents at a time, and learns from the forecasts that mature. `level` returns
    /// the level, 0 to 1, of the region whose border contains the truth. The elapsed time limits the number
    /// of its calls. A time that is not newer than the last is ignored.
    ///
    /// The truth is known with the covariance of its estimate. The variance adds to the squared residuals,
    /// and levels are those of [sigma points](https://doi.org/10.1109/JPROC.2003.823141) of the estimate.
    pub fn observe_with(
        &mut self,
        now_ns: i64,
        agents: impl IntoIterator<Item = (u64, Observed)>,
        mut level: impl FnMut(Matured<'_>) -> f64,
    ) {
        if now_ns <= self.now_ns {
            return;
        }
        let passed_s = match self.now_ns {
            i64::MIN => 0.0,
            before_ns => now_ns.saturating_sub(before_ns) as f64 * 1e-9,
        };
        self.now_ns = now_ns;
        let kept = (-passed_s / FADING_S).exp();
        let horizon_s = (self.step_ns * self.horizon_len as i64) as f64 * 1e-9;
        let under_way = (-passed_s / horizon_s).exp();
        for knowledge in self.known.as_flattened_mut() {
            knowledge.discount(kept);
        }
        self.of_types.iter_mut().for_each(|of_type| of_type.discount(passed_s, kept, under_way));
        let gap_ns = self.step_ns * GAP_STEPS;
        let Self { traces, spare, free, .. } = self;
        for (_, trace) in traces.extract_if(|_, trace| now_ns - trace.stamp_ns > gap_ns) {
            release(trace, spare, free);
        }
        for (id, observed) in agents {
            self.observe_one(id, &observed);
        }
        for due in self.waiting.take(passed_s) {
            let level = level(due.matured());
            if level.is_finite() {
                let agent_type = due.context.agent_type.index();
                self.of_types[agent_type].corrections[due.knot].add(level);
                for (band, share) in due.context.bands().into_iter().filter(|(_, share)| *share > 0.0) {
                    self.known[agent_type][band].widths[due.knot].add(level, due.factor, share);
                }
            }
        }
        for (of_type, known) in self.of_types.iter_mut().zip(&mut self.known) {
            if std::mem::take(&mut of_type.is_stale) {
                let probability = of_type.familiarity.probability();
                known.iter_mut().for_each(|knowledge| knowledge.solve(probability));
            }
        }
    }

    /// As [`Evidence::observe_with`], without levels.
    pub fn observe(&mut self, now_ns: i64, agents: impl IntoIterator<Item = (u64, Observed)>) {
        self.observe_with(now_ns, agents, |_| f64::NAN);
    }

    fn observe_one(&mut self, id: u64, observed: &Observed) {
        let position_m = observed.position_m;
        let Self { now_ns, step_ns, knots, known, of_types, mixtures, free, waiting, .. } = self;
        let (now_ns, step_ns) = (*now_ns, *step_ns);
        let trace = match self.traces.entry(id) {
            hash_map::Entry::Occupied(known) => known.into_mut(),
            hash_map::Entry::Vacant(new) => {
                let Some(pending) = self.spare.pop() else { return };
                new.insert(Trace { stamp_ns: now_ns, position_m, pending })
            }
        };
        let (since_ns, from_m) = (trace.stamp_ns, trace.position_m);
        (trace.stamp_ns, trace.position_m) = (now_ns, position_m);
        trace.pending.retain_mut(|pending| {
            while pending.matured_count < KNOTS {
                let knot = pending.matured_count;
                let due_ns = pending.stamp_ns + step_ns * (knots[knot] as i64 + 1);
                if due_ns > now_ns {
                    return true;
                }
                let share = (due_ns - since_ns) as f32 / (now_ns - since_ns).max(1) as f32;
                let truth_m = [0, 1].map(|axis| from_m[axis] + share * (position_m[axis] - from_m[axis]));
                pending.matured_count += 1;
                let agent_type = pending.context.agent_type.index();
                let (at_speeds, of_type) = (&mut known[agent_type], &mut of_types[agent_type]);
                of_type.is_stale = true;
                let velocity_m = pending.velocity_m[knot];
                let taken_m = [0, 1].map(|axis| truth_m[axis] - velocity_m[axis]);
                let [cos, sin] = pending.course;
                let variances_m2 = [[cos, sin], [-sin, cos]].map(|direction| observed.variance_m2(direction));
                let mean_m2 = 0.5 * (variances_m2[0] + variances_m2[1]);
                let deviation_m = (DEVIATION_M.powi(2) * (knots[knot] + 1) as f32 + mean_m2).sqrt();
                of_type.familiarity.add(pending.network_nearer(knot, taken_m, deviation_m, at_speeds));
                if let Some(place) = pending.mixture {
                    mixtures[place].add_distances(knot, truth_m);
                    let sample_m = observed.sigma_point(truth_m, waiting.any_of_four());
                    waiting.push(mixtures[place].due(pending.context, knot, sample_m));
                }
                let [x, y] = [0, 1].map(|axis| truth_m[axis] - pending.centre_m[knot][axis]);
                let residual_m = [x * cos + y * sin, y * cos - x * sin];
                pending.residuals_m[knot] = residual_m;
                let of_modes = pending.mixture.filter(|_| pending.matured_count == KNOTS).map(|place| {
                    let kept = &mixtures[place];
                    (kept.nearest_m(), kept.nearest_of_fan(&pending.residuals_m))
                });
                for (band, share) in pending.context.bands() {
                    let knowledge = &mut at_speeds[band];
                    if share > 0.0 {
                        let [along_m, across_m] = knowledge.deviations_m(knot);
                        let outcome = Outcome {
                            experts_m: &pending.experts_m[knot],
                            regression_m: pending.regression_m[knot],
                            truth_m: taken_m,
                            typical_m: along_m.hypot(across_m),
                            deviation_m,
                        };
                        knowledge.blend[knot].add(&outcome, share);
                        knowledge.add_residual(knot, residual_m, variances_m2, deviation_m, share);
                        if let Some(((of_sets_m, of_middles_m), _)) = &of_modes {
                            knowledge.sets.add(&mut of_type.sets, *of_sets_m, share);
                            knowledge.of_middles.add(of_middles_m, share);
                        }
                    }
                }
                if let Some((_, (number, units))) = of_modes {
                    at_speeds[pending.context.nearest()].pattern.add(number, &units);
                }
            }
            free.extend(pending.mixture.take());
            false
        });
    }

    /// Stores the forecast of a just observed agent until it matures, at most one per step.
    ///
    /// `blend_m` is the published blend. A forecast is ignored if one of its experts leaves the world.
    pub fn store(
        &mut self,
        stamp_ns: i64,
        agent: &Agent,
        (paths, blend_m): (&Paths, &[[f32; 2]; HORIZON_MAX]),
        mixture: Option<Mixture<'_>>,
    ) {
        if !self.wants(stamp_ns, agent.id) {
            return;
        }
        let Some(trace) = self.traces.get_mut(&agent.id) else { return };
        let (knots, context) = (self.knots, Context::new(agent.agent_type, agent.speed_mps));
        let of_type = &self.known[agent.agent_type.index()];
        let velocity_m = knots.map(|step| paths.velocity[step]);
        let centre = |reach: f32| knots.map(|step| centre_m(reach, paths.velocity[step], blend_m[step]));
        let centre_m = centre(reach(of_type, &context));
        let middles_m = MIDDLES.map(centre);
        let experts_m = knots.map(|step| paths.differences_m(step));
        let is_in_the_world = |x_m: &f32| x_m.abs() <= POSITION_MAX_M;
        if !experts_m.as_flattened().as_flattened().iter().all(is_in_the_world) {
            return;
        }
        let mixture = mixture.and_then(|mixture| {
            let place = self.free.pop()?;
            let corrections = self.of_types[agent.agent_type.index()].corrections.map(|of| of.log());
            self.mixtures[place].fill(knots, &mixture, &centre_m, &middles_m, &corrections);
            Some(place)
        });
        let regression_m = std::array::from_fn(|knot| {
            let weights = context.between(|band| *of_type[band].blend[knot].regression());
            weighted_m(&weights, &experts_m[knot])
        });
        trace.pending.push_back(Pending {
            stamp_ns,
            context,
            matured_count: 0,
            velocity_m,
            centre_m,
            regression_m,
            course: agent.course,
            residuals_m: [[0.0; 2]; KNOTS],
            experts_m,
            mixture,
        });
    }

    /// Whether a forecast of an agent would be stored.
    fn wants(&self, stamp_ns: i64, agent: u64) -> bool {
        self.traces.get(&agent).is_some_and(|trace| {
            let newest_ns = trace.pending.back().map(|pending| pending.stamp_ns);
            trace.stamp_ns == stamp_ns
                && newest_ns.is_none_or(|newest_ns| stamp_ns >= newest_ns.saturating_add(self.step_ns))
                && trace.pending.len() <= self.horizon_len
        })
    }

    /// The modes of an agent from the deviations of similar agents. Their centre is between constant velocity
    /// and the blend.
    #[must_use]
    pub fn fan(
        &self,
        agent: &Agent,
        velocity_m: &[[f32; 2]; HORIZON_MAX],
        blend_m: &[[f32; 2]; HORIZON_MAX],
    ) -> Fan {
        let context = Context::new(agent.agent_type, agent.speed_mps);
        let of_type = &self.known[agent.agent_type.index()];
        let at_knots: [[f32; 2]; KNOTS] =
            std::array::from_fn(|knot| context.between(|band| of_type[band].deviations_m(knot)));
        // Points with the same number at two speeds are unrelated.
        let pattern = &of_type[context.nearest()].pattern;
        let probability = pattern.probability();
        let mut numbers: [u8; MODES_MAX] = std::array::from_fn(|number| number as u8);
        let of = |number: &u8| probability[usize::from(*number)];
        numbers.sort_unstable_by(|a, b| of(b).total_cmp(&of(a)).then(a.cmp(b)));
        let points = numbers.map(|number| self.between_knots(&pattern.points()[usize::from(number)]));
        let probability = numbers.map(|number| of(&number));
        let reach = reach(of_type, &context);
        let centre_m = std::array::from_fn(|step| centre_m(reach, velocity_m[step], blend_m[step]));
        Fan {
            centre_m,
            steps_m: self.between_knots(&at_knots),
            course: agent.course,
            points,
            probability,
            numbers,
        }
    }

    /// Selects from the network's modes and the fan as many modes as the network has.
    ///
    /// The more often a set has had the nearest mode of similar agents, the more probable are its modes.
    ///
    /// # Panics
    /// If the number of probabilities differs from the number of modes.
    #[must_use]
    pub fn choose(
        &self,
        agent: &Agent,
        (network_m, probability): (&[[[f32; 2]; HORIZON_MAX]], &[f32]),
        fan: &Fan,
    ) -> Choice {
        let (knots, len) = (self.knots, network_m.len());
        let mut modes_m = [[[0.0; 2]; KNOTS]; BOTH_MAX];
        for (mode, network_m) in network_m.iter().enumerate() {
            modes_m[mode] = knots.map(|step| network_m[step]);
            modes_m[len + mode] = knots.map(|step| fan.position_m(mode, step));
        }
        let context = Context::new(agent.agent_type, agent.speed_mps);
        let agent_type = agent.agent_type.index();
        let (at_speeds, of_type) = (&self.known[agent_type], &self.of_types[agent_type]);
        let shares = context.between(|band| of_type.sets.probability(&at_speeds[band].sets));
        let mut of_both = [0.0; BOTH_MAX];
        let (of_network, of_fan) = of_both[..2 * len].split_at_mut(len);
        of_network.copy_from_slice(probability);
        of_fan.copy_from_slice(&fan.probability[..len]);
        for (of_set, set_share) in [of_network, of_fan].into_iter().zip(shares) {
            let sum = of_set.iter().sum::<f32>().max(f32::MIN_POSITIVE);
            of_set.iter_mut().for_each(|p| *p *= set_share / sum);
        }
        Choice::new(&modes_m[..2 * len], of_both)
    }

    /// The experts' weights at each step of the horizon, in the order of [`SLOTS`]. Constant velocity has the
    /// rest.
    #[must_use]
    pub fn weights(&self, agent_type: AgentType, speed_mps: f32) -> [[f32; EXPERTS]; HORIZON_MAX] {
        let context = Context::new(agent_type, speed_mps);
        let of_type = &self.known[agent_type.index()];
        let at_knots: [[f32; EXPERTS]; KNOTS] =
            std::array::from_fn(|knot| context.between(|band| *of_type[band].blend[knot].weights()));
        self.between_knots(&at_knots)
    }

    /// The factors by which the regions widen at each step of the horizon.
    #[must_use]
    pub fn widths(&self, agent_type: AgentType, speed_mps: f32) -> [f32; HORIZON_MAX] {
        let context = Context::new(agent_type, speed_mps);
        let (at_speeds, of_type) = (&self.known[agent_type.index()], &self.of_types[agent_type.index()]);
        let at_knots: [[f32; 1]; KNOTS] = std::array::from_fn(|knot| {
            let [log] = context.between(|band| [at_speeds[band].widths[knot].log()]);
            [log + of_type.corrections[knot].log()]
        });
        self.between_knots(&at_knots).map(|[log]| log.exp())
    }

    /// Writes the blend of the paths.
    pub fn blend(&self, weights: &[[f32; EXPERTS]; HORIZON_MAX], paths: &Paths, out: &mut [[f32; 2]]) {
        for (step, out) in out.iter_mut().enumerate() {
            let weighted_m = weighted_m(&weights[step], &paths.differences_m(step));
            *out = [0, 1].map(|axis| paths.velocity[step][axis] + weighted_m[axis]);
        }
    }

    /// The mean weights over the horizon by the slots of the wire, including constant velocity's.
    #[must_use]
    pub fn slots(&self, weights: &[[f32; EXPERTS]; HORIZON_MAX]) -> [f32; EXPERTS_MAX] {
        let mut slots = [0.0; EXPERTS_MAX];
        let steps = &weights[..self.horizon_len];
        for (expert, slot) in SLOTS.iter().enumerate() {
            let sum: f32 = steps.iter().map(|weights| weights[expert]).sum();
            slots[*slot as usize] = sum / self.horizon_len as f32;
        }
        slots[Expert::ConstantVelocity as usize] = (1.0 - slots.iter().sum::<f32>()).max(0.0);
        slots
    }

    /// The learned statistics per forecast, as a prior for other roads. The current prior and the pattern are
    /// left out; contexts with fewer than `len_min` forecasts are empty.
    #[must_use]
    pub fn as_prior(&self, len_min: f64) -> Prior {
        Prior(self.known.each_ref().map(|of_type| {
            of_type.each_ref().map(|knowledge| ContextPrior {
                blend: knowledge.blend.each_ref().map(|blend| blend.as_prior(len_min)),
                log_width: knowledge.widths.each_ref().map(Widths::log),
                deviation_m: std::array::from_fn(|knot| knowledge.deviations_m(knot)),
                network_share: knowledge.sets.network_share(),
                pattern: Pattern::default(),
            })
        }))
    }

    /// Interpolates a quantity between the knots, linear in the step.
    fn between_knots<const N: usize>(&self, at_knots: &[[f32; N]; KNOTS]) -> [[f32; N]; HORIZON_MAX] {
        let knots = &self.knots;
        std::array::from_fn(|step| {
            let next = knots.iter().position(|&knot| knot >= step).unwrap_or(KNOTS - 1);
            let before = next.saturating_sub(1);
            let width = (knots[next] - knots[before]).max(1) as f32;
            let share = (step.min(knots[next]) - knots[before].min(step)) as f32 / width;
            std::array::from_fn(|i| {
                at_knots[before][i] + share.min(1.0) * (at_knots[next][i] - at_knots[before][i])
            })
        })
    }
}

/// The position of a type's fan between constant velocity and the blend: among its [`MIDDLES`], weighted by
/// how often each has been the nearest.
fn reach(of_type: &[Knowledge; BANDS], context: &Context) -> f32 {
    let shares = context.between(|band| of_type[band].of_middles.decided(MIDDLES_POWER));
    shares.iter().zip(MIDDLES).map(|(share, reach)| share * reach).sum()
}

/// Frees the resources of a trace.
fn release(mut trace: Trace, spare: &mut Vec<VecDeque<Pending>>, free: &mut Vec<usize>) {
    free.extend(trace.pending.drain(..).filter_map(|pending| pending.mixture));
    spare.push(trace.pending);
}
