//! The compared layers, by our kernels, and their products in faer.

use std::hint::black_box;
use std::time::Instant;

use console::failure::Failure;
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, Par};
use nn::kernels::peak;
use nn::{
    BurnIn, ContextCnn, ContextMemory, Decoder, DecoderMemory, Draws, MlpMemory, RAW_CONTROL, RelationMlp,
    Weights,
};
use testing::value;
use wire::{
    AgentType, CONTEXT_EMBEDDING, EDGE_ATTRIBUTES, LATENT, RELATION_FEATURES, STATE_FEATURES, TEMPORAL,
};

use crate::TIME;

/// Side of the square matrices.
const SIDE: usize = 512;
/// Agents of the decoder, forecasts per agent (20 modes and the single best one), and steps.
const AGENTS: usize = 32;
const DRAWS: usize = 21;
const HISTORY: usize = 8;
const HORIZON: usize = 12;
/// Hidden units of decoder and MLPs.
const HIDDEN: usize = 128;
/// Rows of the relation MLP.
const EDGES: usize = 4096;
/// Images of the CNN.
const PATCHES: usize = 64;

/// Runs a layer for [`TIME`] and returns the duration of the fastest call, ms.
pub(super) type Best = Box<dyn FnMut() -> f64>;

/// A layer with a batch; `peers.py` defines the same ones.
pub(super) struct Layer {
    /// Its name in `peers.py`.
    pub key: &'static str,
    pub title: &'static str,
    /// Operations that all libraries perform; for the decoder, those of the recurrence only.
    pub operations: f64,
    pub ours: Best,
    /// The layer's products in faer; `None` for convolutions.
    pub faer: Option<Best>,
}

pub(super) fn all(weights: &Weights) -> Result<[Layer; 4], Failure> {
    Ok([product(), decoder(weights)?, relation(weights)?, context(weights)?])
}

fn product() -> Layer {
    let operations = 2.0 * (SIDE * SIDE * SIDE) as f64;
    Layer {
        key: "product",
        title: "product, 512³",
        operations,
        ours: Box::new(move || operations / peak::product_gflops(TIME) * 1e-6),
        faer: Some(products(vec![[SIDE; 3]])),
    }
}

fn decoder(weights: &Weights) -> Result<Layer, Failure> {
    let decoder = Decoder::new(weights).map_err(Failure::data)?;
    let rows = AGENTS * DRAWS;
    let states: Vec<[f32; STATE_FEATURES]> =
        (0..AGENTS * HISTORY).map(|i| [value(i); STATE_FEATURES]).collect();
    let present = vec![true; states.len()];
    let latents: Vec<[f32; LATENT]> = (0..rows).map(|i| [value(i); LATENT]).collect();
    let summaries: Vec<[f32; TEMPORAL]> = (0..AGENTS).map(|i| [value(i); TEMPORAL]).collect();
    let mut hidden = vec![[0.0; HIDDEN]; AGENTS];
    let mut out = vec![[0.0; RAW_CONTROL]; rows * HORIZON];
    let mut memory = DecoderMemory::default();
    let ours = move || {
        let decoder = decoder.of(AgentType::Vehicle);
        let agents = BurnIn { agents_len: AGENTS, states: &states, present: &present };
        decoder.burn_in(&agents, &mut memory, &mut hidden);
        decoder.forecast(&hidden, &summaries, Draws::Given(black_box(&latents)), &mut memory, &mut out);
        black_box(&out);
    };
    Ok(Layer {
        key: "decoder",
        title: "decoder, 672 rows, width 128, 12 steps",
        operations: 2.0 * (rows * HORIZON * 3 * HIDDEN * HIDDEN) as f64,
        ours: best(ours),
        faer: Some(products(vec![[rows, HIDDEN, 3 * HIDDEN]; HORIZON])),
    })
}

fn relation(weights: &Weights) -> Result<Layer, Failure> {
    let mlp = RelationMlp::new(weights).map_err(Failure::data)?;
    let relations: Vec<[f32; RELATION_FEATURES]> =
        (0..EDGES).map(|i| [value(i); RELATION_FEATURES]).collect();
    let mut out = vec![[0.0; EDGE_ATTRIBUTES]; EDGES];
    let mut memory = MlpMemory::default();
    let sizes = [RELATION_FEATURES, HIDDEN, HIDDEN, HIDDEN, EDGE_ATTRIBUTES];
    let shapes: Vec<[usize; 3]> = sizes.windows(2).map(|pair| [EDGES, pair[0], pair[1]]).collect();
    Ok(Layer {
        key: "relation",
        title: "relation MLP, 4096 edges",
        operations: shapes.iter().map(|[m, k, n]| 2.0 * (m * k * n) as f64).sum(),
        ours: best(move || {
            mlp.embed(black_box(&relations), &mut memory, &mut out);
            black_box(&out);
        }),
        faer: Some(products(shapes)),
    })
}

fn context(weights: &Weights) -> Result<Layer, Failure> {
    let cnn = ContextCnn::new(weights).map_err(Failure::data)?;
    let patches: Vec<f32> = (0..PATCHES * cnn.patch_len()).map(value).collect();
    let (mut out, mut memory) = (vec![[0.0; CONTEXT_EMBEDDING]; PATCHES], ContextMemory::default());
    Ok(Layer {
        key: "context",
        title: "context CNN, 64 patches",
        operations: 2.0 * (PATCHES * cnn.multiply_adds()) as f64,
        ours: best(move || {
            cnn.embed(black_box(&patches), &mut memory, &mut out);
            black_box(&out);
        }),
        faer: None,
    })
}

/// Times calls of `work` for [`TIME`] and returns the fastest.
fn best(mut work: impl FnMut() + 'static) -> Best {
    Box::new(move || {
        let (start, mut least) = (Instant::now(), f64::INFINITY);
        loop {
            let before = Instant::now();
            work();
            least = least.min(before.elapsed().as_secs_f64() * 1e3);
            if start.elapsed() >= TIME {
                return least;
            }
        }
    })
}

/// Consecutive products of shape [rows, inner, columns] in faer.
fn products(shapes: Vec<[usize; 3]>) -> Best {
    let matrix = |rows, columns| Mat::from_fn(rows, columns, |i, j| value(i * 31 + j));
    let mut all: Vec<[Mat<f32>; 3]> =
        shapes.into_iter().map(|[m, k, n]| [matrix(m, k), matrix(k, n), matrix(m, n)]).collect();
    best(move || {
        for [a, b, out] in &mut all {
            matmul(&mut *out, Accum::Replace, &*a, &*b, 1.0, Par::Seq);
        }
        black_box(&all);
    })
}
