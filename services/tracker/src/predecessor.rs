//! The published tracks of a previous tracker, with which its successor continues.
//!
//! A process that waits for its turn *follows* `tracks`. It keeps the newest frame and each track's states,
//! and computes nothing. At its turn a new tracker [begins](crate::Tracker::begin_with) with them. Every
//! published track keeps its id, its history to the bit, its motion, covariance and type. Unpublished state
//! starts empty: tentative tracks, the modes of forecasts (the next forecast brings them), the evidence about
//! fronts, and frames to replay.

use wire::{Header, HistoryState, Track, flags};

use crate::history::History;

/// The tracks of the previous process, as they were published.
#[derive(Debug, Default)]
pub struct Predecessor {
    header: Header,
    tracks: Vec<Track>,
    /// The states of each track, in the order of the tracks.
    histories: Vec<History>,
    /// The histories of the previous frame; then reusable memory.
    before: Vec<(u64, History)>,
}

impl Predecessor {
    /// Follows a frame of the topic `tracks`. Control frames, and frames with an impossible number, change
    /// nothing.
    pub fn follow(&mut self, header: &Header, tracks: &[Track]) {
        let newest = (self.header.seq, self.header.stamp_ns);
        let is_older =
            !self.is_empty() && header.stamp_ns <= newest.1 && !header.begins_session_after(newest);
        if !header.is_tick() || header.has(flags::VOID) || is_older {
            return;
        }
        if tracks.iter().any(|track| track.check().is_err()) {
            return;
        }
        self.before.clear();
        self.before.extend(self.tracks.iter().map(|track| track.id).zip(self.histories.drain(..)));
        for track in tracks {
            let known = self.before.binary_search_by_key(&track.id, |(id, _)| *id);
            let mut history = known.map_or_else(|_| History::new(), |place| self.before[place].1);
            for (stamp_ns, state) in window(header, track) {
                history.set(stamp_ns, state);
            }
            self.histories.push(history);
        }
        self.header = *header;
        self.tracks.clear();
        self.tracks.extend_from_slice(tracks);
        // They are published in the order of their ids, and searched by id.
        debug_assert!(
            self.tracks.is_sorted_by_key(|track| track.id),
            "tracks come in the order of their ids"
        );
    }

    /// Whether there are no tracks to continue with.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.tracks.is_empty()
    }

    /// The header of the newest frame.
    #[must_use]
    pub const fn header(&self) -> &Header {
        &self.header
    }

    /// The tracks of the newest frame, each with its states.
    pub fn tracks(&self) -> impl Iterator<Item = (&Track, &History)> {
        self.tracks.iter().zip(&self.histories)
    }
}

/// The states of a track's window with their stamps, oldest first. The last one is its state at the stamp of the
/// frame.
fn window<'a>(header: &Header, track: &'a Track) -> impl Iterator<Item = (i64, HistoryState)> + 'a {
    let len = (header.counts.history_len as usize).min(track.history.len());
    let (stamp_ns, step_ns) = (header.stamp_ns, header.step_ns);
    track.history[..len].iter().enumerate().filter(|(_, state)| state.present == 1).map(move |(k, state)| {
        let back_ns = step_ns.saturating_mul((len - 1 - k) as u64);
        (stamp_ns.saturating_sub_unsigned(back_ns), *state)
    })
}
