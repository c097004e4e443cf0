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
//! Positions are projected from latitude and longitude about an [`Origin`], or taken from the tags `local_x`
//! and `local_y` where a node has them, as Autoware's maps do: see [`Coordinates`].

mod corridor;
mod error;
mod geometry;
mod grid;
mod guide;
mod map;
mod osm;
mod projection;
mod routes;
mod tags;

pub use error::{Element, Kind, LaneMapError};
pub use guide::{Guided, GuidedPath, LaneGuide};
pub use map::{Area, LANES_MAX, Lane, LaneMap, POINTS_MAX, SPACING_M, Users};
pub use osm::{ELEMENTS_MAX, MEMBERS_MAX, XML_BYTES_MAX};
pub use projection::{FROM_MERIDIAN_MAX_DEG, Origin, Projector, UnknownOrigin};
pub use routes::{ROUTE_POINTS_MAX, ROUTE_STEP_M, ROUTES_MAX, Route, Routes};

/// Where the positions of nodes come from.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Coordinates {
    /// The tags `local_x` and `local_y`; of nodes without them, latitude and longitude about 0, 0.
    #[default]
    Default,
    /// Latitude and longitude about an origin, whatever the tags say.
    About(Origin),
}

impl Coordinates {
    fn origin(self) -> Origin {
        match self {
            Self::Default => Origin::default(),
            Self::About(origin) => origin,
        }
    }
}
