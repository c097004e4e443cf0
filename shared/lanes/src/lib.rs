//! Lanes of a site from a Lanelet2 map, and the routes of an agent along them.
//!
//! **In:** OSM XML as written by Lanelet2 and Autoware. **Out:** a [`LaneMap`] in metres in the world frame
//! of the recordings. It contains lanes with their middle, width, speed limit and users, and their successors
//! and neighbours.
//!
//! * A *lanelet* is a stretch of lane between a left and a right bound. Both bounds are ways of nodes. The
//!   direction of the lanelet has the left bound on its left. A lanelet that is used both ways becomes two
//!   [`Lane`]s.
//! * A lane *follows* another lane if both its bounds begin at the nodes at which the other's bounds end.
//! * Two lanes are *neighbours* if they share a bound. The kind of line and `lane_change` tags
//!   determine whether an agent may change between them.
//! * The only *regulatory elements* that count are speed limits.
//!
//! Only content that lanes need is read. Unusable content is skipped and counted in [`Skipped`]. The map is
//! refused if no lane remains, or if a node of a lane has no position.
//!
//! Positions are projected from latitude and longitude about an [`Origin`], or taken from the tags `local_x`
//! and `local_y` that Autoware's maps have: see [`Coordinates`].

use std::str::FromStr;

use thiserror::Error;
use wire::WorldOrigin;

mod corridor;
mod error;
mod geometry;
mod grid;
mod guide;
mod lane;
mod map;
mod osm;
mod positions;
mod projection;
mod routes;
mod skipped;
mod tags;

pub use error::{Element, Kind, LaneMapError};
pub use guide::{Guided, GuidedPath, LaneGuide, LaneLine};
pub use lane::{Lane, POINTS_MAX, SPACING_M, Users};
pub use map::{Area, LANES_MAX, LaneMap};
pub use osm::{MEMBERS_MAX, XML_BYTES_MAX};
pub use projection::{FROM_MERIDIAN_MAX_DEG, Origin, Projector, UnknownOrigin};
pub use routes::{ROUTE_POINTS_MAX, ROUTE_STEP_M, ROUTES_MAX, Route, Routes};
pub use skipped::{Skipped, SkippedKind};

/// The source of the nodes' positions.
///
/// As text, an origin is `LATITUDE,LONGITUDE` in degrees, or `X,Ym` in metres.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Coordinates {
    /// The map's own frame: the tags `local_x` and `local_y`. If no node of a lane has them, the frame is
    /// latitude and longitude about 0, 0.
    #[default]
    Default,
    /// Latitude and longitude about an origin. The tags are ignored.
    About(Origin),
    /// The map's own frame minus an origin in metres. The own frame of a map without the tags is UTM, unless
    /// the map is within reach of 0, 0.
    Less(WorldOrigin),
}

/// A text that is not the origin of a map.
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
