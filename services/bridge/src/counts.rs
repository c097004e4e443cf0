//! Counts of what became of connections and frames.

use std::fmt;
use std::io;
use std::sync::atomic::{AtomicU64, Ordering};

use thiserror::Error;
use wire::LinkCount;

use crate::frame::Refused;

/// Why a connection ended.
#[derive(Debug, Error)]
pub enum LinkError {
    /// The other end is gone, too slow, or can't be reached.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// The other end sent something that is refused.
    #[error(transparent)]
    Refused(#[from] Refused),
    /// A frame was not confirmed in time: the receiver is too slow, or the link is cut.
    #[error("a frame was not confirmed in time")]
    Slow,
    /// There are enough connections.
    #[error("there are enough receivers")]
    Full,
}

/// Counts one after another, which all threads of an end share.
#[derive(Debug, Default)]
pub struct Counts {
    /// Connections that were authenticated.
    pub connected: Count,
    /// Frames that were sent, or received and delivered.
    pub frames: Count,
    /// Frames that a newer one has replaced before they were sent.
    pub skipped: Count,
    /// Received frames that were too old to be delivered.
    pub old: Count,
    /// Connections without a confirmation in time.
    pub slow: Count,
    /// Connections that were lost, and attempts that failed.
    pub lost: Count,
    /// Connections with another key.
    pub wrong_key: Count,
    /// Connections that sent something else, another version or damaged frames.
    pub garbage: Count,
    /// Connections that found no room.
    pub full: Count,
}

/// A number that only grows.
#[derive(Debug, Default)]
pub struct Count(AtomicU64);

impl Count {
    /// Adds to the number.
    pub fn add(&self, more: u64) {
        self.0.fetch_add(more, Ordering::Relaxed);
    }

    /// The number.
    pub fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

impl Counts {
    /// Counts the end of a connection.
    pub fn end(&self, error: &LinkError) {
        let count = match error {
            LinkError::Io(_) => &self.lost,
            LinkError::Slow => &self.slow,
            LinkError::Full => &self.full,
            LinkError::Refused(Refused::Code) => &self.wrong_key,
            LinkError::Refused(_) => &self.garbage,
        };
        count.add(1);
    }

    /// The counts for the heartbeats of a stage. `dropped` frames were received, and a newer one has replaced
    /// them before they were read.
    #[must_use]
    pub fn list(&self, dropped: u64) -> [(LinkCount, u64); 9] {
        let Self { connected, frames, skipped, old, slow, lost, wrong_key, garbage, full } = self;
        [
            (LinkCount::Connections, connected.get()),
            (LinkCount::Frames, frames.get()),
            (LinkCount::Skipped, skipped.get() + dropped),
            (LinkCount::Old, old.get()),
            (LinkCount::Lost, lost.get()),
            (LinkCount::Slow, slow.get()),
            (LinkCount::WrongKey, wrong_key.get()),
            (LinkCount::Garbage, garbage.get()),
            (LinkCount::Full, full.get()),
        ]
    }

    /// The number of connections that were refused or dropped.
    #[must_use]
    pub fn troubles(&self) -> u64 {
        let Self { slow, lost, wrong_key, garbage, full, .. } = self;
        [slow, lost, wrong_key, garbage, full].map(Count::get).iter().sum()
    }
}

impl fmt::Display for Counts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { connected, frames, skipped, old, slow, lost, wrong_key, garbage, full } = self;
        let [connected, frames, skipped, old] = [connected, frames, skipped, old].map(Count::get);
        let [slow, lost, wrong_key, garbage, full] = [slow, lost, wrong_key, garbage, full].map(Count::get);
        write!(
            f,
            "{frames} frames over {connected} connections; {skipped} frames skipped for newer ones, {old} too old; \
             connections: {lost} lost, {slow} too slow, {wrong_key} with another key, {garbage} garbage, {full} \
             without room"
        )
    }
}
