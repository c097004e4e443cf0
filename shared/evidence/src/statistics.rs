use crate::EXPERTS;

/// Maximum rounds of coordinate descent; few unknowns converge in few.
const ROUNDS: usize = 40;

/// Sums over matured forecasts at one step of the horizon: A = Σ D Dᵀ / s², b = Σ D y / s², and their count.
/// Here y is the truth and D the experts' positions, all relative to constant velocity's. The caller chooses
/// s², in m².
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Statistics {
    /// Σ D Dᵀ / s².
    pub products: [[f64; EXPERTS]; EXPERTS],
    /// Σ D y / s².
    pub targets: [f64; EXPERTS],
    /// Number of forecasts.
    pub len: f64,
}

impl Statistics {
    /// Sums of an assumed forecast in which constant velocity was right and each expert wrong by s. They
    /// prevent overfitting to few forecasts.
    pub(crate) fn doubting() -> Self {
        let mut doubting = Self::default();
        (0..EXPERTS).for_each(|expert| doubting.products[expert][expert] = 1.0);
        doubting
    }

    /// Adds a forecast; `scale_m2` is s².
    pub fn add(&mut self, experts_m: &[[f32; 2]; EXPERTS], truth_m: [f32; 2], scale_m2: f32, weight: f32) {
        let scale = f64::from(weight / scale_m2);
        let dot = |a: [f32; 2], b: [f32; 2]| f64::from(a[0] * b[0] + a[1] * b[1]);
        for (row, &own) in experts_m.iter().enumerate() {
            for (column, &other) in experts_m.iter().enumerate() {
                self.products[row][column] += scale * dot(own, other);
            }
            self.targets[row] += scale * dot(own, truth_m);
        }
        self.len += f64::from(weight);
    }

    /// Adds `factor` times other sums.
    pub fn add_scaled(&mut self, other: &Self, factor: f64) {
        for (own, other) in self.products.as_flattened_mut().iter_mut().zip(other.products.as_flattened()) {
            *own += factor * other;
        }
        self.targets.iter_mut().zip(other.targets).for_each(|(own, other)| *own += factor * other);
        self.len += factor * other.len;
    }

    /// Multiplies the sums, to discount older forecasts.
    pub fn discount(&mut self, factor: f64) {
        let Self { products, targets, len } = self;
        products.as_flattened_mut().iter_mut().chain(targets).for_each(|sum| *sum *= factor);
        *len *= factor;
    }

    /// The experts' weights, nonnegative and at most 1 in sum. Constant velocity has the rest.
    pub fn weights(&self) -> [f32; EXPERTS] {
        let mut weights = [0.0_f64; EXPERTS];
        for _ in 0..ROUNDS {
            let before = weights;
            for expert in 0..EXPERTS {
                let others: f64 = (0..EXPERTS).filter(|&other| other != expert).map(|o| weights[o]).sum();
                self.improve(&mut weights, expert, 1.0 - others);
            }
            // On the border of the simplex one weight can grow only if another shrinks.
            for a in 0..EXPERTS {
                for b in 0..a {
                    self.exchange(&mut weights, a, b);
                }
            }
            if weights == before {
                break;
            }
        }
        weights.map(|weight| weight as f32)
    }

    /// Half the derivative of the loss with respect to a weight.
    fn slope(&self, weights: &[f64; EXPERTS], expert: usize) -> f64 {
        let row = self.products[expert].iter().zip(weights);
        row.map(|(product, weight)| product * weight).sum::<f64>() - self.targets[expert]
    }

    fn improve(&self, weights: &mut [f64; EXPERTS], expert: usize, most: f64) {
        let curvature = self.products[expert][expert];
        if curvature > f64::EPSILON {
            let best = weights[expert] - self.slope(weights, expert) / curvature;
            weights[expert] = best.clamp(0.0, most.max(0.0));
        }
    }

    fn exchange(&self, weights: &mut [f64; EXPERTS], a: usize, b: usize) {
        let curvature = self.products[a][a] + self.products[b][b] - 2.0 * self.products[a][b];
        if curvature > f64::EPSILON {
            let step = (self.slope(weights, b) - self.slope(weights, a)) / curvature;
            let step = step.clamp(-weights[a], weights[b]);
            weights[a] += step;
            weights[b] -= step;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The positions of the first four experts; the others agree with constant velocity.
    fn first_four(experts_m: [[f32; 2]; 4]) -> [[f32; 2]; EXPERTS] {
        let mut all_m = [[0.0; 2]; EXPERTS];
        all_m[..4].copy_from_slice(&experts_m);
        all_m
    }

    fn of(forecasts: &[([[f32; 2]; EXPERTS], [f32; 2])]) -> Statistics {
        let mut statistics = Statistics::default();
        forecasts.iter().for_each(|(experts, truth)| statistics.add(experts, *truth, 1.0, 1.0));
        statistics
    }

    #[test]
    fn the_expert_that_is_right_has_all_weight() {
        let right = |x: f32| (first_four([[x, 0.0], [0.0, x], [-x, 1.0], [0.3, 0.0]]), [x, 0.0]);
        let weights = of(&[right(1.0), right(-2.0), right(5.0)]).weights();
        assert!((weights[0] - 1.0).abs() < 1e-3, "{weights:?}");
        assert!(weights[1..].iter().all(|weight| *weight < 1e-3), "{weights:?}");
    }

    #[test]
    fn experts_that_are_worse_than_constant_velocity_have_none() {
        let wrong = |x: f32| (first_four([[x, 0.0], [x, x], [2.0 * x, 0.0], [x, -x]]), [-0.1 * x, 0.0]);
        assert_eq!(of(&[wrong(1.0), wrong(-2.0)]).weights(), [0.0; EXPERTS]);
    }

    #[test]
    fn doubt_yields_to_many_forecasts_and_not_to_few() {
        let network = |len: usize| {
            let mut statistics =
                of(&vec![(first_four([[1.0, 0.0], [0.0; 2], [0.0; 2], [0.0; 2]]), [1.0, 0.0]); len]);
            statistics.add_scaled(&Statistics::doubting(), 20.0);
            statistics.weights()[0]
        };
        assert!(network(5) < 0.3 && network(400) > 0.9, "{} {}", network(5), network(400));
    }

    #[test]
    fn two_experts_on_either_side_share() {
        let between = |x: f32| (first_four([[x, 0.0], [3.0 * x, 0.0], [0.0; 2], [0.0; 2]]), [2.0 * x, 0.0]);
        let [near, far, ..] = of(&[between(1.0), between(2.0)]).weights();
        assert!((near + 3.0 * far - 2.0).abs() < 1e-3, "{near} {far}");
        assert!(near >= 0.0 && far >= 0.0 && near + far <= 1.0 + 1e-6, "{near} {far}");
    }
}
