use super::*;
use crate::net::tensors::TensorRole;
use crate::tests::check::{check, values, weighted};

const CHANNELS: usize = 20;

fn weights() -> Tensors {
    let mut weights = Tensors::default();
    let parts = [("weight", 1.0, TensorRole::Learned), ("bias", 0.0, TensorRole::Learned)];
    let running = [("running_mean", 0.0, TensorRole::Statistic), ("running_var", 1.0, TensorRole::Statistic)];
    for (seed, (part, middle, role)) in parts.into_iter().chain(running).enumerate() {
        let values = values(CHANNELS, 0.5, seed as u64).iter().map(|value| middle + value).collect();
        weights.insert(&format!("norm.{part}"), &[CHANNELS], values, role);
    }
    weights
}

/// Random values around 2, with zeros in the padded channels.
fn map(seed: u64) -> Map {
    let mut map = Map::zeros(9, 7, CHANNELS);
    let filled = values(map.rows() * CHANNELS, 1.5, seed);
    for (row, values) in map.values.chunks_exact_mut(map.channels).zip(filled.chunks_exact(CHANNELS)) {
        row.iter_mut().zip(values).for_each(|(x, value)| *x = 2.0 + value);
    }
    map
}

/// Output of the norm for `x` and an optional shortcut.
fn forward(
    weights: &Tensors,
    normalisation: Normalisation,
    x: &Map,
    shortcut: Option<&Map>,
) -> (Map, NormTrace) {
    let mut pass = Pass { weights, normalisation, statistics: Vec::new() };
    let then = shortcut.map_or(Then::Nothing, Then::AddRelu);
    Norm("norm".to_owned()).forward(&mut pass, x.clone(), then)
}

#[test]
fn gradients_agree_with_differences() {
    let (weights, x, around) = (weights(), map(11), map(12));
    let direction = map(13).values;
    for normalisation in [Normalisation::Batch, Normalisation::Running] {
        for shortcut in [None, Some(&around)] {
            let name = |of: &str| format!("{normalisation:?} {} {of}", shortcut.is_some());
            let (y, trace) = forward(&weights, normalisation, &x, shortcut);
            let mut dy = Map { values: direction.clone(), ..y };
            let mut gradients = Gradients::zeros(&weights);
            let mut pass = BackwardPass { weights: &weights, gradients: &mut gradients };
            let rectified = shortcut.map(|_| &y);
            let dx = Norm("norm".to_owned()).backward(&mut pass, &trace, rectified, &mut dy);
            let loss = |weights: &Tensors, x: &Map, shortcut: Option<&Map>| {
                weighted(&forward(weights, normalisation, x, shortcut).0.values, &direction)
            };
            check(&name("x"), &x.values, &dx.values, (2e-3, 20), |values| {
                loss(&weights, &Map { values: values.to_vec(), ..x }, shortcut)
            });
            for (part, (_, gradient)) in &gradients.0 {
                check(&name(part), weights.get(part), gradient, (1e-3, 20), |values| {
                    let mut moved = weights.clone();
                    moved.insert(part, &[CHANNELS], values.to_vec(), TensorRole::Learned);
                    loss(&moved, &x, shortcut)
                });
            }
            if let Some(around) = shortcut {
                check(&name("shortcut"), &around.values, &dy.values, (2e-3, 20), |values| {
                    loss(&weights, &x, Some(&Map { values: values.to_vec(), ..*around }))
                });
            }
        }
    }
}

#[test]
fn running_values_move_by_a_tenth_towards_the_batch() {
    let (weights, x) = (weights(), map(11));
    let mut pass = Pass { weights: &weights, normalisation: Normalisation::Batch, statistics: Vec::new() };
    Norm("norm".to_owned()).forward(&mut pass, x.clone(), Then::Nothing);
    let [(mean_name, mean), (var_name, var)] = pass.statistics.try_into().unwrap();
    assert_eq!((mean_name.as_str(), var_name.as_str()), ("norm.running_mean", "norm.running_var"));
    for c in 0..CHANNELS {
        let column: Vec<f64> = x.values.chunks_exact(x.channels).map(|row| f64::from(row[c])).collect();
        let len = column.len() as f64;
        let of_batch = column.iter().sum::<f64>() / len;
        let spread = column.iter().map(|x| (x - of_batch).powi(2)).sum::<f64>() / (len - 1.0);
        for (name, new, of_batch) in [(&mean_name, mean[c], of_batch), (&var_name, var[c], spread)] {
            let expected = 0.9 * f64::from(weights.get(name)[c]) + 0.1 * of_batch;
            assert!((f64::from(new) - expected).abs() < 1e-6, "{name}[{c}]: {new}, not {expected}");
        }
    }
}
