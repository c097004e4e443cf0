//! Counts of refused frames, and of links to other boxes.

use crate::declare::{numbers, record};

numbers! {
    /// Why frames were refused, as heartbeats and reports count it.
    pub enum RefusalCause {
        /// Another schema.
        Schema = 1 => "schema",
        /// A frame of another run.
        ForeignRun = 2 => "foreign run",
        /// A frame of a process that has been replaced.
        OldIncarnation = 3 => "old incarnation",
        /// Sizes that exceed their limits, or that do not match each other or the model.
        Size = 4 => "size",
        /// A number that is not finite or is impossible.
        Value = 5 => "value",
        /// Stamps or elements out of order, or repeated.
        Order = 6 => "order",
        /// A check value that does not match header and payload.
        CheckValue = 7 => "check value",
        /// No check value, although pipeline.toml requires one.
        Unprotected = 8 => "unprotected",
        /// A repeated frame, or one that a newer frame has overtaken.
        Repeated = 9 => "repeated",
        /// Content that does not change while its stamps advance.
        Frozen = 10 => "frozen",
    }
}

numbers! {
    /// What a stage counts about its link to other boxes: a [`Refusals::cause`] beyond those of
    /// [`RefusalCause`].
    pub enum LinkCount {
        /// Connections that were authenticated.
        Connections = 64 => "connections",
        /// Frames that were sent, or received and delivered.
        Frames = 65 => "frames",
        /// Frames that a newer one has replaced before they were sent or read.
        Skipped = 66 => "skipped",
        /// Received frames that were too old to be delivered.
        Old = 67 => "too old",
        /// Connections that were lost, and attempts that failed.
        Lost = 68 => "lost",
        /// Connections without a confirmation in time.
        Slow = 69 => "too slow",
        /// Connections with another key.
        WrongKey = 70 => "another key",
        /// Connections that sent something else, another version or damaged frames.
        Garbage = 71 => "garbage",
        /// Connections that found no room.
        Full = 72 => "no room",
        /// Detections outside of the world.
        Outside = 73 => "outside",
        /// Median of the time from the sensor's stamp to the publication, in microseconds.
        SinceStampP50 = 128 => "since stamp p50",
        /// The 99th percentile of the same.
        SinceStampP99 = 129 => "since stamp p99",
        /// The maximum of the same.
        SinceStampMax = 130 => "since stamp max",
    }
}

impl LinkCount {
    /// Whether this is a measured time, which does not add up over restarts.
    #[must_use]
    pub const fn is_time(self) -> bool {
        self as u32 >= Self::SinceStampP50 as u32
    }
}

record! {
    /// Frames of one sender that one reader has refused for one cause, or a count of the reader's link.
    #[derive(Eq)]
    pub struct Refusals: 8 bytes {
        /// The [`StageId`](crate::StageId) of the frames' sender as a number; 0 if the sender is not a stage.
        0 => sender: u16,
        /// The [`RefusalCause`] or [`LinkCount`] as a number; 0 if the entry is free.
        2 => cause: u16,
        /// Number of frames, or the count of the link.
        4 => frames_len: u32,
    }
}

impl Refusals {
    /// Counts frames of `sender` that were refused for `cause`. If all entries are taken by others, the
    /// frames are only part of the reader's total.
    pub fn count(entries: &mut [Self], sender: u32, cause: RefusalCause, frames_len: u32) {
        let (sender, cause) = (sender.min(u32::from(u16::MAX)) as u16, cause as u16);
        let of_both = |entry: &&mut Self| entry.cause == 0 || (entry.sender, entry.cause) == (sender, cause);
        if let Some(entry) = entries.iter_mut().find(of_both) {
            let frames_len = entry.frames_len.saturating_add(frames_len);
            *entry = Self { sender, cause, frames_len };
        }
    }

    /// The count of a link; `None` if the entry counts refused frames.
    #[must_use]
    pub fn link(&self) -> Option<LinkCount> {
        LinkCount::from_number(u32::from(self.cause))
    }

    /// Puts the counts of a link into free entries. Those that find no entry are left out.
    pub fn put_link(entries: &mut [Self], counts: impl IntoIterator<Item = (LinkCount, u64)>) {
        let free = entries.iter_mut().filter(|entry| entry.cause == 0);
        let counts = counts.into_iter().filter(|(_, count)| *count > 0);
        for (entry, (kind, count)) in free.zip(counts) {
            let frames_len = u32::try_from(count).unwrap_or(u32::MAX);
            *entry = Self { sender: 0, cause: kind as u16, frames_len };
        }
    }

    /// Adds the counts of `others`.
    pub fn add(entries: &mut [Self], others: &[Self]) {
        for other in others {
            if let Some(cause) = RefusalCause::from_number(u32::from(other.cause)) {
                Self::count(entries, u32::from(other.sender), cause, other.frames_len);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refusals_add_up_by_sender_and_cause_and_overflow_quietly() {
        let mut entries = [Refusals::default(); 2];
        Refusals::count(&mut entries, 3, RefusalCause::Value, 1);
        Refusals::count(&mut entries, 3, RefusalCause::Value, 2);
        Refusals::count(&mut entries, 4, RefusalCause::Value, 1);
        Refusals::count(&mut entries, 5, RefusalCause::Value, 1);
        let of = |sender, frames_len| Refusals { sender, cause: RefusalCause::Value as u16, frames_len };
        assert_eq!(entries, [of(3, 3), of(4, 1)]);
        let mut sum = [Refusals::default(); 8];
        Refusals::add(&mut sum, &entries);
        Refusals::add(&mut sum, &entries);
        assert_eq!(sum[..3], [of(3, 6), of(4, 2), Refusals::default()]);
    }

    #[test]
    fn counts_of_a_link_take_free_entries_and_are_no_refusals() {
        let mut entries = [Refusals::default(); 3];
        Refusals::count(&mut entries, 3, RefusalCause::Value, 1);
        let counts = [(LinkCount::Frames, 0), (LinkCount::Lost, 1 << 40), (LinkCount::Garbage, 2)];
        Refusals::put_link(&mut entries, counts.into_iter().chain([(LinkCount::Full, 1)]));
        assert_eq!(
            entries.map(|entry| entry.link()),
            [None, Some(LinkCount::Lost), Some(LinkCount::Garbage)]
        );
        assert_eq!(entries.map(|entry| entry.frames_len), [1, u32::MAX, 2]);
        assert!(LinkCount::ALL.iter().all(|kind| RefusalCause::from_number(*kind as u32).is_none()));
    }
}
