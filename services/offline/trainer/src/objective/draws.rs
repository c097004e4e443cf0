//! The random numbers of a batch's loss. With them, the loss is a function of the weights.

use std::ops::Range;

use nn::ModelConfig;
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

use super::loss::Objective;
use crate::batch::Batch;
use crate::net::layout::LATENT;
use crate::net::matrix::Matrix;

/// Differentiated draws of every agent in the plus objective: the winner by the mean error, the winner by the
/// error of the last step, a random mode and the single best forecast.
pub(super) const DRAWS: usize = 4;

/// The random numbers of the forecast agents of a batch, type by type.
#[derive(Clone, Debug)]
pub(crate) struct Draws {
    /// A random mode of every agent, in the plus objective.
    pub(crate) modes: Vec<usize>,
    /// Standard normal numbers. Plus objective: those of both draws of the energy score `[agents × 4, horizon ×
    /// 2]`. Paper's objective: those of the posterior and of the prior `[agents, 32]`.
    pub(crate) noise: [Matrix; 2],
}

impl Draws {
    pub(crate) fn new(
        objective: &Objective,
        config: &ModelConfig,
        batch: &Batch<'_>,
        random: &mut impl Rng,
    ) -> Self {
        let (mut modes, mut noise) = (Vec::new(), [Vec::new(), Vec::new()]);
        let lens = batch.forecast.each_ref().map(ExactSizeIterator::len);
        let agents_len: usize = lens.iter().sum();
        let (rows, cols) = match objective {
            Objective::Plus { .. } => {
                let cols = 2 * config.horizon_len;
                for len in lens {
                    modes.extend((0..len).map(|_| random.random_range(0..config.modes)));
                    noise.iter_mut().for_each(|noise| noise.extend(normal(len * DRAWS * cols, random)));
                }
                (agents_len * DRAWS, cols)
            }
            Objective::Paper { .. } => {
                noise = [0, 1].map(|_| normal(agents_len * LATENT, random).collect());
                (agents_len, LATENT)
            }
        };
        Self { modes, noise: noise.map(|values| Matrix::new(rows, cols, values)) }
    }

    /// The draws of some agents in the plus objective.
    pub(super) fn of(&self, agents: Range<usize>) -> Self {
        let rows = agents.start * DRAWS..agents.end * DRAWS;
        Self {
            modes: self.modes[agents].to_vec(),
            noise: self.noise.each_ref().map(|noise| noise.rows_of(rows.clone())),
        }
    }
}

/// Standard normal numbers.
fn normal(len: usize, random: &mut impl Rng) -> impl Iterator<Item = f32> {
    (0..len).map(|_| Distribution::<f32>::sample(&StandardNormal, random))
}
