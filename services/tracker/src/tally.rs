use wire::InputCounts;

use crate::tracked::Tracked;

/// Counts of faults since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Out-of-sequence frames that were processed.
    pub out_of_sequence_count: u64,
    /// Sessions that began because the clock of the stamps was set.
    pub session_count: u64,
    /// Frames that were refused as too late.
    pub too_late_count: u64,
    /// Frames that were refused because a frame with their stamp was processed before.
    pub repeated_count: u64,
    /// The tracker's part of the counts about the input.
    pub input: InputCounts,
    /// See [`Tracked::fault_count`](crate::Tracked::fault_count).
    pub fault_count: u64,
    /// See [`Tracked::refused_count`](crate::Tracked::refused_count).
    pub refused_count: u64,
}

impl Tally {
    /// Adds the counts of a frame's detections.
    pub(crate) fn add_input(&mut self, tracked: &Tracked) {
        let InputCounts { detections, repeated, misfits, placeholders, reassigned, .. } = &mut self.input;
        for (sum, len) in [
            (detections, tracked.detection_count),
            (repeated, tracked.repeated_count),
            (misfits, tracked.misfit_count),
            (placeholders, tracked.placeholder_count),
            (reassigned, tracked.reassigned_count),
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
        let Tally {
            out_of_sequence_count,
            session_count: _,
            too_late_count,
            repeated_count,
            input,
            fault_count,
            refused_count,
        } = &mut self.0;
        let InputCounts { repeated, misfits, placeholders, reassigned, .. } = input;
        for (what, warned_count, now_count) in [
            ("detections repeated: no measurements", repeated, now.input.repeated),
            ("detections where their track can't be: treated as missed", misfits, now.input.misfits),
            (
                "detections at a placeholder's position: treated as missed",
                placeholders,
                now.input.placeholders,
            ),
            ("tracks continued elsewhere, by detections that agree", reassigned, now.input.reassigned),
        ] {
            if now_count > 0 && now_count / 2 >= *warned_count {
                tracing::warn!("{now_count} {what} so far");
                *warned_count = now_count;
            }
        }
        for (what, warned_count, now_count) in [
            ("out-of-sequence frames processed", out_of_sequence_count, now.out_of_sequence_count),
            ("frames refused as too late", too_late_count, now.too_late_count),
            ("frames refused because their stamp was processed before", repeated_count, now.repeated_count),
            ("predictions or updates failed", fault_count, now.fault_count),
            ("forecasts refused as a prior", refused_count, now.refused_count),
        ] {
            if now_count > 0 && now_count >= 2 * *warned_count {
                tracing::warn!("{now_count} {what} so far");
                *warned_count = now_count;
            }
        }
    }
}
