//! The content of the input: counts by source and tracker, and the findings of the audit.

use std::collections::BTreeMap;

use audit::{Doubt, Found, Noise, TypeNoise, noise_words};
use serde::{Deserialize, Serialize};
use wire::{Header, InputCounts};

/// Start of a verdict's reason that is a doubt about the input.
pub(crate) const DOUBT: &str = "input: ";

/// The content of the input, and its probable faults.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct InputReport {
    /// Number of detections that the tracker has processed.
    pub detections: u64,
    /// Number of detections that repeat the previous one of a moving track. They are not measurements.
    pub repeated: u64,
    /// Number of detections out of their track's reach. They count as missed.
    pub misfits: u64,
    /// Number of detections at a placeholder's position.
    pub placeholders: u64,
    /// Number of tracks whose state was restarted because misfits agreed.
    pub reassigned: u64,
    /// Number of detections in unplayed frames that no played frame contains.
    pub unplayed: u64,
    /// Number of detections in unplayed frames that were sent with another frame.
    pub merged: u64,
    /// Rows of the recording that its format omits, by reason.
    pub rows_left_out: BTreeMap<String, u64>,
    /// Number of frames of the recording without a pose of its moving sensor nearby. These frames are not
    /// seen from the sensor.
    pub poses_missing: u64,
    /// The noise of the detections, as the tracker has learned it.
    pub noise: Vec<TypeNoise>,
    /// The findings about the input, whether they are doubts or not.
    pub findings: Vec<Found>,
    /// Whether the recording was audited before it was played.
    #[serde(skip)]
    is_audited: bool,
}

impl InputReport {
    /// Information about a recording before it is played.
    #[must_use]
    pub fn of_recording(
        findings: Vec<Found>,
        rows_left_out: BTreeMap<String, u64>,
        poses_missing: u64,
    ) -> Self {
        Self { rows_left_out, poses_missing, findings, is_audited: true, ..Self::default() }
    }

    /// The doubts.
    pub fn doubts(&self) -> impl Iterator<Item = &Found> {
        self.findings.iter().filter(|found| found.doubtful)
    }

    /// Whether the input is doubtful.
    #[must_use]
    pub fn is_doubtful(&self) -> bool {
        self.doubts().next().is_some()
    }

    /// The doubts as reasons of a verdict.
    pub fn reasons(&self) -> impl Iterator<Item = String> {
        self.doubts().map(|found| format!("{DOUBT}{found}"))
    }

    /// Counts of interest to a user, with their names.
    #[must_use]
    pub const fn counts(&self) -> [(&'static str, u64); 7] {
        [
            ("detections", self.detections),
            ("repeated", self.repeated),
            ("misfits", self.misfits),
            ("placeholders", self.placeholders),
            ("reassigned", self.reassigned),
            ("unplayed", self.unplayed),
            ("merged", self.merged),
        ]
    }

    /// Adds the information about the recording. Its audit replaces the tracker's audit, which saw fewer rows
    /// and headings that the reader had wrapped. Only the tracker knows the noise.
    pub(crate) fn add(&mut self, recording: &Self) {
        if recording.is_audited {
            self.findings.retain(|found| found.kind == Doubt::NoiseChanged.name());
            self.findings.splice(..0, recording.findings.iter().cloned());
        }
        self.rows_left_out.clone_from(&recording.rows_left_out);
        self.poses_missing = recording.poses_missing;
    }

    /// Whether all detections were processed as measurements, no row was omitted and no pose is missing.
    #[must_use]
    pub fn is_clean(&self) -> bool {
        let [_, others @ ..] = self.counts();
        let is_whole = self.rows_left_out.is_empty() && self.poses_missing == 0;
        is_whole && others.iter().all(|(_, count)| *count == 0)
    }

    /// The noise of the detections as one line; `None` if it is unknown.
    #[must_use]
    pub fn noise_line(&self) -> Option<String> {
        noise_words(&self.noise)
    }

    /// One line of text; `None` if there is nothing to report.
    #[must_use]
    pub fn line(&self) -> Option<String> {
        let meaning = |name: &'static str| match name {
            "repeated" => "repeated (no measurements)",
            "misfits" => "out of reach (missed)",
            "placeholders" => "placeholders (missed)",
            "reassigned" => "identities reassigned",
            "unplayed" => "in unplayed frames (thinned)",
            "merged" => "merged from unplayed frames",
            other => other,
        };
        let counted = self.counts().into_iter().filter(|(_, count)| *count > 0);
        let counts = counted.map(|(name, count)| format!("{} {}", crate::text::count(count), meaning(name)));
        let rows = self.rows_left_out.iter().map(|(kind, rows)| crate::text::rows(kind, *rows));
        let poses = (self.poses_missing > 0).then(|| {
            format!("{} frames without a pose of the sensor", crate::text::count(self.poses_missing))
        });
        let parts: Vec<String> = counts.chain(rows).chain(poses).collect();
        (!parts.is_empty()).then(|| parts.join(", "))
    }
}

/// The counts of the headers, over all incarnations of source and tracker.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct InputTally {
    newest: [u32; 7],
    /// Counts of earlier incarnations.
    before: [u64; 7],
    /// Doubts in the newest header. The audit withdraws a doubt if later rows remove it.
    doubts: u32,
    /// Doubts of earlier incarnations.
    #[serde(default)]
    doubts_before: u32,
    #[serde(default)]
    noise: Noise,
}

impl InputTally {
    /// Adds the header of a tick, and the type and published noise of its agents.
    pub fn tick(&mut self, header: &Header, agents: impl Iterator<Item = (u32, [f32; 3])>) {
        self.noise.tick(header.stamp_ns, agents);
        let InputCounts { detections, repeated, misfits, placeholders, reassigned, unplayed, merged, doubts } =
            header.input;
        let counts = [detections, repeated, misfits, placeholders, reassigned, unplayed, merged];
        if detections < self.newest[0] {
            self.doubts_before |= self.doubts;
        }
        for ((newest, before), count) in self.newest.iter_mut().zip(&mut self.before).zip(counts) {
            // A restarted stage counts from 0.
            if count < *newest {
                *before += u64::from(*newest);
            }
            *newest = count;
        }
        self.doubts = doubts;
    }

    /// The newest noise of each type.
    #[must_use]
    pub fn noise(&self) -> Vec<TypeNoise> {
        self.noise.types().collect()
    }

    /// The counts so far. Doubts have no figures, unless the recording was audited.
    #[must_use]
    pub fn report(&self, recording: &InputReport) -> InputReport {
        let mut place = 0;
        let [detections, repeated, misfits, placeholders, reassigned, unplayed, merged] =
            self.newest.map(|newest| {
                place += 1;
                u64::from(newest) + self.before[place - 1]
            });
        // A change that began before this reader has no figures.
        let changes: Vec<Found> = self.noise.changes().collect();
        let mut doubts = self.doubts | self.doubts_before;
        if !changes.is_empty() {
            doubts &= !Doubt::NoiseChanged.bit();
        }
        let mut report = InputReport {
            detections,
            repeated,
            misfits,
            placeholders,
            reassigned,
            unplayed,
            merged,
            noise: self.noise(),
            findings: Doubt::of_bits(doubts).map(Found::of_kind).chain(changes).collect(),
            ..InputReport::default()
        };
        report.add(recording);
        report
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(detections: u32, repeated: u32, doubts: u32) -> Header {
        let input = InputCounts { detections, repeated, doubts, ..InputCounts::default() };
        Header { input, ..Header::new(1, 2, 3) }
    }

    #[test]
    fn counts_add_up_over_restarts_of_the_tracker() {
        let mut tally = InputTally::default();
        for (detections, repeated) in [(10, 0), (20, 4), (5, 1)] {
            tally.tick(&header(detections, repeated, 0), std::iter::empty());
        }
        let report = tally.report(&InputReport::default());
        assert_eq!((report.detections, report.repeated, report.is_doubtful()), (25, 5, false));
        assert_eq!(report.line().as_deref(), Some("25 detections, 5 repeated (no measurements)"));
    }

    #[test]
    fn a_doubt_that_the_audit_withdraws_is_not_reported_and_one_before_a_restart_is() {
        let mut tally = InputTally::default();
        let kinds = |tally: &InputTally| {
            let findings = tally.report(&InputReport::default()).findings;
            findings.into_iter().map(|found| found.kind).collect::<Vec<_>>()
        };
        tally.tick(&header(10, 0, Doubt::Outliers.bit()), std::iter::empty());
        assert_eq!(kinds(&tally), ["outliers"]);
        tally.tick(&header(20, 0, 0), std::iter::empty());
        assert!(kinds(&tally).is_empty());
        tally.tick(&header(30, 0, Doubt::Repeated.bit()), std::iter::empty());
        tally.tick(&header(1, 0, 0), std::iter::empty());
        assert_eq!(kinds(&tally), ["repeated"]);
    }

    #[test]
    fn the_audit_of_a_recording_replaces_that_of_the_tracker() {
        let mut tally = InputTally::default();
        tally.tick(
            &header(1, 0, Doubt::HeadingsUnrelated.bit() | Doubt::SpeedsInKmh.bit()),
            std::iter::empty(),
        );
        let live = tally.report(&InputReport::default());
        let kinds: Vec<&str> = live.findings.iter().map(|found| found.kind.as_str()).collect();
        assert_eq!(kinds, ["headings_unrelated", "speeds_in_kmh"]);
        let known =
            Found { first: Some("a.csv:7".to_owned()), rows: Some(3), ..Found::of_kind(Doubt::Repeated) };
        let report = tally.report(&InputReport::of_recording(vec![known.clone()], BTreeMap::new(), 3));
        assert_eq!((report.poses_missing, report.is_clean()), (3, false));
        assert_eq!(report.line().as_deref(), Some("1 detections, 3 frames without a pose of the sensor"));
        assert_eq!(report.findings, [known]);
    }
}
