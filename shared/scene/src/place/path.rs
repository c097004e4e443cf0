use wire::HORIZON_MAX;

use crate::motion::wrapped;

/// Chords shorter than this have no direction.
const CHORD_MIN_M: f32 = 0.5;
/// Departures are taken to be no larger: speed m/s, curvature 1/m.
const DEPARTURE_MAX: [f32; 2] = [6.0, 0.2];

/// What of the skill lasts from one departure to the next: about the last thousand count.
const LASTING: f32 = 0.999;
/// ρ: so much has to be told before it counts, speed m²/s², curvature 1/m².
const RESERVE: [f32; 2] = [5.0, 2e-3];

/// Components of a departure.
pub(super) const SPEED: usize = 0;
/// See [`SPEED`].
pub(super) const CURVATURE: usize = 1;

/// A path in steps, from where it began.
#[derive(Clone, Debug)]
pub(super) struct Course {
    points_m: [[f32; 2]; HORIZON_MAX + 1],
    len: usize,
}

/// By how much agents go faster, and bend more to the left, than was forecast, as is to be expected: the mean over a step for
/// speed, m/s, and at a step's end for curvature, 1/m; none where nothing is known.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Departures {
    steps: [[Option<f32>; 2]; HORIZON_MAX],
}

/// What departures there were: sums by weight.
#[derive(Clone, Debug, Default)]
pub(super) struct Evidence {
    /// (Σ w, Σ w δ)
    steps: [[(f32, f32); 2]; HORIZON_MAX],
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

    /// Steps gone.
    pub(super) const fn len(&self) -> usize {
        self.len
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

/// How a path departed at a step from its forecast: its speed over the step, and its curvature at the end of the step before.
pub(super) fn departure(
    forecast: &Course,
    driven: &Course,
    step: usize,
    step_s: f32,
) -> [Option<(usize, f32)>; 2] {
    let faster = (driven.chord_len_m(step) - forecast.chord_len_m(step)) / step_s;
    let bent = step
        .checked_sub(1)
        .and_then(|before| Some((before, driven.curvature(before)? - forecast.curvature(before)?)));
    let within = |component: usize| {
        let most = DEPARTURE_MAX[component];
        move |(step, departure): (usize, f32)| (step, departure.clamp(-most, most))
    };
    [Some((step, faster)).map(within(SPEED)), bent.map(within(CURVATURE))]
}

impl Evidence {
    /// Adds departures with a weight, as far as they are known.
    pub(super) fn add(&mut self, weight: f32, departures: &Departures) {
        for (sums, departure) in self.steps.iter_mut().flatten().zip(departures.steps.iter().flatten()) {
            if let Some(departure) = departure {
                sums.0 += weight;
                sums.1 += weight * departure;
            }
        }
    }

    /// The means, drawn towards none by the weight of one departure.
    ///
    /// ```text
    /// Δ_k = Σ w δ_k / (Σ w + 1)
    /// ```
    pub(super) fn means(&self) -> Departures {
        let mean = |(weights, sum): (f32, f32)| (weights > 0.0).then(|| sum / (weights + 1.0));
        Departures { steps: self.steps.map(|step| step.map(mean)) }
    }
}

impl Skill {
    /// Learns how what was told for a step compares with what was driven.
    pub(super) fn learn(&mut self, told: &Departures, step: usize, component: usize, driven: f32) {
        let Some(told) = told.steps[step][component] else { return };
        let (product, square) = &mut self.steps[step][component];
        *product = LASTING * *product + told * driven;
        *square = LASTING * *square + told * told;
    }

    /// What of departures is to be expected, going by how well they could be told so far.
    ///
    /// ```text
    /// Δ'_k = c_k Δ_k      c_k = Σ Δ_k δ_k / (Σ Δ_k² + ρ), within [0, 1]
    /// ```
    ///
    /// At a place that the model knows from its training little is left that is common to all; elsewhere much is.
    pub(super) fn of(&self, told: &Departures) -> Departures {
        let scaled = |step: usize, component: usize| {
            let (product, square) = self.steps[step][component];
            let share = (product / (square + RESERVE[component])).clamp(0.0, 1.0);
            told.steps[step][component].map(|departure| share * departure)
        };
        Departures {
            steps: std::array::from_fn(|step| [SPEED, CURVATURE].map(|component| scaled(step, component))),
        }
    }
}

impl Departures {
    /// Takes in what is known of a step now.
    pub(super) const fn tell(&mut self, step: usize, component: usize, departure: f32) {
        self.steps[step][component] = Some(departure);
    }

    /// What a vehicle's controls, acceleration and slip rate, have to be changed by at each step so that its path departs so.
    /// What is not known of a step stays as it was in the step before.
    ///
    /// ```text
    /// v_k += (Δs_k + Δs_(k+1)) / 2      β_k += l_r Δκ_k      a_k += (Δv_k − Δv_(k−1)) / Δt,  β̇ alike
    /// ```
    #[must_use]
    pub fn controls(&self, rear_axle_m: f32, step_s: f32) -> [[f32; 2]; HORIZON_MAX] {
        let expected = |step: usize, component: usize| self.steps.get(step).and_then(|step| step[component]);
        let mut before = [0.0; 2];
        std::array::from_fn(|step| {
            let faster =
                expected(step, SPEED).map(|now| 0.5 * (now + expected(step + 1, SPEED).unwrap_or(now)));
            let bent = expected(step, CURVATURE).map(|curvature| rear_axle_m * curvature);
            let after = [faster.unwrap_or(before[0]), bent.unwrap_or(before[1])];
            let change = [0, 1].map(|component| (after[component] - before[component]) / step_s);
            before = after;
            change
        })
    }
}
