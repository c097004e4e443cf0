/// The effects of a frame on the tracks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tracked {
    /// Number of tracks written.
    pub track_count: usize,
    /// Number of consecutive frames with these detections, which are ignored because their source is frozen;
    /// 0 if it is not frozen.
    pub frozen_count: u32,
    /// If the frame begins a session: the difference between its stamp and the expected one.
    pub set_by_ns: Option<i64>,
    /// Number of newer frames that were replayed after this out-of-sequence frame; 0 for a frame in sequence.
    pub replayed_count: usize,
    /// Number of tracks that did not fit into the frame: the ones farthest from the ego.
    pub left_out_len: usize,
    /// Number of tracks held, including tentative tracks and tracks that did not fit.
    pub held_count: usize,
    /// Number of tracks started.
    pub started_count: usize,
    /// Number of tracks deleted.
    pub ended_count: usize,
    /// Number of detections that started no track because
    /// [`TrackerOptions::tracks_max`](crate::TrackerOptions::tracks_max) tracks are held.
    pub overflow_count: usize,
    /// Number of detections ignored because another detection of the frame has the same identity.
    pub duplicate_count: usize,
    /// Number of detections processed.
    pub detection_count: usize,
    /// Number of detections that repeat the last one of a moving track to the bit. They are not measurements.
    pub repeated_count: usize,
    /// Number of detections out of their track's reach. They count as misses.
    pub misfit_count: usize,
    /// Number of detections at a placeholder's position.
    pub placeholder_count: usize,
    /// Number of tracks whose state was restarted because misfits agreed, or whose identities were exchanged.
    pub reassigned_count: usize,
    /// Number of failed predictions and updates. Their tracks kept the previous state.
    pub fault_count: usize,
    /// Number of forecasts that could not become a prior. Their tracks continued with the previous prior, or
    /// without one.
    pub refused_count: usize,
}
