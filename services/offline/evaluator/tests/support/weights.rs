//! Weights derived from the onboard ones.
#![expect(clippy::unwrap_used, reason = "a test ends at what it can't do")]

use std::collections::BTreeMap;

use nn::{ModelConfig, Weights};
use safetensors::tensor::{Dtype, TensorView};

/// The onboard weights with changed tensors (values and shapes) and configuration.
pub fn changed(
    tensor: impl Fn(&str, &mut Vec<usize>, &mut Vec<f32>),
    config: impl FnOnce(&mut ModelConfig),
) -> Vec<u8> {
    let onboard = Weights::onboard();
    let mut model = onboard.config().clone();
    config(&mut model);
    let tensors: BTreeMap<String, (Vec<usize>, Vec<u8>)> = onboard
        .shapes()
        .map(|(name, shape)| {
            let mut values = onboard.tensor(name, shape).unwrap().to_vec();
            let mut shape = shape.to_vec();
            tensor(name, &mut shape, &mut values);
            (name.to_owned(), (shape, values.into_iter().flat_map(f32::to_le_bytes).collect()))
        })
        .collect();
    let views = tensors
        .iter()
        .map(|(name, (shape, bytes))| (name, TensorView::new(Dtype::F32, shape.clone(), bytes).unwrap()));
    let metadata = [("config".to_owned(), serde_json::to_string(&model).unwrap())].into();
    safetensors::serialize(views, Some(metadata)).unwrap()
}
