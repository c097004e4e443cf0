use std::str::FromStr;

use thiserror::Error;

use crate::POSITION_MAX_M;

/// Largest coordinate of an origin: beyond the coordinates of all metric map grids.
const ORIGIN_MAX_M: f64 = 1e8;
/// A suggested origin is a multiple of this.
const SUGGESTED_M: f64 = 1_000.0;

/// The origin of the world frame in a map's or a recording's own frame, m.
///
/// The wire contains `f32` within [`POSITION_MAX_M`], so UTM and MGRS coordinates do not fit. A run subtracts
/// one origin from all coordinates, in `f64`.
///
/// ```
/// let origin: wire::WorldOrigin = "458000,5428000".parse()?;
/// assert_eq!(origin.world_m([458_012.25, 5_427_990.5]), Some([12.25, -9.5]));
/// assert_eq!(origin.own_m([12.25, -9.5]), [458_012.25, 5_427_990.5]);
/// assert_eq!(origin.to_string(), "458000,5428000");
/// # Ok::<(), wire::UnknownWorldOrigin>(())
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WorldOrigin([f64; 2]);

/// The text is not an origin in metres.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("`{0}`: expected X,Y in metres, as in 458000,5428000")]
pub struct UnknownWorldOrigin(pub String);

impl WorldOrigin {
    /// The origin at a position in the own frame; `None` if a coordinate is not finite or beyond 100,000 km.
    #[must_use]
    pub fn new(position_m: [f64; 2]) -> Option<Self> {
        position_m.iter().all(|x| x.abs() <= ORIGIN_MAX_M).then_some(Self(position_m))
    }

    /// An origin for positions near this one, in whole kilometres; `None` as for [`WorldOrigin::new`].
    #[must_use]
    pub fn near(position_m: [f64; 2]) -> Option<Self> {
        Self::new(position_m.map(|x| (x / SUGGESTED_M).floor() * SUGGESTED_M))
    }

    /// Its position in the own frame.
    pub const fn position_m(self) -> [f64; 2] {
        self.0
    }

    /// Whether the own frame is the world frame.
    pub fn is_zero(self) -> bool {
        self.0 == [0.0; 2]
    }

    /// A position of the own frame in the world frame; `None` beyond [`POSITION_MAX_M`].
    #[must_use]
    pub fn world_m(self, own_m: [f64; 2]) -> Option<[f32; 2]> {
        let world_m = [0, 1].map(|axis| own_m[axis] - self.0[axis]);
        let fits = world_m.iter().all(|x| x.abs() <= f64::from(POSITION_MAX_M));
        fits.then(|| world_m.map(|x| x as f32))
    }

    /// A position of the world frame in the own frame.
    #[must_use]
    pub fn own_m(self, world_m: [f32; 2]) -> [f64; 2] {
        [0, 1].map(|axis| f64::from(world_m[axis]) + self.0[axis])
    }
}

impl FromStr for WorldOrigin {
    type Err = UnknownWorldOrigin;

    /// Reads `X,Y`, with or without the unit `m`.
    fn from_str(text: &str) -> Result<Self, UnknownWorldOrigin> {
        let metres = |text: &str| text.trim().trim_end_matches('m').trim_end().parse().ok();
        let position_m = text.split_once(',').and_then(|(x, y)| Some([metres(x)?, metres(y)?]));
        position_m.and_then(Self::new).ok_or_else(|| UnknownWorldOrigin(text.to_owned()))
    }
}

impl std::fmt::Display for WorldOrigin {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{},{}", self.0[0], self.0[1])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn origins_are_read_with_and_without_their_unit() {
        for text in ["81000,-50000.5", "81000, -50000.5m", " 81000 m , -50000.5 m"] {
            let origin: WorldOrigin = text.parse().expect(text);
            assert_eq!(origin.position_m(), [81_000.0, -50_000.5], "{text}");
        }
        for text in ["", "1", "1,2,3", "nan,0", "1,inf", "a,b", "1e9,0", "1km,2"] {
            assert!(text.parse::<WorldOrigin>().is_err(), "{text}");
        }
    }

    #[test]
    fn subtraction_is_exact_before_rounding() {
        let origin = WorldOrigin::near([458_321.4, -5_427_999.0]).expect("an origin");
        assert_eq!(origin.position_m(), [458_000.0, -5_428_000.0]);
        assert_eq!(origin.world_m([458_000.125, -5_427_999.875]), Some([0.125, 0.125]));
        assert_eq!(origin.world_m([458_000.0 + 32_769.0, -5_428_000.0]), None);
        assert_eq!(origin.world_m([f64::NAN, 0.0]), None);
    }
}
