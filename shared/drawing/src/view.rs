//! The part of the world that a panel shows.

use super::canvas::Frame;
use super::contour::Place;
use super::path::Spot;

/// Free ground around the visible places, as a share of their extent, and its minimum.
const MARGIN: f64 = 0.06;
const MARGIN_MIN_M: f64 = 1.0;

/// The world as seen in a frame on the sheet. North is up, and the scale is the same everywhere.
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// The frame.
    pub frame: Frame,
    centre: Place,
    /// Points on paper per metre.
    scale: f64,
}

impl View {
    /// The view that shows all places and at least `extent_min_m` of the world on the frame's shorter side.
    /// Returns `None` if there are no places.
    pub fn of(places: impl Iterator<Item = Place>, frame: Frame, extent_min_m: f64) -> Option<Self> {
        let corners = places.fold(None, |corners: Option<(Place, Place)>, place| {
            let (low, high) = corners.unwrap_or((place, place));
            Some((
                [0, 1].map(|axis| low[axis].min(place[axis])),
                [0, 1].map(|axis| high[axis].max(place[axis])),
            ))
        });
        let (low, high) = corners?;
        let scale = |axis: usize| {
            let extent = high[axis] - low[axis];
            frame.size[axis] / (extent + 2.0 * (MARGIN * extent).max(MARGIN_MIN_M))
        };
        let largest = frame.size[0].min(frame.size[1]) / extent_min_m;
        Some(Self {
            frame,
            centre: [0, 1].map(|axis| (low[axis] + high[axis]) / 2.0),
            scale: scale(0).min(scale(1)).min(largest),
        })
    }

    /// Points on paper per metre.
    pub const fn scale(&self) -> f64 {
        self.scale
    }

    /// The spot of a world position on the sheet.
    pub fn spot(&self, place: Place) -> Spot {
        [
            self.frame.centre_x() + (place[0] - self.centre[0]) * self.scale,
            self.frame.corner[1] + self.frame.size[1] / 2.0 - (place[1] - self.centre[1]) * self.scale,
        ]
    }

    /// The corners of the visible part: the smallest and the largest coordinates.
    pub fn corners(&self) -> (Place, Place) {
        let half = self.frame.size.map(|size| size / 2.0 / self.scale);
        ([0, 1].map(|axis| self.centre[axis] - half[axis]), [0, 1].map(|axis| self.centre[axis] + half[axis]))
    }

    /// A round length of about a quarter of the frame's width, m.
    pub fn round_length_m(&self) -> f64 {
        let most = 0.28 * self.frame.size[0] / self.scale;
        let power = 10.0_f64.powf(most.log10().floor());
        [5.0, 2.0, 1.0]
            .into_iter()
            .map(|factor| factor * power)
            .find(|length| *length <= most)
            .unwrap_or(power)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: Frame = Frame { corner: [10.0, 20.0], size: [200.0, 100.0] };

    #[test]
    fn all_places_are_seen_and_north_is_up() {
        let places = [[3.0, 4.0], [63.0, 14.0], [30.0, -30.0]];
        let view = View::of(places.into_iter(), FRAME, 5.0).unwrap();
        let spots = places.map(|place| view.spot(place));
        for [x, y] in spots {
            assert!(x > FRAME.corner[0] && x < FRAME.right(), "{x}");
            assert!(y > FRAME.corner[1] && y < FRAME.bottom(), "{y}");
        }
        assert!(spots[1][1] < spots[2][1]);
        let (low, high) = view.corners();
        assert!(((high[0] - low[0]) * view.scale() - FRAME.size[0]).abs() < 1e-9);
    }

    #[test]
    fn a_single_place_is_seen_with_its_surroundings() {
        let view = View::of([[5.0, 5.0]].into_iter(), FRAME, 20.0).unwrap();
        assert_eq!(view.scale(), 5.0);
        assert!(View::of(std::iter::empty(), FRAME, 20.0).is_none());
    }

    #[test]
    fn scale_bars_are_round() {
        for extent in [7.0, 12.0, 33.0, 80.0, 250.0] {
            let view = View::of([[0.0; 2]].into_iter(), FRAME, extent).unwrap();
            let length_m = view.round_length_m();
            let digits = length_m / 10.0_f64.powf(length_m.log10().floor());
            assert!([1.0, 2.0, 5.0].iter().any(|digit| (digit - digits).abs() < 1e-9), "{length_m}");
            assert!(length_m * view.scale() <= 0.28 * FRAME.size[0]);
        }
    }
}
