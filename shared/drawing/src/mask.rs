//! The mask: the area in which the agent will be according to the forecast distribution.

use std::f64::consts::LN_2;

use wire::tick_view::ForecastView;

use super::contour::{Place, Raster};
use super::mixture::{self, Mixture, add_density, highest_density_levels, raster_for};

/// The probabilities of a mask's regions, largest region first.
pub const SHARES: [f64; 2] = [0.9, 0.5];

/// The times of a forecast that its mask covers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mask {
    /// All times separately: the union of the regions of every moment up to the horizon.
    #[default]
    EveryMoment,
    /// All times pooled: the regions of the mixture over the whole horizon. The agent spends the given share
    /// of the horizon in a region.
    Pooled,
    /// The end of the horizon.
    End,
    /// No mask.
    Hidden,
}

/// The edge of an area, m: closed lines with the area on their left.
pub type Outline = Vec<Vec<Place>>;

impl Mask {
    /// The 90 % and 50 % regions of an agent's forecast. The result is empty if the mask is off or the agent
    /// has no forecast.
    pub fn regions(self, now: Place, forecast: &ForecastView) -> Vec<Outline> {
        let regions = match self {
            Self::Hidden => None,
            Self::End => pooled(&[mixture::end(forecast)]),
            Self::Pooled => pooled(&mixture::moments(now, forecast)),
            Self::EveryMoment => union(&mixture::moments(now, forecast)),
        };
        regions.map(Vec::from).unwrap_or_default()
    }
}

/// The regions of the average of all mixtures.
fn pooled(mixtures: &[Mixture]) -> Option<[Outline; 2]> {
    let mut raster = raster_for(mixtures.iter())?;
    for mixture in mixtures {
        add_density(mixture, 1.0 / mixtures.len() as f64, &mut raster);
    }
    let levels = highest_density_levels(&raster, SHARES)?;
    let region = |which: usize| {
        let values = raster.values.iter().map(|density| density / levels[which]).collect();
        within(Raster { values, ..raster })
    };
    Some([0, 1].map(region))
}

/// The union of the separate regions of all mixtures.
fn union(mixtures: &[Mixture]) -> Option<[Outline; 2]> {
    let mut moment = raster_for(mixtures.iter())?;
    // Densities relative to the level of their region, so that 1 is the edge of every region.
    let mut fields = [moment.clone(), moment.clone()];
    for mixture in mixtures {
        moment.values.fill(0.0);
        add_density(mixture, 1.0, &mut moment);
        let Some(levels) = highest_density_levels(&moment, SHARES) else { continue };
        for (field, level) in fields.iter_mut().zip(levels) {
            for (highest, density) in field.values.iter_mut().zip(&moment.values) {
                *highest = highest.max(density / level);
            }
        }
    }
    Some(fields.map(within))
}

/// The area in which a field of relative densities is at least 1.
fn within(mut field: Raster) -> Outline {
    // Between two nodes the logarithm of a Gaussian is straighter than the Gaussian, so its contours are
    // smoother.
    field.values.iter_mut().for_each(|relative| *relative = relative.ln_1p());
    field.contours(LN_2)
}
