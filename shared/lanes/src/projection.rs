//! Projection from latitude and longitude to metres.

use std::str::FromStr;

use thiserror::Error;

/// Semi-major axis of WGS84, m.
const AXIS_M: f64 = 6_378_137.0;
/// Flattening of WGS84.
const FLATTENING: f64 = 1.0 / 298.257_223_563;
/// Scale of UTM on the central meridian.
const SCALE: f64 = 0.9996;
/// Easting of the central meridian in UTM, m.
const EAST_M: f64 = 500_000.0;
/// Northing of the equator in UTM for places south of it, m.
const SOUTH_M: f64 = 10_000_000.0;
/// Width of a zone, degrees.
const ZONE_DEG: f64 = 6.0;
/// Largest distance from the central meridian at which the series is exact to a millimetre, degrees.
pub const FROM_MERIDIAN_MAX_DEG: f64 = 30.0;
/// Largest latitude of UTM, degrees.
const LATITUDE_MAX_DEG: f64 = 84.0;

/// The origin of a map's world frame on the ellipsoid WGS84. In this frame x points east and y north.
/// Coordinates are metres in the UTM zone of the origin, minus the origin's own coordinates.
///
/// This is the projection of Lanelet2's `UtmProjector`. The maps of INTERACTION are drawn about latitude 0,
/// longitude 0, which is the default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Origin {
    /// Latitude, degrees.
    latitude_deg: f64,
    /// Longitude, degrees.
    longitude_deg: f64,
}

/// A text or a place that is not an origin.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("`{0}`: expected LATITUDE,LONGITUDE in degrees, within ±84 and ±180")]
pub struct UnknownOrigin(String);

/// Projects points about an origin.
#[derive(Clone, Copy, Debug)]
pub struct Projector {
    meridian_deg: f64,
    origin_m: [f64; 2],
}

impl Origin {
    /// The origin at a latitude and a longitude; `None` outside UTM.
    #[must_use]
    pub fn new(latitude_deg: f64, longitude_deg: f64) -> Option<Self> {
        let is_on_earth = latitude_deg.abs() <= LATITUDE_MAX_DEG && longitude_deg.abs() <= 180.0;
        is_on_earth.then_some(Self { latitude_deg, longitude_deg })
    }
}

impl FromStr for Origin {
    type Err = UnknownOrigin;

    fn from_str(text: &str) -> Result<Self, UnknownOrigin> {
        let numbers = text.split_once(',').and_then(|(latitude, longitude)| {
            Some((latitude.trim().parse().ok()?, longitude.trim().parse().ok()?))
        });
        let origin = numbers.and_then(|(latitude, longitude)| Self::new(latitude, longitude));
        origin.ok_or_else(|| UnknownOrigin(text.to_owned()))
    }
}

impl std::fmt::Display for Origin {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{},{}", self.latitude_deg, self.longitude_deg)
    }
}

impl Projector {
    /// The projection about an origin.
    #[must_use]
    pub fn new(origin: Origin) -> Self {
        let zone = ((origin.longitude_deg + 180.0) / ZONE_DEG).floor().min(59.0);
        let meridian_deg = ZONE_DEG.mul_add(zone, -180.0) + 0.5 * ZONE_DEG;
        let origin_m = transverse_mercator(origin.latitude_deg, origin.longitude_deg - meridian_deg);
        Self { meridian_deg, origin_m }
    }

    /// The projection of the UTM zone of a place. The central meridian is at 500 km east. For places in the
    /// south, the equator is at 10,000 km north.
    #[must_use]
    pub fn utm(place: Origin) -> Self {
        let south_m = if place.latitude_deg < 0.0 { SOUTH_M } else { 0.0 };
        Self { origin_m: [-EAST_M, -south_m], ..Self::new(place) }
    }

    /// Metres east and north of the origin; `None` if the point is too far from the zone.
    #[must_use]
    pub fn project(&self, latitude_deg: f64, longitude_deg: f64) -> Option<[f64; 2]> {
        let east_deg = (longitude_deg - self.meridian_deg + 180.0).rem_euclid(360.0) - 180.0;
        if !(latitude_deg.abs() <= LATITUDE_MAX_DEG && east_deg.abs() <= FROM_MERIDIAN_MAX_DEG) {
            return None;
        }
        let [x, y] = transverse_mercator(latitude_deg, east_deg);
        Some([x - self.origin_m[0], y - self.origin_m[1]])
    }
}

/// East of the central meridian and north of the equator, m.
///
/// The series is that of Krüger (1912), up to the third power of the third flattening n. Its error is less
/// than a millimetre within 30° of the meridian.
fn transverse_mercator(latitude_deg: f64, east_deg: f64) -> [f64; 2] {
    let n = FLATTENING / (2.0 - FLATTENING);
    let (n2, n3) = (n * n, n * n * n);
    let radius_m = AXIS_M / (1.0 + n) * (1.0 + n2 / 4.0 + n2 * n2 / 64.0);
    let alpha =
        [n / 2.0 - 2.0 / 3.0 * n2 + 5.0 / 16.0 * n3, 13.0 / 48.0 * n2 - 3.0 / 5.0 * n3, 61.0 / 240.0 * n3];
    let (phi, lambda) = (latitude_deg.to_radians(), east_deg.to_radians());
    // The hyperbolic counterpart of the conformal latitude's sine.
    let e = 2.0 * n.sqrt() / (1.0 + n);
    let t = (phi.sin().atanh() - e * (e * phi.sin()).atanh()).sinh();
    let xi = t.atan2(lambda.cos());
    let eta = (lambda.sin() / (1.0 + t * t).sqrt()).atanh();
    let (mut x, mut y) = (eta, xi);
    for (j, alpha) in alpha.into_iter().enumerate() {
        let twice = 2.0 * (j + 1) as f64;
        x += alpha * (twice * xi).cos() * (twice * eta).sinh();
        y += alpha * (twice * xi).sin() * (twice * eta).cosh();
    }
    [SCALE * radius_m * x, SCALE * radius_m * y]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Published position of the CN Tower, Toronto: 17T 630084 4833438. UTM counts 500 km east of the
    /// meridian.
    #[test]
    fn a_known_place_has_its_published_coordinates() {
        let tower = Origin::new(43.642_567, -79.387_139).expect("a place");
        let [x, y] =
            Projector::utm(tower).project(tower.latitude_deg, tower.longitude_deg).expect("its coordinates");
        assert!((x - 630_084.0).abs() < 1.0, "{x}");
        assert!((y - 4_833_438.0).abs() < 1.0, "{y}");
    }

    /// Published position of the opera house of Sydney: 56H 334900 6252300, to 100 m.
    #[test]
    fn northings_in_the_south_count_from_ten_thousand_kilometres() {
        let opera = Origin::new(-33.856_8, 151.215_3).expect("a place");
        let [x, y] =
            Projector::utm(opera).project(opera.latitude_deg, opera.longitude_deg).expect("its coordinates");
        assert!((x - 334_900.0).abs() < 100.0 && (y - 6_252_300.0).abs() < 100.0, "{x} {y}");
    }

    #[test]
    fn the_origin_is_zero_and_north_is_y() {
        for origin in ["0,0", "49.01, 8.42", "-33.9,151.2", "35.6,-179.99"] {
            let origin: Origin = origin.parse().expect("an origin");
            let projector = Projector::new(origin);
            let here = projector.project(origin.latitude_deg, origin.longitude_deg).expect("the origin");
            assert!(here.iter().all(|x| x.abs() < 1e-6), "{here:?}");
            let [x, y] =
                projector.project(origin.latitude_deg + 1e-3, origin.longitude_deg).expect("a point near");
            assert!((y - 110.8).abs() < 0.5 && x.abs() < 4.0, "{origin}: {x} {y}");
        }
    }

    #[test]
    fn places_off_the_earth_are_no_origins() {
        for text in ["", "1", "85,0", "0,181", "nan,0", "a,b", "1,2,3"] {
            assert!(text.parse::<Origin>().is_err(), "{text}");
        }
    }
}
