//! The bicycle and its linearised Gaussian against the golden vectors of an independent float64 reference.

#![expect(clippy::unwrap_used, reason = "a broken fixture should fail at once")]

use std::path::PathBuf;

use kinematics::{Belief, Bicycle, BicycleState, ControlGaussian, ControlLimits, Integrator, Vehicle};
use safetensors::SafeTensors;

const TOLERANCE: f32 = 1e-4;

struct Golden {
    scene: serde_json::Value,
    bytes: Vec<u8>,
}

impl Golden {
    fn open(folder: &str) -> Self {
        let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden").join(folder);
        let scene = serde_json::from_slice(&std::fs::read(folder.join("scene.json")).unwrap()).unwrap();
        Self { scene, bytes: std::fs::read(folder.join("tensors.safetensors")).unwrap() }
    }

    fn tensor(&self, name: &str) -> (Vec<usize>, Vec<f32>) {
        let tensors = SafeTensors::deserialize(&self.bytes).unwrap();
        let view = tensors.tensor(name).unwrap();
        let numbers = view.data().chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap()));
        (view.shape().to_vec(), numbers.collect())
    }

    fn number(&self, key: &str) -> f32 {
        self.scene[key].as_f64().unwrap() as f32
    }
}

fn largest(values: &[f32]) -> f32 {
    values.iter().fold(0.0, |most, v| most.max(v.abs()))
}

fn assert_close(what: &str, found: &[f32], expected: &[f32], scale: f32) {
    let off = found.iter().zip(expected).fold(0.0_f32, |most, (f, e)| most.max((f - e).abs()));
    assert!(off <= TOLERANCE * scale, "{what}: off by {off}, scale {scale}\n{found:?}\n{expected:?}");
}

fn check(folder: &str, integrator: Integrator, mean_name: &str, covariance_name: &str) {
    let golden = Golden::open(folder);
    let vehicle = Vehicle {
        bicycle: Bicycle { rear_axle_m: golden.number("rear_axle_m"), slip_limit_rad: None, integrator },
        limits: ControlLimits {
            accel_mps2: golden.number("accel_limit_mps2"),
            slip_rate_radps: golden.number("slip_rate_limit_radps"),
        },
        dt_s: golden.number("dt_s"),
    };
    let (_, initial) = golden.tensor("bicycle.initial");
    let (_, control_means) = golden.tensor("control.mean");
    let (_, control_factors) = golden.tensor("control.cholesky");
    let (shape, means) = golden.tensor(mean_name);
    let (_, covariances) = golden.tensor(covariance_name);
    let [draw_count, vehicle_count, step_count, _] = shape[..] else {
        panic!("{mean_name} has shape {shape:?}")
    };
    let agents_len = golden.scene["agents"].as_u64().unwrap() as usize;
    let scale = largest(&means);

    for draw in 0..draw_count {
        for (row, agent) in golden.scene["vehicles"].as_array().unwrap().iter().enumerate() {
            let agent = agent.as_u64().unwrap() as usize;
            let start = BicycleState::from_column_slice(&initial[row * 5..row * 5 + 5]);
            let mut belief = Belief::certain(start);
            for step in 0..step_count {
                let at = (draw * agents_len + agent) * step_count + step;
                let factor = &control_factors[at * 4..at * 4 + 4];
                let mean = [control_means[at * 2], control_means[at * 2 + 1]];
                let control = ControlGaussian::new(mean, [factor[0], factor[2], factor[3]]);
                belief.advance(&vehicle, &control);

                let at = (draw * vehicle_count + row) * step_count + step;
                let what = format!("{folder}/{mean_name} [{draw}, {row}, {step}]");
                assert_close(&what, belief.mean.as_slice(), &means[at * 5..at * 5 + 5], scale);
                let expected = &covariances[at * 25..at * 25 + 25];
                let what = format!("{folder}/{covariance_name} [{draw}, {row}, {step}]");
                assert_close(&what, belief.covariance.as_slice(), expected, largest(expected));
            }
        }
    }
}

#[test]
fn euler_agrees_with_the_golden_vectors() {
    for folder in ["vehicle", "pedestrian", "plus", "literal"] {
        check(folder, Integrator::Euler, "bicycle.mean", "bicycle.covariance");
    }
}

#[test]
fn midpoint_agrees_with_the_golden_vectors() {
    for folder in ["vehicle", "pedestrian", "plus", "literal"] {
        check(folder, Integrator::Midpoint, "bicycle.midpoint_mean", "bicycle.midpoint_covariance");
    }
}
