//! Properties of an input under any order of frames.

use proptest::prelude::*;
use wire::Hop;

use super::*;

const RUN: u64 = 7;
const TICK_NS: i64 = 80_000_000;

fn intake(lockstep: bool) -> Intake {
    let elements_len = |counts: &Counts| counts.agents_len as usize;
    Intake::new(Rules { run_id: RUN, protected: false, lockstep, one_writer: true, elements_len })
}

/// A tick of the sampler's incarnation.
fn tick(seq: u64, incarnation: u32) -> Header {
    let (sender, interval_ns) = (StageId::Sampler.number(), TICK_NS as u64);
    let header = Header::new(RUN, seq, (seq as i64 + 1) * TICK_NS);
    Header { sender, incarnation, interval_ns, ..header }
}

fn warm_up() -> Header {
    Header { flags: flags::WARM_UP, ..tick(0, 0) }
}

/// Decides about a frame without elements and without a check value.
fn decide(intake: &mut Intake, header: &Header) -> Decision {
    intake.decide(header, 0, || panic!("the topic has no check values"))
}

fn is_accepted(intake: &mut Intake, header: &Header) -> bool {
    decide(intake, header) == Decision::Accepted
}

proptest! {
    #[test]
    fn every_missing_tick_is_counted_once_in_any_order(
        mut ticks in prop::collection::btree_set(0..64_u64, 1..40).prop_map(Vec::from_iter).prop_shuffle(),
        has_warm_up in any::<bool>(),
    ) {
        let mut intake = intake(false);
        if has_warm_up {
            prop_assert!(is_accepted(&mut intake, &warm_up()));
        } else {
            // A reader that joins late counts from its first tick.
            ticks.sort_unstable();
        }
        for seq in &ticks {
            prop_assert!(is_accepted(&mut intake, &tick(*seq, 0)));
        }
        let newest = *ticks.iter().max().expect("one or more");
        let first = if has_warm_up { 0 } else { ticks[0] };
        prop_assert_eq!(intake.dropped_len(), newest + 1 - first - ticks.len() as u64);
        prop_assert_eq!(intake.rejected_len(), 0);
    }

    #[test]
    fn in_lockstep_every_tick_is_accepted_or_lost_exactly_once(
        frames in prop::collection::vec((0..4_u8, any::<bool>()), 1..60),
    ) {
        let (mut intake, mut settled) = (intake(true), Vec::new());
        for (seq, (damage, is_repeated)) in (0..).zip(&frames) {
            let mut header = tick(seq, 0);
            match damage {
                1 => header.run_id += 1,
                2 => header.schema += 1,
                // The length does not match the counts.
                3 => header.counts.agents_len = 1,
                _ => {}
            }
            for _ in 0..1 + u8::from(*is_repeated && *damage == 0) {
                match decide(&mut intake, &header) {
                    Decision::Accepted if settled.last() != Some(&header.seq) => settled.push(header.seq),
                    Decision::Accepted => {}
                    decision => prop_assert!(matches!(decision, Decision::Refused(_)), "{:?}", decision),
                }
                if let Some(lost) = intake.take_lost() {
                    prop_assert!(lost.has(flags::VOID | flags::LOCKSTEP) && lost.check().is_ok());
                    prop_assert_eq!((lost.run_id, lost.counts), (RUN, Counts::default()));
                    settled.push(lost.seq);
                }
            }
        }
        prop_assert!(settled.iter().copied().eq(0..frames.len() as u64), "{:?}", settled);
        prop_assert_eq!(intake.dropped_len(), 0);
    }

    #[test]
    fn frames_of_a_replaced_process_are_refused_up_to_a_limit(
        newest in 1..9_u32, older in 0..8_u32, old_count in 1..40_u32,
    ) {
        let (mut intake, older) = (intake(false), older.min(newest - 1));
        prop_assert!(is_accepted(&mut intake, &tick(0, newest)));
        for count in 1..=old_count {
            let decision = decide(&mut intake, &tick(u64::from(count), older));
            let is_reverted = count > OLD_MAX;
            prop_assert_eq!(decision == Decision::Accepted, is_reverted, "frame {}", count);
        }
        prop_assert_eq!(intake.rejected_len(), u64::from(old_count.min(OLD_MAX)));
    }

    #[test]
    fn ticks_that_were_lost_with_a_restarted_stage_do_not_count(
        lost_with_it in 0..30_u64, dropped in 0..30_u64, is_sender in any::<bool>(),
    ) {
        let mut intake = intake(false);
        prop_assert!(is_accepted(&mut intake, &tick(4, 0)));
        let restarted = |seq: u64| {
            let mut header = tick(seq, u32::from(is_sender));
            header.push_hop(Hop { stage: StageId::Decoder.number(), incarnation: 1, ..Hop::default() });
            header
        };
        let first = 5 + lost_with_it;
        prop_assert!(is_accepted(&mut intake, &restarted(first)));
        prop_assert_eq!(intake.dropped_len(), 0);
        prop_assert!(is_accepted(&mut intake, &restarted(first + 1 + dropped)));
        prop_assert_eq!(intake.dropped_len(), dropped);
    }

    #[test]
    fn a_replacement_skips_the_ticks_that_were_answered_and_counts_no_gap(
        answered in 0..50_u64, first in 0..60_u64, gap in 0..9_u64,
    ) {
        let mut intake = intake(false);
        intake.resume_after(answered);
        for seq in first..=answered {
            prop_assert_eq!(decide(&mut intake, &tick(seq, 0)), Decision::Answered);
        }
        let next = answered + 1 + gap;
        prop_assert!(is_accepted(&mut intake, &tick(next, 0)));
        prop_assert_eq!(intake.dropped_len(), 0);
        prop_assert!(is_accepted(&mut intake, &tick(next + 1 + gap, 0)));
        prop_assert_eq!(intake.dropped_len(), gap);
    }

    #[test]
    fn every_frame_has_one_place_and_a_far_tick_leaves_no_trace(
        seq in 0..90_u64, awaited in 0..90_u64, is_tick in any::<bool>(),
    ) {
        let header = if is_tick { tick(seq, 0) } else { Header { seq, ..warm_up() } };
        let expected = match seq.checked_sub(awaited) {
            Some(0) if is_tick => Place::Awaited,
            Some(lead) if is_tick && lead <= AHEAD_MAX => Place::After,
            Some(_) if is_tick => Place::TooFar,
            _ => Place::Before,
        };
        prop_assert_eq!(Place::of(&header, awaited), expected);
        if expected == Place::TooFar {
            let mut intake = intake(false);
            prop_assert!(is_accepted(&mut intake, &warm_up()));
            for before in 0..awaited {
                prop_assert!(is_accepted(&mut intake, &tick(before, 0)));
            }
            prop_assert!(is_accepted(&mut intake, &header));
            intake.refuse_far(&header, awaited);
            prop_assert!(is_accepted(&mut intake, &tick(awaited, 0)));
            prop_assert_eq!((intake.dropped_len(), intake.rejected_len()), (0, 1));
        }
    }

    #[test]
    fn any_header_gets_a_decision_and_each_refusal_is_counted(
        headers in prop::collection::vec(any::<[u8; 32]>(), 1..40), lockstep in any::<bool>(),
    ) {
        let (mut intake, mut refused) = (intake(lockstep), 0);
        for bytes in headers {
            let mut header = tick(u64::from(bytes[0]) % 20, 0);
            for edit in bytes[1..].chunks_exact(3).take(usize::from(bytes[0]) % 4) {
                let place = usize::from(u16::from_le_bytes([edit[0], edit[1]]));
                let all = bytemuck::bytes_of_mut(&mut header);
                all[place % size_of::<Header>()] ^= edit[2];
            }
            refused += u64::from(matches!(decide(&mut intake, &header), Decision::Refused(_)));
            intake.take_lost();
        }
        prop_assert_eq!(intake.rejected_len(), refused);
        let counted: u64 = intake.refusals().iter().map(|entry| u64::from(entry.frames_len)).sum();
        prop_assert!(counted <= refused, "{} of {}", counted, refused);
    }
}

#[test]
fn repeated_counters_are_refused_and_several_writers_have_their_own() {
    for one_writer in [true, false] {
        let mut intake = intake(false);
        (intake.rules.protected, intake.rules.one_writer) = (true, one_writer);
        let mut decide = |seq: u64, counter: u32| {
            let mut header = tick(seq, 0);
            header.protection.counter = counter;
            intake.decide(&header, 0, || Ok(())) == Decision::Accepted
        };
        assert!(decide(0, 5) && decide(1, 6));
        assert_eq!((decide(2, 6), decide(3, 5)), (!one_writer, !one_writer));
        assert!(decide(4, 30));
    }
    let mut intake = intake(false);
    intake.rules.protected = true;
    let wrong = Rejected::CheckValue { found: 1, expected: 2 };
    assert_eq!(intake.decide(&tick(0, 0), 0, || Err(wrong.clone())), Decision::Refused(wrong.clone()));
}
