/// Counts of what went wrong, from the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Out-of-sequence frames that were processed.
    pub out_of_sequence_len: u64,
    /// Frames that were refused as too late.
    pub too_late_len: u64,
    /// Frames that were refused because their stamp was processed before.
    pub repeated_len: u64,
    /// As [`Tracked::faults_len`](crate::Tracked::faults_len).
    pub faults_len: u64,
    /// As [`Tracked::refused_len`](crate::Tracked::refused_len).
    pub refused_len: u64,
}

/// The counts last warned of. Each is logged again when it has doubled, so that what happens in every frame
/// does not fill the log.
#[derive(Debug, Default)]
pub(crate) struct Warned(Tally);

impl Warned {
    /// Logs each count that has doubled since.
    pub(crate) fn warn(&mut self, now: Tally) {
        let Tally { out_of_sequence_len, too_late_len, repeated_len, faults_len, refused_len } = &mut self.0;
        for (what, warned_len, now_len) in [
            ("out-of-sequence frames processed", out_of_sequence_len, now.out_of_sequence_len),
            ("frames refused as too late", too_late_len, now.too_late_len),
            ("frames refused because their stamp was processed before", repeated_len, now.repeated_len),
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
