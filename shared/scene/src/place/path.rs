use wire::HORIZON_MAX;

use super::Gait;
use crate::AgentFrame;
use crate::motion::wrapped;

/// Chords shorter than this have no direction.
const CHORD_MIN_M: f32 = 0.5;
/// Departures are taken to be no larger: of who drives speed m/s, curvature 1/m; of who walks x and y of a step, m.
pub(super) const DEPARTURE_MAX: [[f32; 2]; 2] = [[6.0, 0.2], [2.0, 2.0]];

/// What of the skill lasts from one departure to the next: about the last thousand count.
const LASTING: f32 = 0.999;
/// ρ: so much has to be told before it counts, in the squared units of departures.
const RESERVE: [[f32; 2]; 2] = [[5.0, 2e-3], [0.02, 0.02]];
/// ν: what is told is drawn towards none by the weight of so many departures.
const DOUBT: [f32; 2] = [1.0, 4.0];

/// Components of a driver's departure.
const SPEED: usize = 0;
/// See [`SPEED`].
const CURVATURE: usize = 1;

/// A path in steps, from where it began.
#[derive(Clone, Debug)]
pub(super) struct Course {
    points_m: [[f32; 2]; HORIZON_MAX + 1],
    len: usize,
}

/// How agents go on otherwise than forecast, step by step.
///
/// Who drives goes faster, m/s over the step, and bends more to the left, 1/m at the step's end; who walks takes other steps, x and y
/// in the world frame, m.
#[derive(Clone, Debug)]
pub struct Departures {
    /// NaN where nothing is known.
    steps: [[f32; 2]; HORIZON_MAX],
}

/// What departures there were: sums by weight.
#[derive(Clone, Debug, Default)]
pub(super) struct Evidence {
    /// Σ w
    weights: [[f32; 2]; HORIZON_MAX],
    /// Σ w δ
    sums: [[f32; 2]; HORIZON_MAX],
}

/// How well departures could be told so far, by step and component: sums of told · driven and of told².
#[derive(Clone, Debug, Default)]
pub(super) struct Skill {
    steps: [[(f32, f32); 2]; HORIZON_MAX],
}

impl Course {
    pub(super) const fn new(start_m: [f32; 2]) -> Self {
        let mut points_m = [[0.0; 2]; HORIZON_MAX + 1];
        points_m[0] = start_m;
        Self { points_m, len: 0 }
    }

    pub(super) fn push(&mut self, position_m: [f32; 2]) {
        self.len += 1;
        self.points_m[self.len] = position_m;
    }

    fn chord_m(&self, step: usize) -> [f32; 2] {
        [0, 1].map(|axis| self.points_m[step + 1][axis] - self.points_m[step][axis])
    }

    fn chord_len_m(&self, step: usize) -> f32 {
        let [x, y] = self.chord_m(step);
        x.hypot(y)
    }

    /// Mean curvature between the middles of a step and the next one; none where the agent hardly moves.
    fn curvature(&self, step: usize) -> Option<f32> {
        let lengths_m = [step, step + 1].map(|step| self.chord_len_m(step));
        let [before, after] = [step, step + 1].map(|step| self.chord_m(step));
        let turn_rad = wrapped(after[1].atan2(after[0]) - before[1].atan2(before[0]));
        (lengths_m[0].min(lengths_m[1]) >= CHORD_MIN_M)
            .then(|| 2.0 * turn_rad / (lengths_m[0] + lengths_m[1]))
    }
}

/// How a path departed at a step from its forecast, with the step that each component belongs to: who drives by its speed over the
/// step and its curvature at the end of the step before, who walks by the step itself.
pub(super) fn departure(
    gait: Gait,
    forecast: &Course,
    driven: &Course,
    step: usize,
    step_s: f32,
) -> [Option<(usize, f32)>; 2] {
    let within = |component: usize| {
        let most = DEPARTURE_MAX[gait as usize][component];
        move |(step, departure): (usize, f32)| (step, departure.clamp(-most, most))
    };
    if gait == Gait::Walking {
        let (taken, foretold) = (driven.chord_m(step), forecast.chord_m(step));
        return [0, 1].map(|axis| Some((step, taken[axis] - foretold[axis])).map(within(axis)));
    }
    let faster = (driven.chord_len_m(step) - forecast.chord_len_m(step)) / step_s;
    let bent = step
        .checked_sub(1)
        .and_then(|before| Some((before, driven.curvature(before)? - forecast.curvature(before)?)));
    [Some((step, faster)).map(within(SPEED)), bent.map(within(CURVATURE))]
}

impl Evidence {
    /// Adds departures with a weight, as far as they are known.
    pub(super) fn add(&mut self, weight: f32, departures: &Departures) {
        let own = self.weights.as_flattened_mut().iter_mut().zip(self.sums.as_flattened_mut());
        for ((weights, sum), departure) in own.zip(departures.steps.as_flattened()) {
            let known = !departure.is_nan();
            *weights += if known { weight } else { 0.0 };
            *sum += if known { weight * departure } else { 0.0 };
        }
    }

    /// The means, drawn towards none.
    ///
    /// ```text
    /// Δ_k = Σ w δ_k / (Σ w + ν)      ν = 1 driving, 4 walking
    /// ```
    pub(super) fn means(&self, gait: Gait) -> Departures {
        let doubt = DOUBT[gait as usize];
        let mean = |step: usize, component: usize| {
            let (weights, sum) = (self.weights[step][component], self.sums[step][component]);
            if weights > 0.0 { sum / (weights + doubt) } else { f32::NAN }
        };
        Departures { steps: std::array::from_fn(|step| [0, 1].map(|component| mean(step, component))) }
    }
}

impl Skill {
    /// Learns how what was told for a step compares with what was driven.
    pub(super) fn learn(&mut self, told: &Departures, step: usize, component: usize, driven: f32) {
        let Some(told) = told.at(step, component) else { return };
        let (product, square) = &mut self.steps[step][component];
        *product = LASTING * *product + told * driven;
        *square = LASTING * *square + told * told;
    }

    /// The sums of so many steps, as they are written.
    pub(super) fn numbers(&self, steps_len: usize) -> impl Iterator<Item = f32> {
        self.steps[..steps_len].iter().flatten().flat_map(|&(product, square)| [product, square])
    }

    /// The reverse of [`Skill::numbers`].
    pub(super) fn of_numbers(numbers: &[f32]) -> Self {
        let mut skill = Self::default();
        let sums = numbers.as_chunks::<2>().0.iter();
        skill.steps.as_flattened_mut().iter_mut().zip(sums).for_each(|(own, sums)| *own = (*sums).into());
        skill
    }

    /// What of departures is to be expected, going by how well they could be told so far.
    ///
    /// ```text
    /// Δ'_k = c_k Δ_k      c_k = Σ Δ_k δ_k / (Σ Δ_k² + ρ), within [0, 1]
    /// ```
    ///
    /// At a place that the model knows from its training little is left that is common to all; elsewhere much is.
    pub(super) fn of(&self, gait: Gait, told: &Departures) -> Departures {
        let scaled = |step: usize, component: usize| {
            let (product, square) = self.steps[step][component];
            let share = (product / (square + RESERVE[gait as usize][component])).clamp(0.0, 1.0);
            share * told.steps[step][component]
        };
        Departures { steps: std::array::from_fn(|step| [0, 1].map(|component| scaled(step, component))) }
    }
}

impl Default for Departures {
    fn default() -> Self {
        Self { steps: [[f32::NAN; 2]; HORIZON_MAX] }
    }
}

impl PartialEq for Departures {
    fn eq(&self, other: &Self) -> bool {
        let mut pairs = self.steps.as_flattened().iter().zip(other.steps.as_flattened());
        pairs.all(|(own, other)| own == other || own.is_nan() && other.is_nan())
    }
}

impl Departures {
    /// That of a step, where it is known; no other steps than those of a payload are.
    fn at(&self, step: usize, component: usize) -> Option<f32> {
        Some(self.steps.get(step)?[component]).filter(|departure| !departure.is_nan())
    }

    /// Takes in what is known of a step now.
    pub(super) const fn tell(&mut self, step: usize, component: usize, departure: f32) {
        self.steps[step][component] = departure;
    }

    /// Those of so many steps, as they are written: NaN where nothing is known.
    pub(super) fn numbers(&self, steps_len: usize) -> impl Iterator<Item = f32> {
        self.steps[..steps_len].as_flattened().iter().copied()
    }

    /// The reverse of [`Departures::numbers`].
    pub(super) fn of_numbers(numbers: &[f32]) -> Self {
        let mut departures = Self::default();
        departures.steps.as_flattened_mut()[..numbers.len()].copy_from_slice(numbers);
        departures
    }

    /// A share of them.
    pub(super) fn scaled(&self, share: f32) -> Self {
        Self { steps: self.steps.map(|step| step.map(|departure| share * departure)) }
    }

    /// Whether nothing is known of any step.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.steps.as_flattened().iter().all(|departure| departure.is_nan())
    }

    /// What the displacements of one who walks, in axes that point along `heading_rad`, have to be changed by at each step so that its
    /// path departs so.
    #[must_use]
    pub fn displacements(&self, heading_rad: f32) -> [[f32; 2]; HORIZON_MAX] {
        let frame = AgentFrame::new([0.0; 2], heading_rad);
        let known = |departure: f32| if departure.is_nan() { 0.0 } else { departure };
        self.steps.map(|step| frame.rotate_into(step.map(known)))
    }

    /// What a vehicle's controls, acceleration and slip rate, have to be changed by at each step so that its path departs so.
    /// What is not known of a step stays as it was in the step before.
    ///
    /// ```text
    /// v_k += (Δs_k + Δs_(k+1)) / 2      β_k += l_r Δκ_k      a_k += (Δv_k − Δv_(k−1)) / Δt,  β̇ alike
    /// ```
    #[must_use]
    pub fn controls(&self, rear_axle_m: f32, step_s: f32) -> [[f32; 2]; HORIZON_MAX] {
        let mut before = [0.0; 2];
        std::array::from_fn(|step| {
            let faster =
                self.at(step, SPEED).map(|now| 0.5 * (now + self.at(step + 1, SPEED).unwrap_or(now)));
            let bent = self.at(step, CURVATURE).map(|curvature| rear_axle_m * curvature);
            let after = [faster.unwrap_or(before[0]), bent.unwrap_or(before[1])];
            let change = [0, 1].map(|component| (after[component] - before[component]) / step_s);
            before = after;
            change
        })
    }
}
