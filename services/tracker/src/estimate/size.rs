use wire::{Detection, Track, detection_flags};

/// Smallest weight of a new detection's size. The published size is the mean of the first 1 / weight sizes, and
/// forgets older ones from then on, because a detector sees more of an agent that comes nearer.
const WEIGHT_MIN: f32 = 0.05;
/// Number of sizes that the size of another tracker's track counts for.
const SIZES_OF_TRACK: u16 = 5;

/// The mean of an agent's reported sizes; 0 if there are none.
#[derive(Clone, Copy, Debug)]
pub(super) struct Size {
    pub length_m: f32,
    pub width_m: f32,
    /// Number of sizes of which it is the mean.
    count: u16,
}

impl Size {
    pub fn of_detection(detection: &Detection) -> Self {
        let mut size = Self { length_m: 0.0, width_m: 0.0, count: 0 };
        size.add(detection);
        size
    }

    /// The size that another tracker has published.
    pub const fn of_track(track: &Track) -> Self {
        let count = if track.length_m > 0.0 { SIZES_OF_TRACK } else { 0 };
        Self { length_m: track.length_m, width_m: track.width_m, count }
    }

    /// Adds the size of a detection, if it reports one.
    pub fn add(&mut self, detection: &Detection) {
        if detection.has(detection_flags::HAS_SIZE) {
            self.count = self.count.saturating_add(1);
            let weight = (1.0 / f32::from(self.count)).max(WEIGHT_MIN);
            let smooth = |old: f32, new: f32| old + weight * (new - old);
            self.length_m = smooth(self.length_m, detection.length_m);
            self.width_m = smooth(self.width_m, detection.width_m);
        }
    }
}
