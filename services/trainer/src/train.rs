//! The training loop.

#[cfg(test)]
mod tests;

use std::time::Instant;

use burn::tensor::Device;
use data::sets::{DataSet, Part};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::TrainError;
use crate::base::BaseControl;
use crate::batch::{Batch, BatchOptions, SceneView};
use crate::card::{ModelCard, Seen};
use crate::checkpoint::{State, write_whole};
use crate::model::{self, Normalisation};
use crate::objective::{self, Objective};
use crate::options::TrainOptions;
use crate::parameters::Precision;
use crate::progress::Progress;
use crate::samples::{Samples, SetSamples};
use crate::validate::{Baselines, SetScore, Validation, choose_by};
use crate::view;

/// Neighbouring windows in a batch with a map: they share most of their patches.
const CLIP_WINDOWS: usize = 4;
/// Agents of each set in the validation that the model card reports.
const CARD_AGENTS: usize = 4000;
/// Losses in a row that may leave the numbers before a run is given up.
const DIVERGED_STEPS: u32 = 10;

/// What a finished run did.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// Updates made.
    pub steps: u64,
    /// The card of the weights that were written.
    pub card: ModelCard,
}

/// Trains a model and writes its weights to [`TrainOptions::out`], whenever a validation is the best so far and at the
/// end.
///
/// # Errors
/// [`TrainError`] says which recording, option, checkpoint or file is to blame.
pub fn train(options: &TrainOptions, device: &Device) -> Result<Summary, TrainError> {
    options.check()?;
    let mut progress = Progress::new(options.steps, 0);
    let run = Run::prepare(options, device, &progress)?;
    let (mut state, base) = run.begin(&progress)?;
    progress.restart(state.progress.step);
    run.learn(&mut state, &base, &mut progress)?;
    let card = run.write(&state, &base, CARD_AGENTS)?;
    state.save(&options.checkpoints)?;
    progress.finish();
    Ok(Summary { steps: state.progress.step, card })
}

/// What stays the same through a run.
struct Run<'a> {
    options: &'a TrainOptions,
    device: &'a Device,
    training: Samples,
    validation: Samples,
    baselines: Baselines,
}

impl<'a> Run<'a> {
    fn prepare(
        options: &'a TrainOptions,
        device: &'a Device,
        progress: &Progress,
    ) -> Result<Self, TrainError> {
        let read = |names: &[String], part: Part, windows_max: usize| {
            let sets =
                names.iter().map(|name| set_named(name)).collect::<Result<Vec<DataSet>, TrainError>>()?;
            let tell = |path: &std::path::Path| progress.reading(path);
            let samples = Samples::read(&options.data, &sets, part, windows_max, &options.model, tell)?;
            if samples.counted().next().is_none() {
                return Err(TrainError::NoWindows { part: part.name(), root: options.data.clone() });
            }
            Ok(samples)
        };
        let training = read(&options.sets, Part::Train, options.windows)?;
        let validation = read(&options.validation_sets, Part::Validation, usize::MAX)?;
        for set in &training.sets {
            let (windows, agents) = (set.scenes.len(), set.counted().count());
            progress.note(&format!("{}: {windows} windows, {agents} agents", set.set.name()));
        }
        let baselines = Baselines::fit(&training, &options.model, options.seed);
        Ok(Self { options, device, training, validation, baselines })
    }

    /// The checkpoint, if there is one to go on from, else new weights with a base control fitted to the data.
    fn begin(&self, progress: &Progress) -> Result<(State, BaseControl), TrainError> {
        let Self { options, device, .. } = *self;
        if options.resume
            && let Some(state) = State::load(options, device)?
        {
            let base = BaseControl::load(&state.parameters, &options.model);
            return Ok((state, base.unwrap_or_else(|| BaseControl::zero(&options.model))));
        }
        let mut parameters = model::initial(&options.model, options.seed, device);
        let mut base = BaseControl::zero(&options.model);
        if options.model.base {
            progress.note("fitting the base control");
            base = BaseControl::fit(&options.model, || self.training.counted(), options.seed);
            base.store(&mut parameters, device);
        }
        Ok((State::new(parameters, options), base))
    }

    fn learn(
        &self,
        state: &mut State,
        base: &BaseControl,
        progress: &mut Progress,
    ) -> Result<(), TrainError> {
        let options = self.options;
        let (begun, before_s) = (Instant::now(), state.progress.seconds);
        let mut diverged = 0;
        while state.progress.step < options.steps && state.progress.stale < options.patience {
            if state.progress.step.is_multiple_of(options.validate_every) {
                state.progress.seconds = before_s + begun.elapsed().as_secs_f64();
                self.validate(state, base, progress)?;
            }
            let (parts, finite) = self.update(state, base);
            diverged = if finite { 0 } else { diverged + 1 };
            if diverged == DIVERGED_STEPS {
                return Err(TrainError::Diverged { step: state.progress.step });
            }
            state.progress.step += 1;
            progress.step(state.progress.step, parts);
        }
        state.progress.seconds = before_s + begun.elapsed().as_secs_f64();
        self.validate(state, base, progress)
    }

    /// One update. Everything random in it comes from the seed and the number of the update.
    fn update(&self, state: &mut State, base: &BaseControl) -> (objective::LossParts, bool) {
        let options = self.options;
        let mut random = ChaCha8Rng::seed_from_u64(options.seed);
        random.set_stream(state.progress.step + 1);
        let scenes = self.draw(&mut random);
        let batch = Batch::new(
            &scenes,
            BatchOptions {
                config: &options.model,
                base,
                neighbours_max: options.neighbours,
                normalisation: Normalisation::Batch,
                with_future: matches!(options.objective, Objective::Paper { .. }),
                device: self.device,
            },
        );
        let (leaves, frozen) = (state.parameters.leaves(), state.parameters.frozen());
        let Some(step) =
            objective::loss(&options.objective, &options.model, (&leaves, &frozen), &batch, &mut random)
        else {
            return (objective::LossParts::default(), true);
        };
        let gradients = step.loss.backward();
        let rate = state.adam.rate(state.progress.step, options.steps);
        let norm = state.adam.step(&mut state.parameters, &leaves, gradients, rate);
        if norm.is_finite() {
            state.parameters.replace(step.statistics);
        }
        state.progress.adam_steps = state.adam.steps;
        (step.parts, norm.is_finite())
    }

    /// Scenes of at least [`TrainOptions::batch_agents`] agents, from sets drawn by the root of their size.
    fn draw(&self, random: &mut impl Rng) -> Vec<SceneView<'_>> {
        let options = self.options;
        let sets: Vec<&SetSamples> = self.training.sets.iter().filter(|set| !set.scenes.is_empty()).collect();
        let weights: Vec<f64> = sets.iter().map(|set| (set.scenes.len() as f64).sqrt()).collect();
        let with_map = options.model.context && !random.random_bool(options.without_map);
        let mut views: Vec<SceneView<'_>> = Vec::new();
        let mut agents_len = 0;
        while agents_len < options.batch_agents {
            let set = sets[weighted(&weights, random)];
            let first = random.random_range(0..set.scenes.len());
            let clip = set.scenes[first..].iter().take(if with_map { CLIP_WINDOWS } else { 1 });
            for scene in clip.take_while(|scene| scene.recording == set.scenes[first].recording) {
                let patches = with_map.then(|| &self.training.patches[scene.recording]);
                views.push(view::augmented(scene, patches, options, random));
                agents_len += views.last().map_or(0, |view| view.agents.len());
            }
        }
        views
    }

    fn validate(&self, state: &mut State, base: &BaseControl, progress: &Progress) -> Result<(), TrainError> {
        let average = state.adam.average().clone();
        let scores = self.scores(&average.frozen(), base, true, self.options.validation_agents);
        let figure = choose_by(&scores);
        progress.note(&format!("validation at {}: {figure:.4}\n{}", state.progress.step, table(&scores)));
        if state.progress.best_figure.is_none_or(|best| figure < best) {
            state.best = average;
            state.progress.best_figure = Some(figure);
            state.progress.best_step = state.progress.step;
            state.progress.stale = 0;
            self.write(state, base, self.options.validation_agents)?;
        } else {
            state.progress.stale += 1;
        }
        state.save(&self.options.checkpoints)
    }

    fn scores(
        &self,
        weights: &crate::parameters::Weights,
        base: &BaseControl,
        with_map: bool,
        agents_max: usize,
    ) -> Vec<SetScore> {
        let validation = Validation {
            config: &self.options.model,
            base,
            baselines: &self.baselines,
            with_map,
            agents_max,
            device: self.device,
        };
        validation.scores(weights, &self.validation)
    }

    /// Writes the best weights with their card.
    fn write(&self, state: &State, base: &BaseControl, agents_max: usize) -> Result<ModelCard, TrainError> {
        let weights = state.best.frozen();
        let scores = [true, false].map(|with_map| self.scores(&weights, base, with_map, agents_max));
        let seen = Seen {
            windows: self.training.sets.iter().map(|set| set.scenes.len()).sum(),
            agents: self.training.counted().count(),
        };
        let sources = self.training.sources.clone();
        let card = ModelCard::new(self.options, &state.progress, &state.best, seen, sources, scores);
        write_whole(&self.options.out, &card.weights_file(&state.best, Precision::F16)?)?;
        Ok(card)
    }
}

fn set_named(name: &str) -> Result<DataSet, TrainError> {
    let sets = [
        DataSet::EthUcy,
        DataSet::SddTrajnet,
        DataSet::SddRaw,
        DataSet::Interaction,
        DataSet::VciDut,
        DataSet::KittiLabels,
        DataSet::KittiDetections,
    ];
    let folds = data::sets::Fold::ALL.map(DataSet::EthUcyFold);
    let known = || sets.into_iter().chain(folds);
    known().find(|set| set.name() == name).ok_or_else(|| {
        let names: Vec<&str> = known().map(DataSet::name).collect();
        TrainError::Options(format!("unknown data set \"{name}\": expected one of {}", names.join(", ")))
    })
}

/// An index drawn in proportion to its weight.
fn weighted(weights: &[f64], random: &mut impl Rng) -> usize {
    let mut left = random.random::<f64>() * weights.iter().sum::<f64>();
    let drawn = weights.iter().position(|weight| {
        left -= weight;
        left < 0.0
    });
    drawn.unwrap_or(weights.len() - 1)
}

/// The figures of a validation, a line per set.
fn table(scores: &[SetScore]) -> String {
    let line = |score: &SetScore| {
        let cell = |errors: crate::validate::Errors| format!("{:.3}/{:.3}", errors.ade_m, errors.fde_m);
        format!(
            "  {:<14} {:>6} agents  best of modes {} (base {}, anchors {})  single {} (base {}, CV {})",
            score.set,
            score.agents,
            cell(score.best_of_modes),
            cell(score.base_best_of_modes),
            cell(score.anchors_best_of_20),
            cell(score.single),
            cell(score.base_single),
            cell(score.constant_velocity),
        )
    };
    scores.iter().map(line).collect::<Vec<_>>().join("\n")
}
