//! Weights files made from the embedded model by changing a few of its tensors and options.

use safetensors::Dtype;
use safetensors::tensor::TensorView;

/// The content of a weights file, for changes.
pub struct Model {
    /// Configuration.
    pub config: serde_json::Value,
    /// Name, shape and values.
    pub tensors: Vec<(String, Vec<usize>, Vec<f32>)>,
}

/// A value within ±0.5 that differs from one index to the next.
pub fn value(i: usize) -> f32 {
    ((i * 37) % 101) as f32 * 0.01 - 0.5
}

impl Model {
    /// The embedded model.
    pub fn onboard() -> Self {
        let weights = nn::Weights::onboard();
        let tensor = |(name, shape): (&str, &[usize])| {
            (name.to_owned(), shape.to_vec(), weights.tensor(name, shape).unwrap().to_vec())
        };
        Self {
            config: serde_json::to_value(weights.config()).unwrap(),
            tensors: weights.shapes().map(tensor).collect(),
        }
    }

    /// Adds or replaces a tensor, with made-up values.
    pub fn set(&mut self, name: &str, shape: &[usize]) {
        let len = shape.iter().product();
        self.tensors.retain(|(other, ..)| other != name);
        let values = (0..len).map(|i| value(i + name.len())).collect();
        self.tensors.push((name.to_owned(), shape.to_vec(), values));
    }

    /// The file's bytes, with the values as f32 or as f16.
    pub fn bytes(&self, dtype: Dtype) -> Vec<u8> {
        let encode = |x: &f32| match dtype {
            Dtype::F16 => half::f16::from_f32(*x).to_le_bytes().to_vec(),
            _ => x.to_le_bytes().to_vec(),
        };
        let encoded: Vec<(&str, &[usize], Vec<u8>)> = self
            .tensors
            .iter()
            .map(|(name, shape, values)| {
                (name.as_str(), shape.as_slice(), values.iter().flat_map(encode).collect())
            })
            .collect();
        let views = encoded
            .iter()
            .map(|(name, shape, data)| (*name, TensorView::new(dtype, shape.to_vec(), data).unwrap()));
        let metadata = [("config".to_owned(), self.config.to_string())].into();
        safetensors::serialize(views, Some(metadata)).unwrap()
    }

    /// The weights.
    pub fn weights(&self) -> nn::Weights {
        nn::Weights::from_bytes(&self.bytes(Dtype::F32)).unwrap()
    }

    /// The embedded model with all options on: latent points that depend on the base control, mode head,
    /// latent point of the best forecast, base control.
    pub fn with_all_options() -> Self {
        let mut model = Self::onboard();
        let horizon_len = model.config["horizon_len"].as_u64().unwrap() as usize;
        let options = [("latents", "points".into()), ("modes", 20.into()), ("mode_head", true.into())];
        let rest = [("best_latent", true.into()), ("base", true.into()), ("base_latent", true.into())];
        for (key, value) in options.into_iter().chain(rest) {
            model.config[key] = value;
        }
        for name in ["vehicle", "cyclist", "pedestrian"] {
            model.set(&format!("decoder.{name}.latents"), &[20, 32]);
            model.set(&format!("decoder.{name}.latent_best"), &[32]);
            model.set(&format!("decoder.{name}.mode.0.weight"), &[64, 192]);
            model.set(&format!("decoder.{name}.mode.0.bias"), &[64]);
            model.set(&format!("decoder.{name}.mode.1.weight"), &[20, 64]);
            model.set(&format!("decoder.{name}.mode.1.bias"), &[20]);
            model.set(&format!("decoder.{name}.latent_base.weight"), &[32, 2 * horizon_len]);
            model.set(&format!("base.{name}.ridge"), &[3, 8, 26, 2 * horizon_len]);
            model.set(&format!("base.{name}.anchors"), &[72, 20, horizon_len, 2]);
            let cuts = vec![0.5, 1.5, 3.0, 4.5, 6.0, 7.5, 9.5];
            model.tensors.retain(|(other, ..)| other != &format!("base.{name}.speed_cuts"));
            model.tensors.push((format!("base.{name}.speed_cuts"), vec![7], cuts));
        }
        model
    }
}
