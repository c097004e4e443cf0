//! The forecast distribution as a density over the ground.

use wire::tick_view::ForecastView;

use super::contour::{Place, Raster};

/// Nodes along the longer side of a density's raster.
const NODES: usize = 260;
/// Number of standard deviations beyond which a component adds nothing.
const REACH: f64 = 4.0;
/// Variance added to every component, in squared raster spacings. Nothing is finer than the raster.
const RASTER_VARIANCE: f64 = 0.6;
/// Movement of a mode between two moments, in standard deviations. Neighbouring moments overlap when drawn.
const HOP: f64 = 0.5;
/// Lower bound of the standard deviation when the number of moments is computed.
const FINEST_M: f64 = 0.05;
/// Maximum number of moments per step of the forecast.
const PER_STEP_MAX: f64 = 24.0;

/// A Gaussian of a mixture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Component {
    /// The probability.
    pub weight: f64,
    /// The mean, m.
    pub mean: Place,
    /// The covariance (xx, xy, yy), m².
    pub covariance: [f64; 3],
}

/// The mixture at one time.
pub type Mixture = Vec<Component>;

/// The mixtures at the forecast's steps and at moments in between, with modes interpolated evenly.
pub fn moments(now: Place, forecast: &ForecastView) -> Vec<Mixture> {
    let step_count = forecast.modes.first().map_or(0, Vec::len);
    let mut last = starting(now, forecast);
    let mut moments = Vec::new();
    for step in 0..step_count {
        let next = at_step(forecast, step);
        let pairs = || last.iter().zip(&next);
        let hop = |(a, b): (&Component, &Component)| {
            (b.mean[0] - a.mean[0]).hypot(b.mean[1] - a.mean[1]) / (HOP * b.narrowest_m().max(FINEST_M))
        };
        let per_step = pairs().map(hop).fold(1.0, f64::max).min(PER_STEP_MAX).ceil();
        for part in 1..=per_step as usize {
            let share = part as f64 / per_step;
            moments.push(pairs().map(|(a, b)| a.towards(b, share)).collect());
        }
        last = next;
    }
    moments
}

/// The mixture at the forecast's last step; empty if the forecast has no steps.
pub fn end(forecast: &ForecastView) -> Mixture {
    let step_count = forecast.modes.first().map_or(0, Vec::len);
    step_count.checked_sub(1).map(|step| at_step(forecast, step)).unwrap_or_default()
}

fn starting(now: Place, forecast: &ForecastView) -> Mixture {
    let weights = forecast.probability.iter().map(|probability| f64::from(*probability));
    weights.map(|weight| Component { weight, mean: now, covariance: [0.0; 3] }).collect()
}

fn at_step(forecast: &ForecastView, step: usize) -> Mixture {
    let modes = forecast.modes.iter().zip(&forecast.covariance).zip(&forecast.probability);
    modes
        .map(|((means, covariances), probability)| Component {
            weight: f64::from(*probability),
            mean: means[step].map(f64::from),
            covariance: covariances[step].map(f64::from),
        })
        .collect()
}

impl Component {
    /// Standard deviation in the narrowest direction.
    fn narrowest_m(&self) -> f64 {
        let [xx, xy, yy] = self.covariance;
        let variance = (xx + yy) / 2.0 - ((xx - yy) / 2.0).hypot(xy);
        variance.max(0.0).sqrt()
    }

    fn towards(&self, other: &Self, share: f64) -> Self {
        let mix = |a: f64, b: f64| a + (b - a) * share;
        Self {
            weight: other.weight,
            mean: [0, 1].map(|axis| mix(self.mean[axis], other.mean[axis])),
            covariance: [0, 1, 2].map(|entry| mix(self.covariance[entry], other.covariance[entry])),
        }
    }
}

/// A raster of zeros that is large enough for all mixtures.
pub fn raster_for<'a>(mixtures: impl Iterator<Item = &'a Mixture>) -> Option<Raster> {
    let mut corners: Option<[Place; 2]> = None;
    for component in mixtures.flatten().filter(|component| component.weight > 0.0) {
        let reach =
            [component.covariance[0], component.covariance[2]].map(|variance| REACH * variance.sqrt());
        let (low, high) = corners.get_or_insert([component.mean; 2]).split_at_mut(1);
        for axis in 0..2 {
            low[0][axis] = low[0][axis].min(component.mean[axis] - reach[axis]);
            high[0][axis] = high[0][axis].max(component.mean[axis] + reach[axis]);
        }
    }
    corners.map(|[low, high]| {
        let pad = 0.03 * (high[0] - low[0]).max(high[1] - low[1]).max(0.5);
        Raster::over(low.map(|value| value - pad), high.map(|value| value + pad), NODES)
    })
}

/// Adds the mixture's density to the raster.
pub fn add_density(mixture: &Mixture, share: f64, raster: &mut Raster) {
    let floor = RASTER_VARIANCE * raster.spacing_m * raster.spacing_m;
    for component in mixture.iter().filter(|component| component.weight > 0.0) {
        let [xx, xy, yy] = component.covariance;
        let (xx, yy) = (xx + floor, yy + floor);
        let determinant = (xx * yy - xy * xy).max(floor * floor);
        let peak = share * component.weight / (std::f64::consts::TAU * determinant.sqrt());
        let [rows, cols] = raster.nodes_within(component.mean, [REACH * xx.sqrt(), REACH * yy.sqrt()]);
        for row in rows {
            for col in cols.clone() {
                let [x, y] = raster.place(row, col);
                let (dx, dy) = (x - component.mean[0], y - component.mean[1]);
                let distance2 = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / determinant;
                raster.values[row * raster.cols + col] += peak * (-0.5 * distance2).exp();
            }
        }
    }
}

/// For each of the `shares`, the density above which this share of the raster's mass is found. Returns `None`
/// if the raster has no mass.
pub fn highest_density_levels<const N: usize>(raster: &Raster, shares: [f64; N]) -> Option<[f64; N]> {
    let mut densities: Vec<f64> = raster.values.iter().copied().filter(|density| *density > 0.0).collect();
    densities.sort_by(|a, b| b.total_cmp(a));
    let total: f64 = densities.iter().sum();
    let level = |share: f64| {
        let mut held = 0.0;
        densities.iter().copied().find(|density| {
            held += density;
            held >= share * total
        })
    };
    let mut levels = [0.0; N];
    for (slot, share) in levels.iter_mut().zip(shares) {
        *slot = level(share)?;
    }
    Some(levels)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gaussian(mean: Place, covariance: [f64; 3], weight: f64) -> Component {
        Component { weight, mean, covariance }
    }

    fn density(mixture: &Mixture) -> Raster {
        let mut raster = raster_for([mixture].into_iter()).unwrap();
        add_density(mixture, 1.0, &mut raster);
        raster
    }

    /// Whether an odd number of sides of the closed lines is to the right of a position.
    fn contains(loops: &[Vec<Place>], [x, y]: Place) -> bool {
        let sides = loops.iter().flat_map(|line| line.iter().zip(line.iter().cycle().skip(1)));
        sides
            .filter(|(a, b)| (a[1] > y) != (b[1] > y))
            .filter(|(a, b)| x < a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]))
            .count()
            % 2
            == 1
    }

    #[test]
    fn the_density_holds_all_of_the_probability() {
        let mixture =
            vec![gaussian([3.0, -2.0], [0.5, 0.3, 0.4], 0.3), gaussian([9.0, 1.0], [2.0, -0.5, 1.0], 0.7)];
        let raster = density(&mixture);
        let mass: f64 = raster.values.iter().sum::<f64>() * raster.spacing_m * raster.spacing_m;
        assert!((mass - 1.0).abs() < 2e-3, "mass {mass}");
    }

    #[test]
    fn the_regions_of_a_gaussian_are_its_ellipses() {
        let covariance = [2.0, 0.6, 0.5];
        let raster = density(&vec![gaussian([1.0, 2.0], covariance, 1.0)]);
        let shares = [0.5, 0.9];
        let levels = highest_density_levels(&raster, shares).unwrap();
        let determinant = covariance[0] * covariance[2] - covariance[1] * covariance[1];
        for (level, share) in levels.into_iter().zip(shares) {
            let expected = (1.0 - share) / (std::f64::consts::TAU * determinant.sqrt());
            assert!((level / expected - 1.0).abs() < 0.03, "{share}: {level} instead of {expected}");
        }
    }

    #[test]
    fn contours_enclose_their_share_of_draws() {
        let mixture = vec![
            gaussian([0.0, 0.0], [0.3, 0.1, 0.2], 0.5),
            gaussian([4.0, 1.0], [1.0, -0.6, 0.9], 0.3),
            gaussian([1.0, 3.0], [0.1, 0.0, 2.0], 0.2),
        ];
        let raster = density(&mixture);
        let shares = [0.5, 0.9];
        let levels = highest_density_levels(&raster, shares).unwrap();
        let mut normals = kinematics::Normals::new(7, 0, 0);
        let draw_count = 20_000;
        for (level, share) in levels.into_iter().zip(shares) {
            let contours = raster.contours(level);
            let mut held = 0.0;
            for component in &mixture {
                let [xx, xy, yy] = component.covariance;
                let (l11, l21) = (xx.sqrt(), xy / xx.sqrt());
                let l22 = (yy - l21 * l21).sqrt();
                let inside = (0..draw_count)
                    .filter(|_| {
                        let (a, b) = (f64::from(normals.draw()), f64::from(normals.draw()));
                        let place = [component.mean[0] + l11 * a, component.mean[1] + l21 * a + l22 * b];
                        contains(&contours, place)
                    })
                    .count();
                held += component.weight * inside as f64 / f64::from(draw_count);
            }
            assert!((held - share).abs() < 0.015, "the {share} region holds {held}");
        }
    }

    #[test]
    fn without_probability_there_are_no_regions() {
        assert!(raster_for([&vec![gaussian([0.0; 2], [1.0, 0.0, 1.0], 0.0)]].into_iter()).is_none());
        assert!(highest_density_levels(&Raster::over([0.0; 2], [1.0; 2], 9), [0.5]).is_none());
    }
}
