use wire::{Detection, Header, flags};

use crate::{Audit, ClockSet, Doubt, Finding, Place};

/// Largest number of identities that are followed at a time.
const IDENTITIES: usize = 2 * wire::DETECTIONS_MAX;
/// Number of frames between two checks for doubts.
const LOOK_FRAMES: u64 = 32;
/// Number of checks after which the figures start again, so that a fault late in a long run is still found.
const LOOKS: u64 = 96;
/// A stamp this much before the newest one comes from another clock.
const BACK_NS: i64 = 1_000_000_000;

/// The audit of a running producer. Its doubts are bits.
///
/// The figures start again every 3,072 frames. Within these frames, a doubt is withdrawn if later frames
/// lower its share, as in the audit of a recording. At their end the remaining doubts become permanent.
#[derive(Clone, Debug)]
pub struct LiveAudit {
    audit: Audit,
    frames: u64,
    newest_ns: Option<i64>,
    /// Permanent doubts, from earlier figures.
    settled: u32,
    /// Doubts of the current figures.
    current: u32,
    /// Doubts that were found at any time.
    found: u32,
    /// Doubts that were not logged yet.
    new: u32,
    ignores_identities: bool,
}

impl Default for LiveAudit {
    fn default() -> Self {
        Self {
            audit: Audit::new(IDENTITIES, None),
            frames: 0,
            newest_ns: None,
            settled: 0,
            current: 0,
            found: 0,
            new: 0,
            ignores_identities: false,
        }
    }
}

impl LiveAudit {
    /// Adds a frame. If it begins a session, `set` has the clock's step. Does not allocate.
    pub fn frame(&mut self, header: &Header, detections: &[Detection], set: Option<ClockSet>) {
        let place = Place { file: 0, line: header.seq };
        self.audit.frame();
        if let Some(set) = set {
            self.audit.end_session();
            self.newest_ns = None;
            // One step is enough for a doubt, and the tracker logs it.
            let bit = if set.is_back() { Doubt::StampsGoBack.bit() } else { 0 };
            self.settled |= bit;
            self.found |= bit;
        }
        // Frames of a second clock far behind.
        if self.newest_ns.is_some_and(|newest_ns| newest_ns.saturating_sub(header.stamp_ns) > BACK_NS) {
            self.audit.went_back(detections.len() as u64, place);
        }
        self.newest_ns = self.newest_ns.max(Some(header.stamp_ns));
        for detection in detections {
            self.audit.detection(header.stamp_ns.saturating_add(detection.offset_ns), detection, place);
        }
        self.frames += 1;
        if !header.has(flags::HAS_IDENTITIES) {
            self.audit.forget_handovers();
        } else if !self.ignores_identities && self.audit.identities_change() {
            self.audit.ignore_identities();
            self.ignores_identities = true;
            let bit = Doubt::IdentitiesChange.bit();
            (self.settled, self.current) = (self.settled | bit, 0);
            self.new |= bit & !self.found;
            self.found |= bit;
        }
        if self.frames.is_multiple_of(LOOK_FRAMES) {
            self.look();
        }
    }

    fn look(&mut self) {
        self.current = self.audit.doubts();
        self.new |= self.current & !self.found;
        self.found |= self.current;
        if self.new == 0 && self.frames.is_multiple_of(LOOK_FRAMES * LOOKS) {
            self.settled |= std::mem::take(&mut self.current);
            self.audit.restart();
        }
    }

    /// Whether the identities were found to be none.
    pub const fn ignores_identities(&self) -> bool {
        self.ignores_identities
    }

    /// Bits of the doubts so far.
    pub const fn doubts(&self) -> u32 {
        self.settled | self.current
    }

    /// The doubts that were found since the last call. Allocates only if there are any.
    pub fn take_new(&mut self) -> Vec<Finding> {
        let new = std::mem::take(&mut self.new);
        if new == 0 {
            return Vec::new();
        }
        let mut findings = self.audit.findings();
        findings.retain(|finding| finding.doubt.bit() & new != 0);
        findings
    }
}

#[cfg(test)]
mod tests {
    use wire::{AgentType, detection_flags};

    use super::*;

    /// A producer's cars on circles of 60 m, with or without identities. `write` modifies the detections.
    fn doubts(frames: u64, interval_ns: i64, id: u32, write: impl Fn(u64, &mut Detection)) -> LiveAudit {
        let mut audit = LiveAudit::default();
        let flags = detection_flags::HAS_HEADING | detection_flags::HAS_SPEED | id;
        for seq in 0..frames {
            let car = |id: u64| {
                let speed_mps = 6.0 + id as f64;
                let angle = id as f64 + speed_mps / 60.0 * seq as f64 * 0.1;
                let (sin, cos) = angle.sin_cos();
                let mut detection = Detection {
                    id,
                    x_m: (200.0 * id as f64 + 60.0 * cos) as f32,
                    y_m: (60.0 * sin) as f32,
                    heading_rad: (angle + std::f64::consts::FRAC_PI_2) as f32,
                    speed_mps: speed_mps as f32,
                    agent_type: AgentType::Vehicle as u32,
                    flags,
                    ..Detection::default()
                };
                write(seq, &mut detection);
                detection
            };
            let cars: Vec<Detection> = (0..6).map(car).collect();
            audit.frame(&Header::new(1, seq, seq as i64 * interval_ns), &cars, None);
        }
        audit
    }

    const TENTH_NS: i64 = 100_000_000;

    #[test]
    fn a_clean_producer_raises_no_doubt() {
        for id in [detection_flags::HAS_ID, 0] {
            assert_eq!(doubts(320, TENTH_NS, id, |_, _| ()).doubts(), 0, "{id}");
        }
    }

    #[test]
    fn units_and_conventions_of_a_producer_are_found() {
        let degrees = |_: u64, detection: &mut Detection| {
            detection.heading_rad = detection.heading_rad.to_degrees();
        };
        let some = move |seq: u64, detection: &mut Detection| {
            if detection.id == 3 {
                degrees(seq, detection);
            }
        };
        let kmh = |_: u64, detection: &mut Detection| detection.speed_mps *= 3.6;
        for id in [detection_flags::HAS_ID, 0] {
            assert_eq!(doubts(320, TENTH_NS, id, degrees).doubts(), Doubt::HeadingsInDegrees.bit(), "{id}");
            assert_eq!(doubts(320, TENTH_NS, id, some).doubts(), Doubt::HeadingsInDegrees.bit(), "{id}");
            assert_eq!(doubts(320, TENTH_NS, id, kmh).doubts(), Doubt::SpeedsInKmh.bit(), "{id}");
        }
        let micro = doubts(64, TENTH_NS / 1_000, detection_flags::HAS_ID, |_, _| ()).doubts();
        // With such stamps, no motion is plausible.
        assert_eq!(micro, Doubt::StampsInOtherUnit.bit() | Doubt::Outliers.bit());
    }

    #[test]
    fn zeros_of_a_moving_producer_are_found() {
        let speeds = |_: u64, detection: &mut Detection| detection.speed_mps = 0.0;
        let headings = |_: u64, detection: &mut Detection| detection.heading_rad = 0.0;
        for id in [detection_flags::HAS_ID, 0] {
            let mut audit = doubts(320, TENTH_NS, id, speeds);
            assert_eq!(audit.doubts(), Doubt::SpeedsDiffer.bit(), "{id}");
            assert!(audit.take_new()[0].to_string().starts_with("speeds are 0 while agents move"));
            let mut audit = doubts(320, TENTH_NS, id, headings);
            assert_eq!(audit.doubts(), Doubt::HeadingsUnrelated.bit(), "{id}");
            assert!(audit.take_new()[0].to_string().starts_with("headings are 0 while agents move"));
        }
    }

    #[test]
    fn a_doubt_is_withdrawn_if_later_frames_lower_its_share_below_the_limit() {
        // One position of one car: more than 1 % of 96 frames, less than 1 % of 128 frames.
        let lone = |frames: u64| {
            let mut audit = LiveAudit::default();
            for seq in 0..frames {
                let (x_m, y_m) = (0.8 * seq as f32, if seq == 50 { 300.0 } else { 0.0 });
                let flags = detection_flags::HAS_ID;
                let car = Detection { x_m, y_m, flags, ..Detection::default() };
                audit.frame(&Header::new(1, seq, seq as i64 * TENTH_NS), &[car], None);
            }
            audit
        };
        assert_eq!(lone(96).doubts(), Doubt::Outliers.bit());
        assert_eq!(lone(128).doubts(), 0);
    }

    #[test]
    fn a_doubt_is_given_once_and_stays() {
        let late = |seq: u64, detection: &mut Detection| {
            if seq > 3_200 && detection.id == 2 && seq.is_multiple_of(7) {
                (detection.x_m, detection.y_m) = (-1.0, -1.0);
            }
        };
        assert_eq!(doubts(3_200, TENTH_NS, detection_flags::HAS_ID, late).doubts(), 0);
        let mut audit = doubts(3_500, TENTH_NS, detection_flags::HAS_ID, late);
        assert_eq!(audit.doubts(), Doubt::Placeholders.bit());
        let new = audit.take_new();
        assert_eq!(new.iter().map(|finding| finding.doubt).collect::<Vec<_>>(), [Doubt::Placeholders]);
        assert!(audit.take_new().is_empty() && audit.doubts() != 0);
    }

    #[test]
    fn a_clock_that_is_set_back_and_one_that_is_far_behind_are_found() {
        // A step is a doubt even if it is less than 1 % of all frames.
        for (frames, back) in
            [(320, |seq| seq == 300), (64, |seq| seq % 2 == 1)] as [(u64, fn(u64) -> bool); 2]
        {
            let mut audit = LiveAudit::default();
            let detection = Detection { flags: detection_flags::HAS_ID, ..Detection::default() };
            for seq in 0..frames {
                let back_ns = if back(seq) { 20 * TENTH_NS } else { 0 };
                let set = (seq == 300).then(|| ClockSet::new(seq, -back_ns));
                audit.frame(&Header::new(1, seq, seq as i64 * TENTH_NS - back_ns), &[detection], set);
            }
            assert_eq!(audit.doubts() & Doubt::StampsGoBack.bit(), Doubt::StampsGoBack.bit(), "{frames}");
        }
    }

    /// The doubts about frames of detections without identities: type, position and length of each.
    fn of_frames(
        frames: u64,
        interval_ns: i64,
        detections: impl Fn(u64) -> Vec<(AgentType, [f32; 2], f32)>,
    ) -> LiveAudit {
        let mut audit = LiveAudit::default();
        for seq in 0..frames {
            let detections = detections(seq).into_iter().map(|(agent_type, [x_m, y_m], length_m)| {
                let sized =
                    if length_m > 0.0 { detection_flags::HAS_SIZE | detection_flags::HAS_HEADING } else { 0 };
                let agent_type = agent_type as u32;
                Detection {
                    x_m,
                    y_m,
                    length_m,
                    width_m: 1.8,
                    flags: sized,
                    agent_type,
                    ..Detection::default()
                }
            });
            audit.frame(
                &Header::new(1, seq, seq as i64 * interval_ns),
                &detections.collect::<Vec<_>>(),
                None,
            );
        }
        audit
    }

    #[test]
    fn degrees_of_longitude_and_latitude_are_found() {
        // Cars at several places of the earth, one alone and four together, in either order, at 2 to 20 Hz.
        for (place, ns) in [([11.5, 48.0], 1), ([-122.4, 37.8], 5), ([139.7, 35.6], 2), ([48.0, 11.5], 1)] {
            for cars in [1_u64, 4] {
                let detections = |seq: u64| {
                    let way = |car: u64| (6.0 + car as f32) * (seq as i64 * ns) as f32 * 0.1 / 80_000.0;
                    let car =
                        |car| (AgentType::Vehicle, [place[0] + way(car), place[1] + car as f32 * 1e-4], 0.0);
                    (0..cars).map(car).collect()
                };
                let doubts = of_frames(160, ns * TENTH_NS, detections).doubts();
                assert_eq!(doubts & Doubt::Geographic.bit(), Doubt::Geographic.bit(), "{place:?} {cars}");
            }
        }
        // A parked car, and one that stands beside a walker.
        let parked = |seq: u64| vec![(AgentType::Vehicle, [11.5 + 0.01 * (seq % 3) as f32, 48.0], 0.0)];
        assert_eq!(of_frames(160, TENTH_NS, parked).doubts(), 0);
    }

    #[test]
    fn boxes_on_top_of_each_other_are_found() {
        let cars = |gap_m: f32, length_m: f32| {
            of_frames(160, TENTH_NS, move |seq| {
                let car = |place: usize| {
                    let x_m = 0.8 * seq as f32 + gap_m * (place % 2) as f32;
                    (AgentType::Vehicle, [x_m, 6.0 * (place / 2) as f32], length_m)
                };
                (0..6).map(car).collect()
            })
        };
        for (gap_m, length_m) in [(0.4, 4.5), (0.0, 4.5), (1.5, 4.5), (0.4, 0.0)] {
            assert_eq!(cars(gap_m, length_m).doubts(), Doubt::Stacked.bit(), "{gap_m} {length_m}");
        }
        // Queues of cars.
        assert_eq!([cars(5.0, 4.5).doubts(), cars(5.0, 0.0).doubts()], [0, 0]);
    }

    #[test]
    fn types_that_are_too_slow_for_their_paths_are_found() {
        let car = |speed_mps: f32, agent_type| {
            move |seq: u64| {
                let agent_type = if seq < 30 { agent_type } else { AgentType::Vehicle };
                vec![(agent_type, [speed_mps * 0.1 * seq as f32 + 0.01, 0.0], 0.0)]
            }
        };
        for (speed_mps, agent_type) in
            [(9.0, AgentType::Pedestrian), (14.0, AgentType::Pedestrian), (21.0, AgentType::Cyclist)]
        {
            let mut audit = of_frames(160, TENTH_NS, car(speed_mps, agent_type));
            assert_eq!(audit.doubts(), Doubt::SpeedsUnusual.bit(), "{speed_mps}");
            let sentence = audit.take_new()[0].to_string();
            assert!(
                sentence.contains(&format!("move at {speed_mps:.1} m/s")) && sentence.contains("type right")
            );
        }
        assert_eq!(of_frames(160, TENTH_NS, car(1.4, AgentType::Pedestrian)).doubts(), 0);
    }

    #[test]
    fn frames_that_are_too_far_apart_are_found() {
        let cars = |interval_s: i64| {
            let car = move |seq: u64, lane: u64| {
                let speed_mps = 7.0 + lane as f32;
                (
                    AgentType::Vehicle,
                    [speed_mps * (interval_s as u64 * seq) as f32 + 0.1, 7.0 * lane as f32],
                    0.0,
                )
            };
            of_frames(64, interval_s * 10 * TENTH_NS, move |seq| (0..3).map(|lane| car(seq, lane)).collect())
        };
        assert_eq!(
            [3, 4].map(|interval_s| cars(interval_s).doubts() & Doubt::Sparse.bit()),
            [Doubt::Sparse.bit(); 2]
        );
        assert_eq!(cars(1).doubts() & Doubt::Sparse.bit(), 0);
    }
}
