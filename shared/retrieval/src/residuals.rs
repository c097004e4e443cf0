//! Forecast residuals: an agent's actual path minus its forecast path. Converts residuals to changes of
//! controls.

use kinematics::{MotionKind, MotionModel};
use scene::{AgentFrame, turn};
use wire::HORIZON_MAX;

/// Chords shorter than this have no direction.
const CHORD_MIN_M: f32 = 0.5;
/// Limits of the residuals' magnitudes: of a bicycle's speed, m/s, and curvature, 1/m; of a displacement's x
/// and y, m.
pub(crate) const RESIDUAL_MAX: [[f32; 2]; 2] = [[6.0, 0.2], [2.0, 2.0]];

/// Components of a bicycle's residual.
const SPEED: usize = 0;
/// See [`SPEED`].
const CURVATURE: usize = 1;

/// Changes of the means of controls, step by step.
pub type ControlChange = [[f32; 2]; HORIZON_MAX];

/// A path in steps from its start.
#[derive(Clone, Debug)]
pub(crate) struct StepPath {
    points_m: [[f32; 2]; HORIZON_MAX + 1],
    len: usize,
}

/// Forecast residuals, step by step: actual minus forecast.
///
/// For bicycles: mean speed over the step, m/s, and curvature to the left at the step's end, 1/m. For
/// displacements: x and y of the step in the world frame, m.
#[derive(Clone, Debug)]
pub struct Residuals {
    /// NaN if unknown.
    steps: [[f32; 2]; HORIZON_MAX],
}

impl StepPath {
    pub(crate) const fn new(start_m: [f32; 2]) -> Self {
        let mut points_m = [[0.0; 2]; HORIZON_MAX + 1];
        points_m[0] = start_m;
        Self { points_m, len: 0 }
    }

    pub(crate) fn push(&mut self, position_m: [f32; 2]) {
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

    /// Mean curvature between the middle of a step and the middle of the next; `None` if the agent hardly
    /// moves.
    fn curvature(&self, step: usize) -> Option<f32> {
        let lengths_m = [step, step + 1].map(|step| self.chord_len_m(step));
        let [before, after] = [step, step + 1].map(|step| self.chord_m(step));
        let turn_rad = turn(before[1].atan2(before[0]), after[1].atan2(after[0]));
        (lengths_m[0].min(lengths_m[1]) >= CHORD_MIN_M)
            .then(|| 2.0 * turn_rad / (lengths_m[0] + lengths_m[1]))
    }
}

/// The residual of a path that was `taken` up to the end of a step, by component, with the step that each
/// component belongs to. A bicycle's speed belongs to the step and its curvature to the previous step; a
/// displacement belongs to the step.
pub(crate) fn residual(
    kind: MotionKind,
    forecast: &StepPath,
    taken: &StepPath,
    step: usize,
    step_s: f32,
) -> [Option<(usize, f32)>; 2] {
    let clipped = |component: usize| {
        let most = RESIDUAL_MAX[kind as usize][component];
        move |(step, residual): (usize, f32)| (step, residual.clamp(-most, most))
    };
    if kind == MotionKind::Displacement {
        let (taken, forecast) = (taken.chord_m(step), forecast.chord_m(step));
        return [0, 1].map(|axis| Some((step, taken[axis] - forecast[axis])).map(clipped(axis)));
    }
    let faster = (taken.chord_len_m(step) - forecast.chord_len_m(step)) / step_s;
    let bent = step
        .checked_sub(1)
        .and_then(|before| Some((before, taken.curvature(before)? - forecast.curvature(before)?)));
    [Some((step, faster)).map(clipped(SPEED)), bent.map(clipped(CURVATURE))]
}

impl Default for Residuals {
    fn default() -> Self {
        Self { steps: [[f32::NAN; 2]; HORIZON_MAX] }
    }
}

impl PartialEq for Residuals {
    fn eq(&self, other: &Self) -> bool {
        let mut pairs = self.steps.as_flattened().iter().zip(other.steps.as_flattened());
        pairs.all(|(own, other)| own == other || own.is_nan() && other.is_nan())
    }
}

impl Residuals {
    /// The residuals of a path relative to a forecast, both from the same start.
    ///
    /// # Panics
    /// If one of them has more steps than a payload holds.
    #[must_use]
    pub fn between(
        kind: MotionKind,
        start_m: [f32; 2],
        forecast_m: &[[f32; 2]],
        taken_m: &[[f32; 2]],
        step_s: f32,
    ) -> Self {
        let path = |points_m: &[[f32; 2]]| {
            let mut path = StepPath::new(start_m);
            points_m.iter().for_each(|&point_m| path.push(point_m));
            path
        };
        let (forecast, taken) = (path(forecast_m), path(taken_m));
        let mut residuals = Self::default();
        for step in 0..taken_m.len() {
            for (component, residual) in
                residual(kind, &forecast, &taken, step, step_s).into_iter().enumerate()
            {
                if let Some((step, residual)) = residual {
                    residuals.set(step, component, residual);
                }
            }
        }
        residuals
    }

    /// Residuals from a function of step and component; NaN if unknown.
    pub(crate) fn from_fn(residual: impl Fn(usize, usize) -> f32) -> Self {
        Self { steps: std::array::from_fn(|step| [0, 1].map(|component| residual(step, component))) }
    }

    /// The residual of a step; `None` if it is unknown or the step is beyond a payload's.
    pub(crate) fn at(&self, step: usize, component: usize) -> Option<f32> {
        Some(self.steps.get(step)?[component]).filter(|residual| !residual.is_nan())
    }

    /// The components of all steps; NaN if unknown.
    pub(crate) const fn steps(&self) -> &[[f32; 2]; HORIZON_MAX] {
        &self.steps
    }

    pub(crate) const fn set(&mut self, step: usize, component: usize, residual: f32) {
        self.steps[step][component] = residual;
    }

    /// Residuals with these components in the first steps.
    pub(crate) fn of_numbers(numbers: &[f32]) -> Self {
        let mut residuals = Self::default();
        residuals.steps.as_flattened_mut()[..numbers.len()].copy_from_slice(numbers);
        residuals
    }

    /// The residuals times `share`.
    pub(crate) fn scaled(&self, share: f32) -> Self {
        Self { steps: self.steps.map(|step| step.map(|residual| share * residual)) }
    }

    /// Whether no residual is known.
    pub fn is_empty(&self) -> bool {
        self.steps.as_flattened().iter().all(|residual| residual.is_nan())
    }

    /// The change of an agent's controls that adds these residuals to its path.
    ///
    /// ```text
    /// bicycle        v_k += (Δs_k + Δs_(k+1)) / 2  β_k += l_r Δκ_k  a_k += (Δv_k − Δv_(k−1)) / Δt,  β̇ alike
    /// displacement   u_k += Rᵀ Δp_k
    /// ```
    ///
    /// If the residual of a step is unknown, a bicycle keeps the previous step's, and a displacement is
    /// unchanged.
    #[must_use]
    pub fn control_change(&self, model: &MotionModel) -> ControlChange {
        match model {
            MotionModel::Bicycle { motion, .. } => self.of_bicycle(motion.bicycle.rear_axle_m, motion.dt_s),
            MotionModel::Displacement { motion, .. } => self.of_displacements(motion.heading_rad()),
        }
    }

    fn of_displacements(&self, heading_rad: f32) -> ControlChange {
        let frame = AgentFrame::new([0.0; 2], heading_rad);
        let known = |residual: f32| if residual.is_nan() { 0.0 } else { residual };
        self.steps.map(|step| frame.rotate_into(step.map(known)))
    }

    fn of_bicycle(&self, rear_axle_m: f32, step_s: f32) -> ControlChange {
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
