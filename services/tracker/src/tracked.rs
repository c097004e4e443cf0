/// What a frame did to the tracks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tracked {
    /// Tracks written.
    pub tracks_len: usize,
    /// Frames in a row with these detections, which are left aside because their source is frozen; 0 where it is
    /// not.
    pub frozen_len: u32,
    /// Newer frames that were replayed after this one, which came out of sequence; 0 for a frame in sequence.
    pub replayed_len: usize,
    /// Tracks that found no place in the frame: the farthest from the ego.
    pub left_out_len: usize,
    /// Tracks held, the tentative and the left out included.
    pub held_len: usize,
    /// Tracks started.
    pub started_len: usize,
    /// Tracks deleted.
    pub ended_len: usize,
    /// Detections that started no track because
    /// [`TrackerOptions::tracks_max`](crate::TrackerOptions::tracks_max) are held.
    pub overflow_len: usize,
    /// Detections left aside because another one of the frame carries the same identity.
    pub duplicates_len: usize,
    /// Detections taken in.
    pub detections_len: usize,
    /// Detections that repeat the last one of a moving track to the bit: no measurements.
    pub repeated_len: usize,
    /// Detections that their track can't have reached: it was missed.
    pub misfits_len: usize,
    /// Detections at a placeholder's position.
    pub placeholders_len: usize,
    /// Tracks whose state began again because misfits agreed, or that exchanged their identities.
    pub reassigned_len: usize,
    /// Predictions and updates that failed; their tracks kept the state before.
    pub faults_len: usize,
    /// Forecasts that could not become a prior; their tracks went on by the one before, or without.
    pub refused_len: usize,
}
