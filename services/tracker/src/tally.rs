/// What was not as it should be, counted from the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Frames that came late and were taken in.
    pub late_len: u64,
    /// Frames that came too late.
    pub too_late_len: u64,
    /// Frames of a stamp that had been taken in.
    pub repeated_len: u64,
    /// As [`Tracked::faults_len`](crate::Tracked::faults_len).
    pub faults_len: u64,
    /// As [`Tracked::refused_len`](crate::Tracked::refused_len).
    pub refused_len: u64,
}

/// What has been warned of. Each trouble is told when its count has doubled: one that comes with every frame must not fill
/// the log.
#[derive(Debug, Default)]
pub(crate) struct Warned(Tally);

impl Warned {
    /// Warns of each count that has doubled since.
    pub(crate) fn warn(&mut self, now: Tally) {
        let Tally { late_len, too_late_len, repeated_len, faults_len, refused_len } = &mut self.0;
        for (what, warned_len, now_len) in [
            ("frames taken in late", late_len, now.late_len),
            ("frames refused, too late to be taken in", too_late_len, now.too_late_len),
            ("frames refused, of a stamp that was taken in", repeated_len, now.repeated_len),
            ("predictions or updates failed", faults_len, now.faults_len),
            ("forecasts refused as a prior", refused_len, now.refused_len),
        ] {
            if now_len > 0 && now_len >= 2 * *warned_len {
                tracing::warn!("{now_len} {what} so far");
                *warned_len = now_len;
            }
        }
    }
}
