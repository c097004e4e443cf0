use std::fmt;

use thiserror::Error;

/// Largest number of objects on one side of a [`Frame`]. The measures compare all pairs.
pub const OBJECTS_MAX: usize = 4096;

/// A position (x, y) in metres.
pub type Position = [f64; 2];

/// A true object or a track at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Object {
    /// The same in all frames of a recording, and unique on its side.
    pub id: u64,
    /// Position.
    pub position_m: Position,
}

/// Which of the two sets of a [`Frame`] an object is in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The true objects.
    Truth,
    /// The tracks.
    Track,
}

impl fmt::Display for Side {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Truth => "truth",
            Self::Track => "track",
        })
    }
}

/// Why a measure of tracking refuses its input. Its counts remain unchanged.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum TrackingError {
    /// A coordinate is not finite.
    #[error("{side} {id}: position ({}, {}) is not finite", position_m[0], position_m[1])]
    Position {
        /// The set of the object.
        side: Side,
        /// The id of the object.
        id: u64,
        /// The position as given.
        position_m: Position,
    },
    /// An id occurs twice in a frame.
    #[error("{side} {id} stands twice in one frame")]
    Duplicate {
        /// The set of the objects.
        side: Side,
        /// The repeated id.
        id: u64,
    },
    /// More than [`OBJECTS_MAX`] objects.
    #[error("{len} objects of side {side} in one frame, at most {OBJECTS_MAX} are compared")]
    TooMany {
        /// The set with too many objects.
        side: Side,
        /// Number of objects.
        len: usize,
    },
    /// A parameter or measured value is out of its range.
    #[error("{name} = {value} is not {range}")]
    Value {
        /// Name of the value.
        name: &'static str,
        /// The value as given.
        value: f64,
        /// The valid range.
        range: &'static str,
    },
}

/// Largest gate of [`ClearMot`](super::ClearMot) and [`Identity`](super::Identity), in metres.
const GATE_MAX_M: f64 = 1e6;

/// Refuses a gate that is out of range.
pub(super) fn check_gate(gate_m: f64) -> Result<(), TrackingError> {
    check("gate_m", gate_m, (0.0..=GATE_MAX_M).contains(&gate_m), "between 0 and 1e6")
}

/// Refuses an invalid value.
pub(super) fn check(
    name: &'static str,
    value: f64,
    valid: bool,
    range: &'static str,
) -> Result<(), TrackingError> {
    if valid { Ok(()) } else { Err(TrackingError::Value { name, value, range }) }
}

/// The true objects and the tracks of one instant, validated and sorted by id.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frame {
    truths: Vec<Object>,
    tracks: Vec<Object>,
}

impl Frame {
    /// A frame of these objects, which may be in any order.
    ///
    /// # Errors
    /// If a position is not finite, an id occurs twice on one side, or a side has more than [`OBJECTS_MAX`]
    /// objects.
    pub fn new(truths: &[Object], tracks: &[Object]) -> Result<Self, TrackingError> {
        Ok(Self { truths: by_id(Side::Truth, truths)?, tracks: by_id(Side::Track, tracks)? })
    }

    /// The true objects, by id.
    pub fn truths(&self) -> &[Object] {
        &self.truths
    }

    /// The tracks, by id.
    pub fn tracks(&self) -> &[Object] {
        &self.tracks
    }

    pub(super) fn track(&self, id: u64) -> Option<&Object> {
        self.tracks.binary_search_by_key(&id, |track| track.id).ok().map(|at| &self.tracks[at])
    }

    /// Every pair of a truth and a track, truth by truth, with their distance.
    pub(super) fn pairs(&self) -> impl Iterator<Item = (&Object, &Object, f64)> {
        self.truths.iter().flat_map(|truth| {
            self.tracks
                .iter()
                .map(move |track| (truth, track, distance_m(truth.position_m, track.position_m)))
        })
    }
}

fn by_id(side: Side, objects: &[Object]) -> Result<Vec<Object>, TrackingError> {
    if objects.len() > OBJECTS_MAX {
        return Err(TrackingError::TooMany { side, len: objects.len() });
    }
    if let Some(bad) = objects.iter().find(|object| !object.position_m.iter().all(|x| x.is_finite())) {
        return Err(TrackingError::Position { side, id: bad.id, position_m: bad.position_m });
    }
    let mut sorted = objects.to_vec();
    sorted.sort_by_key(|object| object.id);
    match sorted.windows(2).find(|pair| pair[0].id == pair[1].id) {
        Some(pair) => Err(TrackingError::Duplicate { side, id: pair[0].id }),
        None => Ok(sorted),
    }
}

pub(super) fn distance_m(a: Position, b: Position) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    const HERE: Object = Object { id: 3, position_m: [1.0, 2.0] };

    #[test]
    fn invalid_objects_are_refused_with_side_and_id() {
        let lost = Object { id: 4, position_m: [0.0, f64::NAN] };
        let refused = Frame::new(&[HERE], &[HERE, lost]).unwrap_err();
        assert_eq!(refused.to_string(), "track 4: position (0, NaN) is not finite");
        let far = Object { id: 4, position_m: [f64::INFINITY, 0.0] };
        let refused = Frame::new(&[far], &[]).unwrap_err();
        assert_eq!(refused.to_string(), "truth 4: position (inf, 0) is not finite");
        let refused = Frame::new(&[HERE, HERE], &[]).unwrap_err();
        assert_eq!(refused, TrackingError::Duplicate { side: Side::Truth, id: 3 });
        let refused = Frame::new(&[], &[HERE; OBJECTS_MAX + 1]).unwrap_err();
        assert_eq!(refused, TrackingError::TooMany { side: Side::Track, len: OBJECTS_MAX + 1 });
    }

    #[test]
    fn row_order_changes_no_frame() {
        let rows = [HERE, Object { id: 1, ..HERE }, Object { id: 2, ..HERE }];
        let turned = [rows[2], rows[0], rows[1]];
        assert_eq!(Frame::new(&rows, &turned).unwrap(), Frame::new(&turned, &rows).unwrap());
    }
}
