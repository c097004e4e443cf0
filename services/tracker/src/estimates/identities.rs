//! Processing of frames whose detections have trusted identities.

use wire::{Detection, Header};

use crate::estimate::{Birth, Estimate, Verdict};
use crate::estimates::{Estimates, Scratch, Stray};
use crate::observation::{Found, observation};
use crate::options::TrackerOptions;
use crate::placeholders::is_marked;
use crate::publication::Publications;
use crate::scan::Scan;
use crate::tracked::Tracked;

/// Twice the log-likelihood ratio (of 1000) from which two identities count as exchanged.
const EXCHANGE_EVIDENCE: f64 = 13.8;
/// Number of detections at one exact position from which the position cannot be a coincidence.
const SHARED_BY: usize = 3;

impl Estimates {
    /// Updates the estimates by the detections of their identities.
    pub(super) fn follow_identities(
        &mut self,
        scan: &Scan,
        publications: &mut Publications,
        scratch: &mut Scratch,
        options: &TrackerOptions,
        tracked: &mut Tracked,
    ) {
        let Scan { header, detections, types, .. } = scan;
        let found = |d: usize| Found::new(header.stamp_ns, &detections[d], types[d]);
        tracked.duplicate_count = scratch.pairing.by_identity(&self.all, detections);
        if scratch.pairing.shares_places() {
            self.find_shared_placeholders(detections);
        }
        self.find_strays(scan, scratch, options, tracked);
        let has_births = publications.has_births_at(header.stamp_ns);
        let mut strays = scratch.strays.iter().peekable();
        for e in 0..self.all.len() {
            let stray = strays.next_if(|stray| stray.estimate == e);
            let exchanged = stray.filter(|stray| stray.exchanged.is_some());
            let (mut hit, mut is_resent) = (None, false);
            if let Some(other) = exchanged.and_then(|stray| scratch.strays.get(stray.exchanged?)) {
                self.take(e, &found(other.detection), options, tracked);
                tracked.reassigned_count += 1;
                hit = Some(other.detection);
            } else {
                let own = scratch.pairing.of_identity(e);
                // A single detection was judged before.
                let fits = own.len() == 1 && stray.is_none();
                for d in own.iter().map(|&d| d as usize) {
                    let found = (d, &found(d), fits);
                    match self.take_own(e, found, (header, &mut scratch.begun), options, tracked) {
                        Taken::Measured => hit = hit.or(Some(d)),
                        Taken::Resent => is_resent = true,
                        Taken::No => {}
                    }
                }
            }
            let estimate = &mut self.all[e];
            let input = &self.input;
            tracked.fault_count += usize::from(estimate.predict(header.stamp_ns, input).is_err());
            if let Some(detection) = hit.filter(|_| has_births) {
                let from = Birth { stamp_ns: header.stamp_ns, detection: detection as u32 };
                publications.transfer(from, estimate.birth());
            }
            if hit.is_none() && is_resent {
                estimate.hold_turn();
            } else if hit.is_none() && header.observed_types & estimate.class.current().bit() != 0 {
                tracked.fault_count += usize::from(estimate.miss(&mut [], input, options).is_err());
            }
        }
        for mut begun in scratch.begun.drain(..) {
            tracked.started_count += 1;
            tracked.fault_count += usize::from(begun.predict_first(&self.input).is_err());
            self.all.push(begun);
        }
    }

    /// Predicts each estimate to the first of its detections, and finds exchanged detections.
    fn find_strays(
        &mut self,
        Scan { header, detections, types, .. }: &Scan,
        Scratch { pairing, strays, .. }: &mut Scratch,
        options: &TrackerOptions,
        tracked: &mut Tracked,
    ) {
        let input = &self.input;
        let found = |d: usize| Found::new(header.stamp_ns, &detections[d], types[d]);
        strays.clear();
        for (e, estimate) in self.all.iter_mut().enumerate() {
            let own = pairing.of_identity(e);
            let to_ns = own.first().map_or(header.stamp_ns, |&d| found(d as usize).own_ns);
            tracked.fault_count += usize::from(estimate.predict(to_ns, input).is_err());
            let [only] = own else { continue };
            let (detection, found) = (*only as usize, found(*only as usize));
            if estimate.judge(&found, input, options) != Verdict::Fits && !estimate.is_resent(&found) {
                strays.push(Stray { estimate: e, detection, exchanged: None });
            }
        }
        for a in 0..strays.len() {
            let prefers = |a: usize, b: usize| {
                let (other, own) = (found(strays[b].detection), found(strays[a].detection));
                self.all[strays[a].estimate].prefers(&other, &own, input)
            };
            let are_exchanged = |b: usize| {
                prefers(a, b).zip(prefers(b, a)).is_some_and(|(by_a, by_b)| by_a + by_b > EXCHANGE_EVIDENCE)
            };
            let other = (a + 1..strays.len()).find(|&b| strays[b].exchanged.is_none() && are_exchanged(b));
            if let Some(b) = other.filter(|_| strays[a].exchanged.is_none()) {
                (strays[a].exchanged, strays[b].exchanged) = (Some(b), Some(a));
            }
        }
    }

    /// Updates an estimate by a detection.
    fn take(&mut self, e: usize, found: &Found<'_>, options: &TrackerOptions, tracked: &mut Tracked) {
        let (input, estimate) = (&self.input, &mut self.all[e]);
        tracked.fault_count += usize::from(estimate.predict(found.own_ns, input).is_err());
        let of_type = &mut self.shown[estimate.class.current().index()];
        estimate.mature(found).for_each(|shown| of_type.add_of_type(&shown));
        let mut seen = [(1.0, observation(found.detection, found.agent_type, input))];
        tracked.fault_count += usize::from(estimate.update(found, &mut seen, input, options).is_err());
        estimate.teach_sensor(found, (&mut self.noise, &mut self.of_sensors), options);
    }

    /// Updates an estimate by a detection of its identity, if it is a measurement. `fits` is set if this is
    /// known already.
    fn take_own(
        &mut self,
        e: usize,
        (d, found, fits): (usize, &Found<'_>, bool),
        (header, begun): (&Header, &mut Vec<Estimate>),
        options: &TrackerOptions,
        tracked: &mut Tracked,
    ) -> Taken {
        let (input, estimate) = (&self.input, &mut self.all[e]);
        tracked.fault_count += usize::from(estimate.predict(found.own_ns, input).is_err());
        if estimate.is_resent(found) {
            tracked.repeated_count += 1;
            return Taken::Resent;
        }
        let verdict = if fits { Verdict::Fits } else { estimate.judge(found, input, options) };
        let is_placeholder = verdict != Verdict::Fits && self.placeholders.holds(found.place());
        if verdict == Verdict::Fits || (verdict == Verdict::Strange && !is_placeholder) {
            self.take(e, found, options, tracked);
            return Taken::Measured;
        }
        let birth = (Birth { stamp_ns: header.stamp_ns, detection: d as u32 }, self.started_count + 1);
        if self.has_begun_at_placeholder(e, found, options) {
            tracked.placeholder_count += 1;
            self.started_count += 1;
            self.all[e].replace();
            begun.push(Estimate::new(birth, found, &self.input, true));
            return Taken::No;
        }
        if is_placeholder || self.has_jumped_to_placeholder(e, found) {
            tracked.placeholder_count += 1;
            return Taken::No;
        }
        tracked.misfit_count += 1;
        if let Some(new) = self.all[e].add_misfit(found, birth, &self.input, options) {
            self.started_count += 1;
            tracked.reassigned_count += 1;
            begun.push(new);
        }
        Taken::No
    }

    /// Whether an estimate was only at a placeholder's position, and the detection is the agent's first real
    /// one.
    fn has_begun_at_placeholder(&mut self, e: usize, found: &Found<'_>, options: &TrackerOptions) -> bool {
        let estimate = &self.all[e];
        let Some(place) = estimate.placeholder_at_start() else { return false };
        // If they are out of reach of each other, either one may be the wrong one.
        let has_begun = !is_marked(found.place())
            && !self.placeholders.holds(found.place())
            && estimate.reaches(found, options);
        if has_begun {
            self.placeholders.add(place);
        }
        has_begun
    }

    /// Whether a detection has jumped to a placeholder. A jump away from the agent's only position is
    /// recorded, too.
    fn has_jumped_to_placeholder(&mut self, e: usize, found: &Found<'_>) -> bool {
        let estimate = &self.all[e];
        let is_first = estimate.misfit_at().is_none();
        if let Some(place) = estimate.standing_at().filter(|_| is_first) {
            self.placeholders.add_jump(place);
        }
        estimate.misfit_at() != Some(found.place()) && self.placeholders.add_jump(found.place())
    }

    /// Marks positions that several identities share as placeholders, if the positions are marked or shared
    /// by many.
    fn find_shared_placeholders(&mut self, detections: &[Detection]) {
        let place = |d: &Detection| [d.x_m.to_bits(), d.y_m.to_bits()];
        for (d, detection) in detections.iter().enumerate() {
            let at = place(detection);
            let others =
                detections[d + 1..].iter().filter(|other| place(other) == at && other.id != detection.id);
            let shared_by = 1 + others.count();
            if shared_by >= SHARED_BY || (shared_by > 1 && is_marked(at)) {
                self.placeholders.add(at);
            }
        }
    }
}

/// The outcome of a detection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Taken {
    Measured,
    Resent,
    No,
}
