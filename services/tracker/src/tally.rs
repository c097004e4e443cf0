use wire::InputCounts;

use crate::tracked::Tracked;

/// Counts of faults since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Out-of-sequence frames that were processed.
    pub out_of_sequence_len: u64,
    /// Frames that were refused as too late.
    pub too_late_len: u64,
    /// Frames that were refused because a frame with their stamp was processed before.
    pub repeated_len: u64,
    /// The tracker's part of the counts about the input.
    pub input: InputCounts,
    /// See [`Tracked::faults_len`](crate::Tracked::faults_len).
    pub faults_len: u64,
    /// See [`Tracked::refused_len`](crate::Tracked::refused_len).
    pub refused_len: u64,
}

impl Tally {
    /// Adds the counts of a frame's detections.
    pub(crate) fn add_input(&mut self, tracked: &Tracked) {
        let InputCounts { detections, repeated, misfits, placeholders, reassigned, .. } = &mut self.input;
        for (sum, len) in [
            (detections, tracked.detections_len),
            (repeated, tracked.repeated_len),
            (misfits, tracked.misfits_len),
            (placeholders, tracked.placeholders_len),
            (reassigned, tracked.reassigned_len),
        ] {
            *sum = sum.saturating_add(u32::try_from(len).unwrap_or(u32::MAX));
        }
    }
}

/// The counts at the last warnings. Each count is logged again when it has doubled, so that a fault in every
/// frame does not fill the log.
#[derive(Debug, Default)]
pub(crate) struct Warned(Tally);

impl Warned {
    /// Logs each count that has doubled since.
    pub(crate) fn warn(&mut self, now: Tally) {
        let Tally { out_of_sequence_len, too_late_len, repeated_len, input, faults_len, refused_len } =
            &mut self.0;
        let InputCounts { repeated, misfits, placeholders, reassigned, .. } = input;
        for (what, warned_len, now_len) in [
            ("detections repeated: no measurements", repeated, now.input.repeated),
            ("detections where their track can't be: treated as missed", misfits, now.input.misfits),
            (
                "detections at a placeholder's position: treated as missed",
                placeholders,
                now.input.placeholders,
            ),
            ("tracks continued elsewhere, by detections that agree", reassigned, now.input.reassigned),
        ] {
            if now_len > 0 && now_len / 2 >= *warned_len {
                tracing::warn!("{now_len} {what} so far");
                *warned_len = now_len;
            }
        }
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
