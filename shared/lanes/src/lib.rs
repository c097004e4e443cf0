//! Lanes of a site from a Lanelet2 map, and where an agent may go along them.
//!
//! **In:** OSM XML as Lanelet2 and Autoware write it. **Out:** a [`LaneMap`]: lanes with their middle, width,
//! limit and users, which lane follows which, and which lies beside one; in metres in the world frame of the
//! recordings.
//!
//! * A *lanelet* is a stretch of lane between a left and a right bound, both ways of nodes. Its direction is
//!   that in which the left bound is on the left. Lanelets that are used both ways become two [`Lane`]s.
//! * A lane *follows* another one where both its bounds begin at the nodes at which the other's end.
//! * Two lanes lie *beside* each other where they share a bound; whether one may change over depends on the
//!   kind of line, and on `lane_change` tags.
//! * Of *regulatory elements* only speed limits count.
//!
//! Only content that lanes need is read. What can't be used is skipped and counted in [`Skipped`]; the map is
//! refused if no lane remains, or if a node of a lane has no position.
//!
//! Positions are projected from latitude and longitude about an [`Origin`], or taken from the tags `local_x`
//! and `local_y`, as Autoware's maps have them: see [`Coordinates`].

use std::str::FromStr;

use thiserror::Error;
use wire::WorldOrigin;

mod corridor;
mod error;
mod geometry;
mod grid;
mod guide;
mod map;
mod osm;
mod positions;
mod projection;
mod routes;
mod skipped;
mod tags;

pub use error::{Element, Kind, LaneMapError};
pub use guide::{Guided, GuidedPath, LaneGuide};
pub use map::{Area, LANES_MAX, Lane, LaneMap, POINTS_MAX, SPACING_M, Users};
pub use osm::{MEMBERS_MAX, XML_BYTES_MAX};
pub use projection::{FROM_MERIDIAN_MAX_DEG, Origin, Projector, UnknownOrigin};
pub use routes::{ROUTE_POINTS_MAX, ROUTE_STEP_M, ROUTES_MAX, Route, Routes};
pub use skipped::{Skipped, SkippedKind};

/// Where the positions of nodes come from.
///
/// As text, an origin is `LATITUDE,LONGITUDE` in degrees, or `X,Ym` in metres.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Coordinates {
    /// The map's own frame: the tags `local_x` and `local_y`; if no node of a lane has them, latitude and
    /// longitude about 0, 0.
    #[default]
    Default,
    /// Latitude and longitude about an origin; the tags do not count.
    About(Origin),
    /// The map's own frame less an origin in metres. The own frame of a map without the tags is UTM, unless
    /// it lies within reach of 0, 0.
    Less(WorldOrigin),
}

/// A text that is no origin of a map.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error(
    "`{0}`: expected LATITUDE,LONGITUDE in degrees, within ±84 and ±180, or X,Y in metres as in 81000,50000m"
)]
pub struct UnknownCoordinates(String);

impl FromStr for Coordinates {
    type Err = UnknownCoordinates;

    fn from_str(text: &str) -> Result<Self, UnknownCoordinates> {
        let read = if text.trim_end().ends_with('m') {
            text.parse().ok().map(Self::Less)
        } else {
            text.parse().ok().map(Self::About)
        };
        read.ok_or_else(|| UnknownCoordinates(text.to_owned()))
    }
}

impl std::fmt::Display for Coordinates {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Default => write!(f, "{}", Origin::default()),
            Self::About(origin) => write!(f, "{origin}"),
            Self::Less(origin) => write!(f, "{origin}m"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn origins_in_degrees_and_in_metres_are_told_apart_by_the_unit() {
        for (text, written) in [
            ("49.01, 8.42", "49.01,8.42"),
            ("81000,50000m", "81000,50000m"),
            ("-33.9,151.2", "-33.9,151.2"),
            ("8.5m, -3.25 m", "8.5,-3.25m"),
        ] {
            let read: Coordinates = text.parse().expect(text);
            assert_eq!(read.to_string(), written);
            assert_eq!(matches!(read, Coordinates::Less(_)), text.ends_with('m'), "{text}");
        }
        for text in ["81000,50000", "85,0", "m", "1m", "1,2,3m", "49,8km"] {
            let error = text.parse::<Coordinates>().expect_err(text).to_string();
            assert!(error.contains("X,Y in metres as in 81000,50000m"), "{error}");
        }
    }
}
