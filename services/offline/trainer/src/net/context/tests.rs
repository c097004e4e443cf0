//! The context network against finite differences, the onboard network and itself.

use nn::{ContextCnn, ContextMemory, Weights};
use safetensors::Dtype;
use safetensors::tensor::TensorView;

use super::*;
use crate::net::tensors::TensorRole;
use crate::options::onboard_config;
use crate::tests::check::{values, weighted};

const EMBEDDING: usize = 32;

/// A small model whose channels do not fill a panel.
fn small(stem: StemKind) -> ModelConfig {
    let patch_size = if stem == StemKind::Imagenet { 20 } else { 10 };
    ModelConfig { stem, width: 4, patch_size, ..onboard_config() }
}

/// Random weights: kernels that keep the size of their input, and norms that are not the identity.
fn random(config: &ModelConfig) -> Tensors {
    let mut weights = Tensors::default();
    let entries =
        crate::net::layout::layout(config).into_iter().filter(|entry| entry.name.starts_with("fe.context"));
    for (seed, entry) in entries.enumerate() {
        let len: usize = entry.shape.iter().product();
        let statistic = entry.name.contains("running");
        let (middle, scale) = match entry.shape.as_slice() {
            [_, inputs @ ..] if !inputs.is_empty() => {
                (0.0, (6.0 / inputs.iter().product::<usize>() as f32).sqrt())
            }
            _ if entry.name.ends_with("weight") || entry.name.ends_with("running_var") => (1.0, 0.5),
            _ => (0.3, 0.3),
        };
        let values = values(len, scale, seed as u64).iter().map(|value| middle + value).collect();
        let role = if statistic { TensorRole::Statistic } else { TensorRole::Learned };
        weights.insert(&entry.name, &entry.shape, values, role);
    }
    weights
}

/// Patches with mostly empty cells, like those of a map.
fn patches(config: &ModelConfig, patch_count: usize) -> Vec<f32> {
    let len = patch_count * 3 * config.patch_size * config.patch_size;
    values(len, 1.0, 99).iter().map(|value| value.max(0.0)).collect()
}

/// The onboard network with the same weights.
fn onboard(config: &ModelConfig, weights: &Tensors) -> ContextCnn {
    let bytes: Vec<Vec<u8>> =
        weights.0.values().map(|t| t.values.iter().flat_map(|value| value.to_le_bytes()).collect()).collect();
    let views = weights.0.iter().zip(&bytes).map(|((name, tensor), bytes)| {
        (name.as_str(), TensorView::new(Dtype::F32, tensor.shape.clone(), bytes).unwrap())
    });
    let metadata = [("config".to_owned(), serde_json::to_string(config).unwrap())].into();
    let bytes = safetensors::serialize(views, Some(metadata)).unwrap();
    ContextCnn::new(&Weights::from_bytes(&bytes).unwrap()).unwrap()
}

fn assert_close(name: &str, ours: &[f32], theirs: &[f32]) {
    assert_eq!(ours.len(), theirs.len(), "{name}: length");
    let largest = theirs.iter().fold(0.0_f32, |most, value| most.max(value.abs()));
    for (index, (ours, theirs)) in ours.iter().zip(theirs).enumerate() {
        assert!((ours - theirs).abs() <= 1e-4 * largest, "{name}[{index}]: {ours}, not {theirs}");
    }
}

#[test]
fn running_normalisation_agrees_with_the_onboard_network() {
    for config in [onboard_config(), small(StemKind::Compact), small(StemKind::Imagenet)] {
        let (weights, patches) = (random(&config), patches(&config, 37));
        let ours = embed(&weights, &config, &patches, Normalisation::Running, false);
        assert!(ours.statistics.is_empty());
        let mut theirs = vec![[0.0; EMBEDDING]; 37];
        onboard(&config, &weights).embed(&patches, &mut ContextMemory::default(), &mut theirs);
        assert_close("embedding", &ours.embedding.values, theirs.as_flattened());
    }
}

/// Every tensor has a gradient. Tests of the layers compare each gradient to a percent. Here the differences
/// cross the kinks of seventeen consecutive ReLUs, so the tolerance is a tenth.
#[test]
fn gradients_by_all_tensors_agree_with_differences() {
    const PATCHES: usize = 64;
    const STEP: f64 = 3e-4;
    for stem in [StemKind::Compact, StemKind::Imagenet] {
        for normalisation in [Normalisation::Batch, Normalisation::Running] {
            let config = small(stem);
            let (weights, patches) = (random(&config), patches(&config, PATCHES));
            let direction = Matrix::new(PATCHES, EMBEDDING, values(PATCHES * EMBEDDING, 1.0, 3));
            let mut gradients = Gradients::zeros(&weights);
            embed(&weights, &config, &patches, normalisation, true).backward(
                &weights,
                &mut gradients,
                &direction,
            );
            for (name, (_, gradient)) in &gradients.0 {
                let norm = gradient.iter().map(|g| f64::from(*g).powi(2)).sum::<f64>().sqrt();
                let loss = |step: f64| {
                    let mut moved = weights.clone();
                    let values = &mut moved.0.get_mut(name).unwrap().values;
                    for (value, slope) in values.iter_mut().zip(gradient) {
                        *value += (step / norm * f64::from(*slope)) as f32;
                    }
                    let embedded = embed(&moved, &config, &patches, normalisation, false);
                    weighted(&embedded.embedding.values, &direction.values)
                };
                let slope = (loss(STEP) - loss(-STEP)) / (2.0 * STEP);
                let place = format!("{stem:?} {normalisation:?} {name}");
                assert!(norm > 1.0, "{place}: a gradient of {norm} is lost in the noise");
                assert!(
                    (slope / norm - 1.0).abs() < 0.1,
                    "{place}: {norm} by the backward pass, {slope} by differences"
                );
            }
        }
    }
}

#[test]
fn no_patches_have_no_embeddings_and_no_gradients() {
    let config = small(StemKind::Imagenet);
    let weights = random(&config);
    let embedded = embed(&weights, &config, &[], Normalisation::Running, true);
    assert_eq!(embedded.embedding, Matrix::zeros(0, EMBEDDING));
    let mut gradients = Gradients::zeros(&weights);
    embedded.backward(&weights, &mut gradients, &embedded.embedding);
    assert_eq!(gradients, Gradients::zeros(&weights));
}

#[test]
fn statistics_are_those_of_the_batch() {
    let config = small(StemKind::Compact);
    let (mut weights, patches) = (random(&config), patches(&config, 21));
    let batch = embed(&weights, &config, &patches, Normalisation::Batch, false);
    let norms = weights.0.keys().filter(|name| name.contains("running")).count();
    assert_eq!(batch.statistics.len(), norms);
    let rows = |name: &str| {
        let side = match name.split('.').nth(2) {
            Some("layer2") => 3,
            Some("layer3") => 2,
            Some("layer4") => 1,
            _ => 5,
        };
        (21 * side * side) as f32
    };
    // Running values equal to the batch's own give the same output.
    for (name, moved) in &batch.statistics {
        let old = weights.tensor(name).clone();
        let biased = if name.ends_with("var") { (rows(name) - 1.0) / rows(name) } else { 1.0 };
        let of_batch = old.values.iter().zip(moved).map(|(old, new)| (new - 0.9 * old) / 0.1 * biased);
        weights.insert(name, &old.shape, of_batch.collect(), old.role);
    }
    let running = embed(&weights, &config, &patches, Normalisation::Running, false);
    assert_close("embedding", &running.embedding.values, &batch.embedding.values);
}
