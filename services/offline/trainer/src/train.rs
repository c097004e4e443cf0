//! The training loop.

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use data::sets::Part;
use nn::{Latents, ModelConfig};
use rand_chacha::ChaCha8Rng;

use crate::agent_view::SceneView;
use crate::base::{Augmentation, BaseControl, FITTED_MAX};
use crate::calibration::Calibration;
use crate::card::{ModelCard, Seen};
use crate::checkpoint::{RunState, write_whole};
use crate::log::{Line, Log};
use crate::machine;
use crate::net::layout::{initial, layout};
use crate::net::tensors::Tensors;
use crate::objective::{Differentiated, Learned, LossParts, differentiate};
use crate::options::{TrainOptions, set_named};
use crate::progress::Progress;
use crate::samples::{MapKind, Samples, Selection, Source};
use crate::score::{SetScore, choose_by};
use crate::spool::Spooling;
use crate::threads;
use crate::validate::{Baselines, Validation};
use crate::windows::{Windows, counted_in, selection};
use crate::{TrainError, own};

/// Number of agents per set in the validation on the model card.
const CARD_AGENTS: usize = 4000;
/// Number of consecutive non-finite losses after which a run fails.
const DIVERGED_STEPS: u32 = 10;

/// Result of a finished run.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// Updates made.
    pub steps: u64,
    /// The card of the written weights.
    pub card: ModelCard,
}

/// Trains a model. Writes its weights to [`TrainOptions::out`] whenever a validation is the best so far, and
/// at the end.
///
/// # Errors
/// [`TrainError`] names the recording, option, checkpoint or file at fault.
pub fn train(options: &TrainOptions) -> Result<Summary, TrainError> {
    options.check()?;
    machine::forget_peak();
    let mut progress = Progress::new(options.steps, 0);
    let run = Run::prepare(options, &progress)?;
    let (mut state, base) = run.begin(&progress)?;
    if options.steps == 0 {
        let card = run.write_revised(&state.weights, &base, CARD_AGENTS)?;
        progress.finish();
        return Ok(Summary { steps: 0, card });
    }
    progress.restart(state.progress.step);
    run.learn(&mut state, &base, &mut progress)?;
    let card = run.write(&state, &base, CARD_AGENTS)?;
    state.save(&options.checkpoints)?;
    progress.finish();
    Ok(Summary { steps: state.progress.step, card })
}

/// State that does not change during a run.
pub(crate) struct Run<'a> {
    options: &'a TrainOptions,
    pub(crate) training: Windows,
    validation: Samples,
    baselines: Baselines,
}

impl<'a> Run<'a> {
    pub(crate) fn prepare(options: &'a TrainOptions, progress: &Progress) -> Result<Self, TrainError> {
        let read = |names: &[String], part: Part, windows_max: usize| {
            let sets = names.iter().map(|name| set_named(name)).collect::<Result<Vec<_>, _>>()?;
            let selection = Selection { sets: &sets, windows_max, ..selection(options, part) };
            let spooling = Spooling::create(&options.checkpoints)?;
            let samples = Samples::read(selection, &options.model, spooling, |path| progress.reading(path))?;
            if samples.sets.iter().all(|set| set.windows.is_empty()) {
                return Err(TrainError::NoWindows { part: part.name(), root: options.data.clone() });
            }
            Ok(samples)
        };
        let mut training = read(&options.sets, Part::Train, options.windows)?;
        let mut validation = read(&options.validation_sets, Part::Validation, usize::MAX)?;
        if options.model.context && options.site_map > 0.0 {
            validation.add_site_maps(Some(&training))?;
            training.add_site_maps(None)?;
        }
        for set in &training.sets {
            let (windows, agents) = (set.windows.len(), set.counted_count());
            progress.note(&format!("{}: {windows} windows, {agents} agents", set.set.name()));
        }
        if !options.files.is_empty() {
            let set = &validation.sets[0];
            progress.note(&own::split(&options.files));
            progress.note(&format!(
                "validation: {} windows, {} agents",
                set.windows.len(),
                set.counted_count()
            ));
            let is_shared =
                |source: &Source| training.sources.iter().any(|other| other.sha256 == source.sha256);
            if options.files.len() > 1 && validation.sources.iter().any(is_shared) {
                return Err(TrainError::Options(
                    "the same recording is among those for training and for validation".to_owned(),
                ));
            }
        }
        let baselines = Baselines::fit(&training, &options.model, options.seed)?;
        let training = Windows { options: options.clone(), samples: training };
        Ok(Self { options, training, validation, baselines })
    }

    /// The checkpoint if there is one to resume, otherwise new weights with a base control fitted to the
    /// data.
    fn begin(&self, progress: &Progress) -> Result<(RunState, BaseControl), TrainError> {
        let Self { options, .. } = *self;
        if options.resume
            && let Some(state) = RunState::load(options)?
        {
            if !options.files.is_empty() && state.progress.recordings != self.recordings() {
                return Err(TrainError::Options(
                    "the checkpoints are of a training on other recordings: name another --out, or --checkpoints"
                        .to_owned(),
                ));
            }
            progress.note(&format!("resumed at update {}", state.progress.step));
            let base = BaseControl::load(&state.weights, &options.model);
            return Ok((state, base.unwrap_or_else(|| BaseControl::zero(&options.model))));
        }
        let mut weights = match &options.begin_with[..] {
            [] => initial(&options.model, options.seed),
            paths => mean_of_files(paths, &options.model)?,
        };
        let mut base =
            BaseControl::load(&weights, &options.model).unwrap_or_else(|| BaseControl::zero(&options.model));
        let agents =
            |agent_type| self.training.samples.spread(&self.training.samples.sets, agent_type, FITTED_MAX);
        let augmentation = Augmentation {
            noise: options.noisy_history > 0.0,
            differenced: options.differenced_history,
            scale_deviation: options.base_scale_deviation as f32,
            faster: options.faster,
        };
        if options.model.base && (options.begin_with.is_empty() || options.refit_base) {
            progress.note("fitting the base control");
            let cuts_mps = options.vehicle_speed_cuts_mps;
            let before = options.refit_base.then_some(&base);
            base = BaseControl::fit(&options.model, before, agents, augmentation, cuts_mps, options.seed)?;
            base.store(&mut weights);
        } else if options.model.base_support && lacks_support(&weights) {
            progress.note("fitting the support of the base control");
            base.fit_support(agents, augmentation, options.seed)?;
            base.store(&mut weights);
        }
        let mut state = RunState::new(weights, options);
        state.progress.recordings = self.recordings();
        Ok((state, base))
    }

    /// SHA-256 of the user's own recordings.
    fn recordings(&self) -> Vec<String> {
        let own = self.training.sources().iter().filter(|_| !self.options.files.is_empty());
        own.map(|source| source.sha256.clone()).collect()
    }

    fn learn(
        &self,
        state: &mut RunState,
        base: &BaseControl,
        progress: &mut Progress,
    ) -> Result<(), TrainError> {
        let options = self.options;
        let (begun, before_s) = (Instant::now(), state.progress.seconds);
        let mut log = Log::open(&options.checkpoints, state.progress.step)?;
        let mut diverged = 0;
        while state.progress.step < options.steps && state.progress.stale < options.patience {
            if state.progress.step.is_multiple_of(options.validate_every) {
                state.progress.seconds = before_s + begun.elapsed().as_secs_f64();
                self.validate(state, base, progress, &log)?;
            }
            let rate = state.adam.rate(state.progress.step, options.steps);
            let (parts, finite) = self.update(state, base)?;
            diverged = if finite { 0 } else { diverged + 1 };
            if diverged == DIVERGED_STEPS {
                return Err(TrainError::Diverged { step: state.progress.step });
            }
            state.progress.step += 1;
            let seconds = before_s + begun.elapsed().as_secs_f64();
            log.update(state.progress.step, (seconds, rate), (&options.objective, parts))?;
            progress.step(state.progress.step, parts);
        }
        state.progress.seconds = before_s + begun.elapsed().as_secs_f64();
        self.validate(state, base, progress, &log)
    }

    /// One update. The seed of the run and the number of the update determine its random numbers.
    fn update(&self, state: &mut RunState, base: &BaseControl) -> Result<(LossParts, bool), TrainError> {
        let options = self.options;
        let mut random = self.training.random(state.progress.step);
        let clips = self.training.draw(&mut random)?;
        let counted: usize = clips.iter().flatten().map(counted_in).sum();
        if counted == 0 {
            return Ok((LossParts::default(), true));
        }
        let parts = self.differentiate(state, base, &split(clips, options.workers), counted, &random)?;
        let mut parts = parts.into_iter();
        let Some(mut whole) = parts.next() else { return Ok((LossParts::default(), true)) };
        for part in parts {
            whole.gradients.add(&part.gradients);
            whole.parts = whole.parts.plus(part.parts);
        }
        let rate = state.adam.rate(state.progress.step, options.steps);
        let norm = state.adam.step(&mut state.weights, &mut whole.gradients, rate);
        let finite = norm.is_finite() && whole.parts.is_finite();
        if finite {
            for (name, values) in whole.statistics {
                if let Some(tensor) = state.weights.0.get_mut(&name) {
                    tensor.values = values;
                }
            }
        }
        state.progress.adam_steps = state.adam.steps;
        Ok((whole.parts, finite))
    }

    /// Differentiates the parts of a batch in parallel, each with its own random stream.
    fn differentiate(
        &self,
        state: &RunState,
        base: &BaseControl,
        parts: &[Vec<SceneView<'_>>],
        counted: usize,
        random: &ChaCha8Rng,
    ) -> Result<Vec<Differentiated>, TrainError> {
        let options = self.options;
        threads::each(parts, |number, scenes| {
            let batch = self.training.batch_of(scenes, base)?;
            let draws = self.training.draws(&batch, random, number);
            let done = state.progress.step as f32 / options.steps as f32;
            let (objective, model) = (&options.objective, &options.model);
            let learned = Learned::of(&options.optimiser);
            Ok(differentiate(objective, model, &state.weights, &batch, (counted, done), &draws, learned))
        })
    }

    fn validate(
        &self,
        state: &mut RunState,
        base: &BaseControl,
        progress: &Progress,
        log: &Log,
    ) -> Result<(), TrainError> {
        let average = state.adam.average.clone();
        let scores = self.scores(&average, base, Some(MapKind::Online), self.options.validation_agents)?;
        let figure = choose_by(&scores);
        progress.note(&format!("validation at {}: {figure:.4}\n{}", state.progress.step, table(&scores)));
        let (step, seconds) = (state.progress.step, state.progress.seconds);
        log.write(&Line::Validation { step, seconds, validation: figure, sets: scores })?;
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
        weights: &Tensors,
        base: &BaseControl,
        map: Option<MapKind>,
        agents_max: usize,
    ) -> Result<Vec<SetScore>, TrainError> {
        let validation = Validation {
            config: &self.options.model,
            base,
            baselines: &self.baselines,
            map,
            agents_max,
            workers: self.options.workers,
        };
        validation.scores(weights, &self.validation)
    }

    /// Writes the best weights, calibrated, with their card.
    fn write(
        &self,
        state: &RunState,
        base: &BaseControl,
        agents_max: usize,
    ) -> Result<ModelCard, TrainError> {
        let mut weights = state.best.clone();
        let mut factors = BTreeMap::new();
        if self.options.model.latents == Latents::Points {
            let validation = &self.validation;
            factors = Calibration { config: &self.options.model, base, validation }.apply(&mut weights)?;
        }
        let scores = |map| self.scores(&weights, base, map, agents_max);
        let scores = [scores(Some(MapKind::Online))?, scores(None)?];
        let seen = Seen { windows: self.training.window_count(), agents: self.training.agent_count() };
        let sources = self.training.sources().to_vec();
        let (weights, fitness) = (&weights, base.fitness());
        let card =
            ModelCard::new(self.options, &state.progress, (weights, factors), seen, sources, fitness, scores);
        write_whole(&self.options.out, &card.weights_file(weights)?)?;
        Ok(card)
    }

    /// Writes the weights to begin with, including a base support fitted now, with a revised card. With
    /// several files, the card is the last one's and lists the others.
    fn write_revised(
        &self,
        weights: &Tensors,
        base: &BaseControl,
        agents_max: usize,
    ) -> Result<ModelCard, TrainError> {
        let cards = self.options.begin_with.iter().map(|path| read_card(path));
        let cards = cards.collect::<Result<Vec<_>, _>>()?;
        let card = ModelCard::of_mean(cards, &self.options.begin_with);
        let card = card.unwrap_or_else(|| unreachable!("checked with the options"));
        let scores = |map| self.scores(weights, base, map, agents_max);
        let scores = [scores(Some(MapKind::Online))?, scores(None)?];
        let card = card.revised(self.options, base.fitness(), scores);
        write_whole(&self.options.out, &card.weights_file(weights)?)?;
        Ok(card)
    }
}

fn open(path: &Path) -> Result<nn::Weights, TrainError> {
    nn::Weights::open(path).map_err(|source| TrainError::BeginWith { path: path.to_owned(), source })
}

fn read_card(path: &Path) -> Result<ModelCard, TrainError> {
    let weights = open(path)?;
    let problem = "the weights have no card";
    let card =
        weights.card().cloned().ok_or_else(|| TrainError::Unsuitable { path: path.to_owned(), problem })?;
    let fault = |source| TrainError::Metadata { path: path.to_owned(), key: "card", source };
    serde_json::from_value(card).map_err(fault)
}

/// The mean of weights files of `model`.
fn mean_of_files(paths: &[PathBuf], model: &ModelConfig) -> Result<Tensors, TrainError> {
    let mut mean = Tensors::default();
    for (before, path) in paths.iter().enumerate() {
        let weights = read_weights(path, model)?;
        if before > 0 && !weights.0.keys().eq(mean.0.keys()) {
            return Err(TrainError::other_model(path));
        }
        mean = if before == 0 { weights } else { mean.moved(&weights, 1.0 / (before + 1) as f32) };
    }
    Ok(mean)
}

/// The tensors of a weights file, whose model must be `model`. The support of its base control may be
/// missing.
pub(crate) fn read_weights(path: &Path, model: &ModelConfig) -> Result<Tensors, TrainError> {
    let weights = open(path)?;
    let bytes = std::fs::read(path).map_err(|source| TrainError::Io { path: path.to_owned(), source })?;
    let without = ModelConfig { base_support: false, ..model.clone() };
    let model = [model, &without].into_iter().find(|model| weights.config() == *model);
    let model = model.ok_or_else(|| TrainError::other_model(path))?;
    Tensors::from_safetensors(&bytes, &layout(model)).map_err(|error| error.of(path))
}

/// Whether the weights lack the bounds of the base control's features.
fn lacks_support(weights: &Tensors) -> bool {
    !weights.0.keys().any(|name| name.starts_with("base.") && name.ends_with(".support"))
}

/// Distributes the clips to `parts` parts with about the same number of agents.
fn split(clips: Vec<Vec<SceneView<'_>>>, parts: usize) -> Vec<Vec<SceneView<'_>>> {
    let agents_len = |scenes: &[SceneView<'_>]| scenes.iter().map(|scene| scene.agents.len()).sum::<usize>();
    let mut dealt: Vec<Vec<SceneView<'_>>> = (0..parts).map(|_| Vec::new()).collect();
    for clip in clips {
        if let Some(least) = dealt.iter_mut().min_by_key(|part| agents_len(part)) {
            least.extend(clip);
        }
    }
    dealt.retain(|part| part.iter().flat_map(|scene| &scene.agents).any(|view| view.counts));
    dealt
}

/// The figures of a validation, one line per set.
fn table(scores: &[SetScore]) -> String {
    let line = |score: &SetScore| {
        let cell = |errors: metrics::Errors| format!("{:.3}/{:.3}", errors.ade_m, errors.fde_m);
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
