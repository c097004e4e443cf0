//! The mask: where the agent will be, as the forecast distribution has it.

use std::f64::consts::LN_2;

use super::contour::{Place, Raster};
use super::mixture::{self, Mixture, add_density, highest_density_levels, raster_for};
use super::scene::ForecastDrawing;

/// The shares that the regions of a mask hold, larger region first.
pub const SHARES: [f64; 2] = [0.9, 0.5];

/// Which times of a forecast its mask stands for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mask {
    /// All: the union of the regions of every moment up to the horizon.
    #[default]
    EveryMoment,
    /// All pooled: the regions of the mixture over the whole horizon, in which the agent spends that share of
    /// it.
    Pooled,
    /// The horizon's end.
    End,
    /// None: no mask.
    Hidden,
}

/// The edge of an area, m: closed lines with the area on their left.
pub type Outline = Vec<Vec<Place>>;

impl Mask {
    /// The regions of an agent's forecast that hold 90 % and 50 %; none where the mask is off or the agent
    /// has no forecast.
    pub fn regions(self, now: Place, forecast: &ForecastDrawing) -> Vec<Outline> {
        let regions = match self {
            Self::Hidden => None,
            Self::End => pooled(&[mixture::end(forecast)]),
            Self::Pooled => pooled(&mixture::moments(now, forecast)),
            Self::EveryMoment => union(&mixture::moments(now, forecast)),
        };
        regions.map(Vec::from).unwrap_or_default()
    }
}

/// The regions of all mixtures, equally likely.
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

/// The union of each mixture's own regions.
fn union(mixtures: &[Mixture]) -> Option<[Outline; 2]> {
    let mut moment = raster_for(mixtures.iter())?;
    // Densities relative to the level of their region, so that 1 is the edge of all of them.
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

/// Where a field of relative densities is at least 1.
fn within(mut field: Raster) -> Outline {
    // Between two nodes the logarithm of a Gaussian is straighter than itself, so that its contours are
    // smoother.
    field.values.iter_mut().for_each(|relative| *relative = relative.ln_1p());
    field.contours(LN_2)
}
