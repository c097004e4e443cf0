//! The batches of a training.
//!
//! A batch has clips: neighbouring windows of one recording, around one agent, with the same augmentation. Clips
//! are drawn with replacement until the batch has [`TrainOptions::batch_agents`] agents to forecast. The seed and
//! the number of a batch determine all its random numbers, also those of its loss. So batches can be made in any
//! order, on any number of threads or processes.

use std::ops::Range;
use std::path::Path;

use data::Recording;
use data::sets::Part;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::TrainError;
use crate::agent_view::SceneView;
use crate::base::BaseControl;
use crate::batch::{Array, Batch, BatchOptions};
use crate::objective::{Draws, Learned, LossParts, Objective, differentiate};
use crate::options::TrainOptions;
use crate::samples::{MapKind, MapView, Samples, Scene, Selection, SetSamples, Source};
use crate::spool::Spooling;
use crate::train::read_weights;
use crate::view::Clip;

/// The windows of recordings, and the batches that a training draws from them.
#[derive(Debug)]
pub struct Windows {
    pub(crate) options: TrainOptions,
    pub(crate) samples: Samples,
}

/// The loss of a batch, and its gradients.
#[derive(Clone, Debug, PartialEq)]
pub struct BatchGradients {
    /// The loss before weighting.
    pub parts: LossParts,
    /// Number of agents that the loss counts.
    pub agents: usize,
    /// Name, shape and values of the gradient by every learned tensor.
    pub gradients: Vec<(String, Vec<usize>, Vec<f32>)>,
}

impl Windows {
    /// Cuts recordings into windows. The scenes are in an unnamed file in [`TrainOptions::checkpoints`].
    ///
    /// # Errors
    /// [`TrainError`] if the options contradict one another, if no window has an agent to forecast, or if the
    /// file can't be written.
    pub fn of(recordings: &[&Recording], options: TrainOptions) -> Result<Self, TrainError> {
        options.check()?;
        let spooling = Spooling::create(&options.checkpoints)?;
        let selection = selection(&options, Part::Train);
        let samples = Samples::of(recordings, selection, &options.model, spooling)?;
        if samples.sets.iter().all(|set| set.windows.is_empty()) {
            let names: Vec<&str> = recordings.iter().map(|recording| &*recording.name).collect();
            let (names, model) = (names.join(", "), &options.model);
            return Err(TrainError::Options(format!(
                "{names}: no agent is known over a window of {} + {} steps of {} s",
                model.history_len, model.horizon_len, model.dt_s
            )));
        }
        Ok(Self { options, samples })
    }

    /// The number of windows.
    #[must_use]
    pub fn window_count(&self) -> usize {
        self.samples.sets.iter().map(|set| set.windows.len()).sum()
    }

    /// The number of agents to forecast in all windows.
    #[must_use]
    pub fn agent_count(&self) -> usize {
        self.samples.sets.iter().map(SetSamples::counted_count).sum()
    }

    /// The recordings.
    #[must_use]
    pub fn sources(&self) -> &[Source] {
        &self.samples.sources
    }

    /// The batch of update `number` on one thread, as arrays in row-major order.
    ///
    /// Agents are sorted by type, and within a type those to forecast come first. A node is an agent at a step;
    /// its row is agent · steps + step. Angles and distances are those of [model §2], in agent frames.
    ///
    /// | array | shape |
    /// |---|---|
    /// | `types`: vehicle 0, cyclist 1, pedestrian 2 | agent |
    /// | `forecast`: 1 for the agents that the loss counts | agent |
    /// | `length_m`, 0 if unknown | agent |
    /// | `truth_m`, `known` | agent, forecast step, 2; agent, forecast step |
    /// | `history.state`, `history.present` | agent, step, 6; agent, step |
    /// | `history.receiver`, `history.sender`: rows of nodes | edge |
    /// | `history.relation_of_edge` | edge |
    /// | `history.relation` | relation, 6 |
    /// | `history.patches`, of which the first is empty | patch, 3, row, column |
    /// | `history.patch_of_node` | agent, step |
    /// | `future.…`, for [`Objective::Paper`] | as `history.…` |
    /// | `random_mode`, for [`Objective::Plus`] | counted agent |
    /// | `noise`: standard normal numbers of the energy score | 2, counted agent, 4, forecast step, 2 |
    /// | `noise`, for [`Objective::Paper`]: of posterior and prior | 2, counted agent, 32 |
    ///
    /// # Errors
    /// [`TrainError::Scratch`] if the windows can't be read.
    pub fn batch(&self, number: u64) -> Result<Vec<Array>, TrainError> {
        let mut random = self.random(number);
        let scenes = self.draw(&mut random)?.concat();
        let base = BaseControl::zero(&self.options.model);
        let batch = self.batch_of(&scenes, &base)?;
        let draws = self.draws(&batch, &random, 0);
        Ok(batch.arrays(&scenes, &self.options.model, &draws))
    }

    /// The trainer's loss and gradients of [`Windows::batch`] `number` for the weights in a file. `done` is the
    /// completed share of the training, which lowers the weight of random modes.
    ///
    /// # Errors
    /// [`TrainError`] if the file can't be read, or holds another model.
    pub fn gradients(&self, number: u64, weights: &Path, done: f32) -> Result<BatchGradients, TrainError> {
        let Self { options, .. } = self;
        let weights = read_weights(weights, &options.model)?;
        let base = BaseControl::load(&weights, &options.model);
        let base = base.unwrap_or_else(|| BaseControl::zero(&options.model));
        let mut random = self.random(number);
        let scenes = self.draw(&mut random)?.concat();
        let batch = self.batch_of(&scenes, &base)?;
        let draws = self.draws(&batch, &random, 0);
        let agents = scenes.iter().map(counted_in).sum();
        let (objective, learned) = (&options.objective, Learned::of(&options.optimiser));
        let found =
            differentiate(objective, &options.model, &weights, &batch, (agents, done), &draws, learned);
        let named = |(name, (_, values)): (String, (usize, Vec<f32>))| {
            let shape = weights.tensor(&name).shape.clone();
            (name, shape, values)
        };
        let gradients = found.gradients.0.into_iter().map(named).collect();
        Ok(BatchGradients { parts: found.parts, agents, gradients })
    }

    /// The random numbers of a batch.
    pub(crate) fn random(&self, number: u64) -> ChaCha8Rng {
        let mut random = ChaCha8Rng::seed_from_u64(self.options.seed);
        random.set_stream(number + 1);
        random
    }

    /// The random numbers of the loss of a part of a batch. Each part has its own stream.
    pub(crate) fn draws(&self, batch: &Batch<'_>, random: &ChaCha8Rng, part: usize) -> Draws {
        let mut random = random.clone();
        random.set_word_pos(u128::from(u64::MAX) * (part as u128 + 1));
        Draws::new(&self.options.objective, &self.options.model, batch, &mut random)
    }

    /// The matrices of some scenes.
    pub(crate) fn batch_of<'a>(
        &'a self,
        scenes: &[SceneView<'_>],
        base: &'a BaseControl,
    ) -> Result<Batch<'a>, TrainError> {
        let options = BatchOptions {
            config: &self.options.model,
            base,
            neighbours_max: self.options.neighbours,
            with_future: matches!(self.options.objective, Objective::Paper { .. }),
        };
        Batch::new(scenes, options)
    }

    /// Clips with at least [`TrainOptions::batch_agents`] counted agents. The probability of a set is
    /// proportional to the root of its size.
    pub(crate) fn draw(&self, random: &mut impl Rng) -> Result<Vec<Vec<SceneView<'_>>>, TrainError> {
        let options = &self.options;
        let sets: Vec<&SetSamples> = self.samples.sets.iter().filter(|set| !set.windows.is_empty()).collect();
        let factor = |set: &SetSamples| options.set_weights.get(set.set.name()).copied().unwrap_or(1.0);
        let weights: Vec<f64> =
            sets.iter().map(|set| factor(set) * (set.windows.len() as f64).sqrt()).collect();
        let mut clips: Vec<Vec<SceneView<'_>>> = Vec::new();
        let (mut agents_len, mut tries) = (0, 0);
        while agents_len < options.batch_agents && tries < options.batch_agents {
            tries += 1;
            let set = sets[weighted(&weights, random)];
            let first = draw_window(&set.sites, options.even_sites, random);
            let recording = set.windows[first].recording;
            let windows = &set.windows[first..(first + options.clip_windows).min(set.windows.len())];
            let windows = windows.iter().take_while(|window| window.recording == recording);
            let scenes: Vec<Scene> =
                windows.map(|window| self.samples.scene(window)).collect::<Result<_, _>>()?;
            let map = self.draw_map(recording, random);
            let clip = Clip::draw(&scenes, options, random);
            let views: Vec<SceneView<'_>> =
                scenes.iter().map(|scene| clip.show(scene, map, options, random)).collect();
            agents_len += views.iter().map(counted_in).sum::<usize>();
            clips.push(views);
        }
        Ok(clips)
    }

    fn draw_map(&self, recording: u32, random: &mut impl Rng) -> Option<MapView<'_>> {
        let options = &self.options;
        let drawn: f64 = random.random();
        let kind = if drawn < options.without_map {
            return None;
        } else if drawn < options.without_map + options.site_map {
            MapKind::Site
        } else {
            MapKind::Online
        };
        self.samples.map(recording, kind).or_else(|| self.samples.map(recording, MapKind::Online))
    }
}

/// The scenes that a part of a training reads.
pub(crate) fn selection(options: &TrainOptions, part: Part) -> Selection<'_> {
    Selection {
        root: &options.data,
        sets: &[],
        own: &options.files,
        part,
        leave_out: &options.leave_out,
        windows_max: options.windows,
        from_positions: options.from_positions,
        whole_history: options.whole_history,
    }
}

/// The agents of a scene that the loss counts.
pub(crate) fn counted_in(scene: &SceneView<'_>) -> usize {
    scene.agents.iter().filter(|agent| agent.counts).count()
}

/// Draws a window from sites whose probabilities depend on [`TrainOptions::even_sites`].
fn draw_window(sites: &[Range<usize>], even_sites: f64, random: &mut impl Rng) -> usize {
    let weights: Vec<f64> = sites.iter().map(|site| (site.len() as f64).powf(1.0 - even_sites)).collect();
    let site = sites[weighted(&weights, random)].clone();
    random.random_range(site)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Values;
    use crate::own::{own, split_in_time};
    use crate::progress::Progress;
    use crate::tests::recordings::{Scenery, frame_rate};
    use crate::train::Run;

    /// The windows of a recording are those of `stgdat train FILE`.
    #[test]
    fn batches_are_those_of_a_training_on_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let scenery = Scenery::random(frame_rate(data::Format::Csv), &mut random);
        let path = scenery.write(data::Format::Csv, folder.path());
        let mut options = own(vec![path.clone()]);
        (options.checkpoints, options.batch_agents) = (folder.path().to_owned(), 8);
        (options.model.history_len, options.model.horizon_len) = (2, 2);
        let run = Run::prepare(&options, &Progress::new(1, 0)).unwrap();
        let [train, _] = split_in_time(data::open(&path, None).unwrap(), 0.8);
        let windows = Windows::of(&[&train], options.clone()).unwrap();
        assert_eq!(windows.sources(), run.training.sources());
        assert_eq!(windows.agent_count(), run.training.agent_count());
        for number in [0, 3] {
            let batch = windows.batch(number).unwrap();
            assert_eq!(batch, run.training.batch(number).unwrap());
            let forecast = batch.iter().find(|array| array.name == "forecast").unwrap();
            let Values::Indices(flags) = &forecast.values else { panic!("{forecast:?}") };
            assert!(flags.iter().sum::<i64>() >= 8);
        }
        assert_ne!(windows.batch(0).unwrap(), windows.batch(1).unwrap());
    }

    #[test]
    fn sites_are_drawn_by_size_or_uniformly() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut share_of_the_smaller = |even_sites| {
            let drawn: Vec<usize> =
                (0..10_000).map(|_| draw_window(&[0..900, 900..1000], even_sites, &mut random)).collect();
            assert!(drawn.iter().all(|&window| window < 1000));
            drawn.iter().filter(|&&window| window >= 900).count() as f64 / 10_000.0
        };
        for (even_sites, share) in [(0.0, 0.1), (0.5, 0.25), (1.0, 0.5)] {
            let found = share_of_the_smaller(even_sites);
            assert!((found - share).abs() < 0.02, "{even_sites}: {found}");
        }
    }
}
