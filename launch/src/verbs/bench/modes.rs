//! Weights with fewer modes, to measure the cost of a mode. They keep a model's first modes, regardless of
//! their accuracy.

use std::path::Path;

use nn::{ModelConfig, Weights};
use safetensors::Dtype;
use safetensors::tensor::TensorView;

use console::failure::Failure;

/// Returns the mode axis of a tensor.
fn axis_of_modes(name: &str) -> Option<usize> {
    let ends = |ends: &[&str]| ends.iter().any(|end| name.ends_with(end));
    if ends(&[".latents", ".mode.1.weight", ".mode.1.bias"]) {
        Some(0)
    } else {
        ends(&[".anchors"]).then_some(1)
    }
}

/// Returns the first `len` entries of an axis.
fn cut(values: &[f32], shape: &[usize], axis: usize, len: usize) -> Vec<f32> {
    let inner: usize = shape[axis + 1..].iter().product();
    let rows = values.chunks_exact(shape[axis] * inner);
    rows.flat_map(|row| &row[..len * inner]).copied().collect()
}

/// Writes the weights with only their first `modes` modes.
///
/// # Errors
/// [`Failure`] if the file can't be written.
pub(super) fn write_first(weights: &Weights, modes: usize, path: &Path) -> Result<(), Failure> {
    let mut tensors: Vec<(&str, Vec<usize>, Vec<u8>)> = Vec::new();
    for (name, shape) in weights.shapes() {
        let values = weights.tensor(name, shape).map_err(Failure::data)?;
        let (mut shape, mut values) = (shape.to_vec(), values.to_vec());
        if let Some(axis) = axis_of_modes(name) {
            values = cut(&values, &shape, axis, modes);
            shape[axis] = modes;
        }
        tensors.push((name, shape, values.iter().flat_map(|value| value.to_le_bytes()).collect()));
    }
    let config = ModelConfig { modes, ..weights.config().clone() };
    let config = serde_json::to_string(&config).map_err(Failure::data)?;
    let views = tensors.iter().map(|(name, shape, bytes)| {
        Ok((*name, TensorView::new(Dtype::F32, shape.clone(), bytes).map_err(Failure::data)?))
    });
    let views = views.collect::<Result<Vec<_>, Failure>>()?;
    let metadata = [("config".to_owned(), config)].into();
    let bytes = safetensors::serialize(views, Some(metadata)).map_err(Failure::data)?;
    std::fs::write(path, bytes).map_err(|error| Failure::file(path, error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_is_cut_to_its_first_places() {
        let values: Vec<f32> = (0..12).map(|i| i as f32).collect();
        assert_eq!(cut(&values, &[2, 3, 2], 1, 2), [0.0, 1.0, 2.0, 3.0, 6.0, 7.0, 8.0, 9.0]);
        assert_eq!(cut(&values, &[3, 4], 0, 1), [0.0, 1.0, 2.0, 3.0]);
    }

    #[test]
    fn the_embedded_weights_can_have_fewer_modes() {
        let path = std::env::temp_dir().join(format!("stgdat_modes_{}.safetensors", std::process::id()));
        write_first(&Weights::onboard(), 6, &path).unwrap();
        let fewer = Weights::open(&path);
        std::fs::remove_file(&path).unwrap();
        let fewer = fewer.unwrap();
        assert_eq!(fewer.config().modes, 6);
        nn::Decoder::new(&fewer).expect("all tensors fit");
        assert_eq!(fewer.shapes().count(), Weights::onboard().shapes().count());
    }
}
