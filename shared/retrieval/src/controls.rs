//! Converts retrieved residuals to changes of a forecast's controls.

use kinematics::MotionModel;
use wire::{ControlGaussian, HORIZON_MAX, MODES_MAX};

use crate::{ControlChange, ModeSelection, RETRIEVED_MAX, Retrieved};

/// The controls of one agent's forecast, step by step. The best forecast determines the number of steps;
/// modes may have more.
#[derive(Clone, Copy, Debug)]
pub struct ForecastControls<'a, M> {
    /// Controls of each mode.
    pub modes: &'a [M],
    /// The probability of each mode.
    pub probability: &'a [f32],
    /// Controls of the single best forecast.
    pub best: &'a [ControlGaussian],
}

/// Changes of one agent's controls: of their means, and of the modes' probabilities. Covariances are
/// unchanged.
#[derive(Clone, Debug)]
pub struct ControlChanges {
    best: ControlChange,
    modes: ControlChange,
    /// For each mode that a neighbour's path replaces: the change of the best forecast's controls that leads
    /// along the path.
    replaced: Vec<Option<ControlChange>>,
    /// Additional changes of single modes.
    own: Vec<Option<ControlChange>>,
    probability: Vec<f32>,
}

/// Converts retrieved residuals to [`ControlChanges`], for one agent at a time, with scratch memory that is
/// allocated once.
#[derive(Clone, Debug)]
pub struct ControlAdapter {
    selection: ModeSelection,
    paths: Vec<[[f32; 2]; HORIZON_MAX]>,
}

impl<'a, M: AsRef<[ControlGaussian]>> ForecastControls<'a, M> {
    /// The path of the best forecast before any change.
    pub(crate) fn best_path(&self, model: &MotionModel) -> [[f32; 2]; HORIZON_MAX] {
        path(model, self.best.iter().map(|control| control.mean))
    }

    fn mode(&self, mode: usize) -> &'a [ControlGaussian] {
        &self.modes[mode].as_ref()[..self.best.len()]
    }
}

impl ControlChanges {
    /// The probability of each mode.
    pub fn probability(&self) -> &[f32] {
        &self.probability
    }

    /// The means of the best forecast's controls.
    pub fn best<M>(&self, controls: &ForecastControls<'_, M>) -> impl Iterator<Item = [f32; 2]> {
        changed(controls.best, &self.best)
    }

    /// The controls of a mode.
    pub fn mode<M: AsRef<[ControlGaussian]>>(
        &self,
        mode: usize,
        controls: &ForecastControls<'_, M>,
    ) -> impl Iterator<Item = ControlGaussian> {
        let own = controls.mode(mode);
        let (means, change) = match &self.replaced[mode] {
            Some(change) => (controls.best, change),
            None => (own, &self.modes),
        };
        let further = self.own[mode].as_ref();
        changed(means, change).zip(own).enumerate().map(move |(step, (mean, own))| {
            let mean = further.map_or(mean, |further| [0, 1].map(|i| mean[i] + further[step][i]));
            ControlGaussian { mean, ..*own }
        })
    }

    /// Whether a neighbour's path replaces the mode.
    #[must_use]
    pub fn is_replaced(&self, mode: usize) -> bool {
        self.replaced[mode].is_some()
    }

    /// Adds a change to the best forecast's controls only.
    pub fn shift_best(&mut self, by: &ControlChange) {
        add(&mut self.best, by);
    }

    /// Adds a change to one mode's controls.
    pub fn shift_mode(&mut self, mode: usize, by: &ControlChange) {
        add(self.own[mode].get_or_insert_default(), by);
    }

    /// Replaces the means of a mode's controls.
    pub fn replace<M>(
        &mut self,
        mode: usize,
        means: &ControlChange,
        controls: &ForecastControls<'_, M>,
        probability: f32,
    ) {
        let mut change = *means;
        for (own, best) in change.iter_mut().zip(controls.best) {
            *own = [0, 1].map(|i| own[i] - best.mean[i]);
        }
        self.replaced[mode] = Some(change);
        self.own[mode] = None;
        self.probability[mode] = probability;
    }

    /// Sets the probability of a mode.
    pub fn set_probability(&mut self, mode: usize, probability: f32) {
        self.probability[mode] = probability;
    }

    /// Resets to no change, with these mode probabilities.
    pub fn reset(&mut self, probability: &[f32]) {
        (self.best, self.modes) = Default::default();
        self.replaced.clear();
        self.replaced.resize(probability.len(), None);
        self.own.clear();
        self.own.resize(probability.len(), None);
        self.probability.clear();
        self.probability.extend_from_slice(probability);
    }
}

impl Default for ControlChanges {
    fn default() -> Self {
        Self {
            best: ControlChange::default(),
            modes: ControlChange::default(),
            replaced: Vec::with_capacity(MODES_MAX),
            own: Vec::with_capacity(MODES_MAX),
            probability: Vec::with_capacity(MODES_MAX),
        }
    }
}

impl Default for ControlAdapter {
    fn default() -> Self {
        Self { selection: ModeSelection::default(), paths: Vec::with_capacity(MODES_MAX + RETRIEVED_MAX) }
    }
}

impl ControlAdapter {
    /// Writes the changes of an agent's controls that follow from its retrieved residuals.
    ///
    /// The best forecast gets the expected residuals, the modes [half of them](Retrieved::expected_of_modes).
    /// Each neighbour also gives a path: the best forecast with that neighbour's residuals. These paths then
    /// compete with the modes; see [`ModeSelection`].
    pub fn adapt<M: AsRef<[ControlGaussian]>>(
        &mut self,
        retrieved: &Retrieved,
        model: &MotionModel,
        controls: &ForecastControls<'_, M>,
        changes: &mut ControlChanges,
    ) {
        changes.reset(controls.probability);
        if retrieved.is_empty() {
            return;
        }
        changes.best = retrieved.expected.control_change(model);
        changes.modes = retrieved.expected_of_modes().control_change(model);
        if !retrieved.neighbours.is_empty() {
            self.select(retrieved, model, controls, changes);
        }
    }

    /// Replaces modes by neighbours' paths.
    fn select<M: AsRef<[ControlGaussian]>>(
        &mut self,
        retrieved: &Retrieved,
        model: &MotionModel,
        controls: &ForecastControls<'_, M>,
        changes: &mut ControlChanges,
    ) {
        let Self { selection, paths } = self;
        let modes_len = controls.modes.len();
        let change = |neighbour: usize| retrieved.neighbours[neighbour].residuals.control_change(model);
        paths.clear();
        paths.extend((0..modes_len).map(|mode| path(model, changed(controls.mode(mode), &changes.modes))));
        let neighbours = 0..retrieved.neighbours.len();
        paths.extend(neighbours.map(|neighbour| path(model, changed(controls.best, &change(neighbour)))));
        let weights = retrieved.neighbours.iter().map(|neighbour| neighbour.weight);
        selection.select(model.kind(), paths, controls.best.len(), controls.probability, weights);
        for (mode, (selected, probability)) in selection.selected().enumerate() {
            changes.replaced[mode] = selected.checked_sub(modes_len).map(change);
            changes.probability[mode] = probability;
        }
    }
}

fn add(change: &mut ControlChange, by: &ControlChange) {
    for (own, by) in change.as_flattened_mut().iter_mut().zip(by.as_flattened()) {
        *own += by;
    }
}

/// The means of controls with a change added.
fn changed(controls: &[ControlGaussian], change: &ControlChange) -> impl Iterator<Item = [f32; 2]> {
    controls.iter().zip(change).map(|(control, change)| [0, 1].map(|i| control.mean[i] + change[i]))
}

fn path(model: &MotionModel, controls: impl Iterator<Item = [f32; 2]>) -> [[f32; 2]; HORIZON_MAX] {
    let mut path = [[0.0; 2]; HORIZON_MAX];
    model.positions(controls, &mut path);
    path
}
