//! Frames refused, by reader, sender and cause, and the counts of links, from heartbeats.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use wire::{Heartbeat, LinkCount, RefusalCause, StageId};

use crate::report::{Percentiles, RefusedFrames};

/// Largest number of triples of reader, sender and cause. Senders may write any number.
const ENTRIES_MAX: usize = 256;

/// The refusals of one reader, for one sender and one cause; or one count of its link.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Entry {
    reader: u32,
    sender: u32,
    cause: u32,
    /// Incarnation of the reader.
    incarnation: u32,
    newest: u64,
    /// Count of the reader's earlier incarnations.
    before: u64,
}

/// Counts refusals over all incarnations of the readers.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct RefusalCounts(Vec<Entry>);

impl RefusalCounts {
    /// Adds a reader's own counts. Stale counts of an earlier incarnation are ignored.
    pub fn heartbeat(&mut self, heartbeat: &Heartbeat) {
        let Heartbeat { stage: reader, incarnation, refusals, .. } = *heartbeat;
        for refusal in refusals.iter().filter(|refusal| refusal.cause > 0) {
            let (sender, cause) = (u32::from(refusal.sender), u32::from(refusal.cause));
            let frames = u64::from(refusal.frames_len);
            let of_all =
                |entry: &&mut Entry| (entry.reader, entry.sender, entry.cause) == (reader, sender, cause);
            let is_full = self.0.len() >= ENTRIES_MAX;
            let is_time = refusal.link().is_some_and(LinkCount::is_time);
            match self.0.iter_mut().find(of_all) {
                Some(entry) if incarnation > entry.incarnation => {
                    let before = if is_time { 0 } else { entry.before + entry.newest };
                    *entry = Entry { incarnation, newest: frames, before, ..*entry };
                }
                Some(entry) if incarnation == entry.incarnation => {
                    entry.newest = if is_time { frames } else { entry.newest.max(frames) };
                }
                None if !is_full => {
                    self.0.push(Entry { reader, sender, cause, incarnation, newest: frames, before: 0 });
                }
                _ => {}
            }
        }
    }

    /// Number of frames that a reader refused before it could read their tick. These ticks are gaps for the
    /// reader.
    pub fn tick_count(&self, reader: StageId) -> u64 {
        let hides_the_tick = |entry: &&Entry| {
            entry.reader == reader.number()
                && matches!(
                    RefusalCause::from_number(entry.cause),
                    Some(RefusalCause::Schema | RefusalCause::CheckValue | RefusalCause::Unprotected)
                )
        };
        self.0.iter().filter(hides_the_tick).map(|entry| entry.before + entry.newest).sum()
    }

    /// The counts, largest first.
    pub fn list(&self) -> Vec<RefusedFrames> {
        let told = |entry: &Entry| RefusedFrames {
            reader: name(entry.reader),
            sender: name(entry.sender),
            cause: RefusalCause::from_number(entry.cause).map_or("unknown", RefusalCause::name).to_owned(),
            frames: entry.before + entry.newest,
        };
        let is_refusal = |entry: &&Entry| LinkCount::from_number(entry.cause).is_none();
        let mut list: Vec<RefusedFrames> = self.0.iter().filter(is_refusal).map(told).collect();
        list.sort_by_key(|refused| std::cmp::Reverse(refused.frames));
        list
    }

    /// The counts of links to other boxes, by stage and kind.
    pub fn links(&self) -> BTreeMap<String, BTreeMap<String, u64>> {
        let mut links = BTreeMap::<_, BTreeMap<_, _>>::new();
        for entry in &self.0 {
            if let Some(kind) = LinkCount::from_number(entry.cause).filter(|kind| !kind.is_time()) {
                let counts = links.entry(name(entry.reader)).or_default();
                counts.insert(kind.name().to_owned(), entry.before + entry.newest);
            }
        }
        links
    }

    /// Time from the sensor's stamp to a stage's publication in another system, if the stage measures it.
    pub fn since_stamp_ms(&self, stage: StageId) -> Percentiles {
        let time_ms = |kind: LinkCount| {
            let is_this = |entry: &&Entry| (entry.reader, entry.cause) == (stage.number(), kind as u32);
            self.0.iter().find(is_this).map(|entry| entry.newest as f64 / 1e3)
        };
        Percentiles {
            p50: time_ms(LinkCount::SinceStampP50),
            p99: time_ms(LinkCount::SinceStampP99),
            p999: None,
            max: time_ms(LinkCount::SinceStampMax),
        }
    }
}

fn name(stage: u32) -> String {
    let stage = StageId::from_number(stage).filter(|stage| StageId::known().any(|known| known == *stage));
    stage.map_or("unknown", StageId::name).to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use wire::{REFUSALS_MAX, Refusals};

    fn beat(incarnation: u32, frames_len: u32) -> Heartbeat {
        let mut refusals = [Refusals::default(); REFUSALS_MAX];
        Refusals::count(&mut refusals, StageId::Decoder.number(), RefusalCause::CheckValue, frames_len);
        Heartbeat { stage: StageId::Sampler.number(), incarnation, refusals, ..Heartbeat::default() }
    }

    #[test]
    fn refusals_add_up_over_the_restarts_of_their_reader() {
        let mut counts = RefusalCounts::default();
        for (incarnation, frames) in [(0, 2), (0, 5), (1, 1), (0, 9)] {
            counts.heartbeat(&beat(incarnation, frames));
        }
        let told = |name: &str| name.to_owned();
        let expected = RefusedFrames {
            reader: told("sampler"),
            sender: told("decoder"),
            cause: told("check value"),
            frames: 6,
        };
        assert_eq!(counts.list(), [expected]);
    }

    #[test]
    fn counts_of_a_link_add_up_over_restarts_and_are_no_refusals() {
        let mut counts = RefusalCounts::default();
        for (incarnation, lost) in [(0, 2), (0, 5), (1, 1)] {
            let mut beat = beat(incarnation, 1);
            Refusals::put_link(&mut beat.refusals, [(LinkCount::Lost, lost), (LinkCount::Frames, 10)]);
            counts.heartbeat(&beat);
        }
        let expected = [("lost", 6), ("frames", 20)].map(|(kind, count)| (kind.to_owned(), count));
        assert_eq!(counts.links(), [("sampler".to_owned(), expected.into())].into());
        assert_eq!(counts.list().len(), 1);
    }

    #[test]
    fn measured_times_are_the_newest_and_no_counts() {
        let mut counts = RefusalCounts::default();
        assert_eq!(counts.since_stamp_ms(StageId::Sampler), Percentiles::default());
        for (incarnation, p50_us) in [(0, 30_000), (0, 21_500), (1, 12_000), (1, 11_250), (0, 99_000)] {
            let mut beat = beat(incarnation, 1);
            let times = [(LinkCount::SinceStampP50, p50_us), (LinkCount::SinceStampMax, 2 * p50_us)];
            Refusals::put_link(&mut beat.refusals, times);
            counts.heartbeat(&beat);
        }
        let expected = Percentiles { p50: Some(11.25), max: Some(22.5), ..Percentiles::default() };
        assert_eq!(counts.since_stamp_ms(StageId::Sampler), expected);
        assert_eq!(counts.since_stamp_ms(StageId::Decoder), Percentiles::default());
        assert!(counts.links().is_empty() && counts.list().len() == 1);
    }

    #[test]
    fn senders_of_any_number_take_bounded_room() {
        let mut counts = RefusalCounts::default();
        for sender in 0..1_000 {
            let mut heartbeat = beat(0, 1);
            heartbeat.refusals[0].sender = sender;
            counts.heartbeat(&heartbeat);
        }
        assert_eq!(counts.list().len(), ENTRIES_MAX);
        assert_eq!(counts.list()[0].sender, "unknown");
    }
}
