//! Detects a frozen source: the content of the detections stays the same while their stamps advance. Causes
//! are a camera that hangs, or a buffer that is sent again.

use wire::{DETECTIONS_MAX, Detection, detection_flags};

/// Slower agents may be measured at the same position in several frames.
const MOVING_MIN_MPS: f32 = 1.0;

/// The newest detections that differ from the previous ones.
#[derive(Debug)]
pub(crate) struct Repetition {
    detections: Vec<Detection>,
    stamp_ns: i64,
    /// Number of consecutive frames with these detections.
    frames: u32,
    /// Whether an agent in them moves.
    moves: bool,
}

impl Repetition {
    pub fn new() -> Self {
        let detections = Vec::with_capacity(DETECTIONS_MAX);
        Self { detections, stamp_ns: i64::MIN, frames: 0, moves: false }
    }

    /// Returns the number of consecutive frames with the same detections, including this one. The result is 1
    /// if no agent in them moves. `tracks_move` returns whether a track moves, for detections without speed.
    pub fn look(
        &mut self,
        stamp_ns: i64,
        detections: &[Detection],
        tracks_move: impl FnOnce() -> bool,
    ) -> u32 {
        // Bit by bit, because a repeated measurement differs somewhere.
        let bytes = bytemuck::cast_slice::<Detection, u8>;
        let is_same = bytes(detections) == bytes(&self.detections);
        if !is_same || stamp_ns <= self.stamp_ns {
            self.detections.clear();
            self.detections.extend_from_slice(detections);
            (self.frames, self.moves) = (0, false);
        } else if self.frames == 1 {
            // Decided now, because the tracks will soon stand still.
            self.moves = moves(detections) || (!detections.is_empty() && tracks_move());
        }
        self.stamp_ns = stamp_ns;
        self.frames = self.frames.saturating_add(1);
        if self.moves { self.frames } else { 1 }
    }
}

/// Whether a detection reports that its agent moves.
fn moves(detections: &[Detection]) -> bool {
    detections.iter().any(|d| d.has(detection_flags::HAS_SPEED) && d.speed_mps.abs() >= MOVING_MIN_MPS)
}

/// Whether an agent with this speed moves.
pub(crate) fn is_moving(speed_mps: f64) -> bool {
    speed_mps.abs() >= f64::from(MOVING_MIN_MPS)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn detection(x_m: f32, speed_mps: f32) -> Detection {
        Detection { x_m, speed_mps, flags: detection_flags::HAS_SPEED, ..Detection::default() }
    }

    #[test]
    fn the_same_detections_of_a_moving_agent_are_counted() {
        let mut repetition = Repetition::new();
        let (moving, other) = ([detection(1.0, 5.0)], [detection(1.4, 5.0)]);
        let mut look = |stamp_ns, detections: &[Detection]| repetition.look(stamp_ns, detections, || false);
        assert_eq!([look(1, &moving), look(2, &moving), look(3, &moving)], [1, 2, 3]);
        assert_eq!([look(4, &other), look(5, &moving), look(6, &moving)], [1, 1, 2]);
        assert_eq!(
            [look(6, &moving), look(7, &moving)],
            [1, 2],
            "a stamp that stands still is no repetition"
        );
    }

    #[test]
    fn standing_agents_and_empty_scenes_are_not_frozen() {
        let parked = [detection(1.0, 0.2)];
        let mut repetition = Repetition::new();
        assert!((0..9).all(|stamp_ns| repetition.look(stamp_ns, &parked, || false) == 1));
        assert!((9..18).all(|stamp_ns| repetition.look(stamp_ns, &[], || true) == 1));
        let without_speed = [Detection { flags: 0, ..detection(1.0, 0.0) }];
        let frames: Vec<u32> = (18..21).map(|ns| repetition.look(ns, &without_speed, || true)).collect();
        assert_eq!(frames, [1, 2, 3], "a track moves");
    }
}
