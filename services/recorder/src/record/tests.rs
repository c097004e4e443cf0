use audit::{Doubt, Found};
use bytemuck::Zeroable;
use wire::{AgentType, Counts, Hop, InputCounts};

use super::*;
use crate::Status;
use crate::input::InputReport;
use crate::report::Percentiles;
use crate::report::Shed;

const TICK_NS: u64 = 80_000_000;
const MS: u64 = 1_000_000;

/// Wake-up of every stage. `PUBLISH_NS` is its time to publish.
const WAKE_UP_NS: u64 = 50_000;
const PUBLISH_NS: u64 = 10_000;

/// The header of a tick that passed `stages`, each with its compute in ms.
fn header(seq: u64, agents_len: u32, stages: &[(StageId, u64)]) -> Header {
    let counts = Counts { agents_len, horizon_len: 12, ..Counts::default() };
    let released_ns = 1_000 * MS + seq * TICK_NS;
    let mut header = Header {
        counts,
        released_ns,
        interval_ns: TICK_NS,
        step_ns: 400 * MS,
        ..Header::new(1, seq, (seq * TICK_NS) as i64)
    };
    let mut now_ns = released_ns;
    for &(stage, compute_ms) in stages {
        let received_ns = now_ns + WAKE_UP_NS;
        let finished_ns = received_ns + compute_ms * MS;
        now_ns = finished_ns + PUBLISH_NS;
        header.push_hop(Hop {
            stage: stage.number(),
            incarnation: 0,
            received_ns,
            started_ns: received_ns,
            finished_ns,
            sent_ns: now_ns,
        });
    }
    header
}

fn whole_chain(compute_ms: u64) -> Vec<(StageId, u64)> {
    StageId::ALL[..7].iter().map(|&stage| (stage, compute_ms)).collect()
}

fn forecast(quality: Quality, cause: Cause) -> Forecast {
    Forecast {
        id: 1,
        agent_type: AgentType::Pedestrian as u32,
        quality: quality as u32,
        cause: cause as u32,
        modes_len: 1,
        age_ns: if quality == Quality::Held { 160 * MS } else { 0 },
        ..Forecast::zeroed()
    }
}

fn learned() -> Forecast {
    forecast(Quality::Learned, Cause::None)
}

fn recorder() -> Recorder {
    let budgets_ms = StageId::ALL[..7].iter().map(|&stage| (stage, 10.0)).collect();
    let run = RunInfo {
        recording: Some("intersection".to_owned()),
        seed: Some(3),
        speed: Some("real".to_owned()),
        ..RunInfo::default()
    };
    let mut recorder = Recorder::new(RecorderOptions { run, budgets_ms, ..RecorderOptions::default() });
    let link = Header { flags: flags::WARM_UP, ..header(0, 0, &whole_chain(70)) };
    recorder.forecasts(&link, &[]).unwrap();
    recorder
}

fn truth_header(seq: u64) -> Header {
    Header::new(1, seq, (seq * TICK_NS) as i64)
}

/// A run with one of each possible fault. The agent stands still at the origin.
pub(crate) fn eventful() -> Report {
    let mut recorder = recorder();
    let truth = Truth { id: 5, agent_type: AgentType::Pedestrian as u32, ..Truth::zeroed() };
    for seq in 0..100 {
        recorder.truth(&truth_header(seq), &[truth]).unwrap();
        let (stages, forecast) = match seq {
            0..4 => (whole_chain(2), forecast(Quality::Kinematic, Cause::Young)),
            40 => (whole_chain(12), Forecast { prior: Quality::Held as u32, ..learned() }),
            41 => (StageId::ALL[..7].iter().copied().zip([1, 2, 3, 8, 4, 9, 2]).collect(), learned()),
            50 => (
                vec![(StageId::Source, 2), (StageId::Tracker, 2), (StageId::Sampler, 2)],
                forecast(Quality::Held, Cause::Late),
            ),
            60 | 61 => continue,
            _ => (whole_chain(2), learned()),
        };
        // In truth at rest, but estimated to drift: the error of constant velocity grows by 0.3 m per second.
        let forecast = Forecast { vx_mps: 0.3, best: [[0.5, 0.0]; 12], ..forecast };
        recorder.forecasts(&header(seq, 1, &stages), &[forecast]).unwrap();
    }
    recorder.heartbeat(&Heartbeat {
        stage: StageId::Encoder.number(),
        incarnation: 1,
        dropped_len: 1,
        rejected_len: 1,
        ..Heartbeat::zeroed()
    });
    recorder.report()
}

#[test]
fn known_hops_give_exact_percentiles() {
    let mut recorder = recorder();
    for seq in 0..100 {
        recorder.forecasts(&header(seq, 1, &whole_chain(2)), &[learned()]).unwrap();
    }
    let report = recorder.report();
    assert_eq!((report.ticks, report.late_ticks, report.drops), (100, 0, 0));
    let exactly = |ms| Percentiles { p50: Some(ms), p99: Some(ms), p999: None, max: Some(ms) };
    assert_eq!(report.end_to_end_ms, exactly(7.0 * 2.06));
    assert_eq!(report.overhead_ms, exactly(0.42));
    assert_eq!(report.stages.len(), 7);
    for stage in &report.stages {
        assert_eq!(stage.compute_ms, exactly(2.0));
        assert_eq!(stage.wake_up_ms, exactly(0.05));
        assert_eq!(stage.publish_ms, exactly(0.01));
        assert_eq!(stage.waiting_ms, exactly(0.0));
        assert_eq!((stage.budget_share_p50, stage.budget_share_p99), (Some(0.2), Some(0.2)));
        assert_eq!((stage.ticks, stage.late_ticks), (100, 0));
    }
    assert_eq!(report.verdict, Verdict { status: Status::Ok, reasons: Vec::new() });
    assert_eq!(report.run.played_s, Some(7.92));
}

#[test]
fn what_was_shed_is_counted_with_its_share_and_greatest_age() {
    let mut recorder = recorder();
    let held = |age_ms: u64| Forecast { age_ns: age_ms * 1_000_000, ..forecast(Quality::Held, Cause::Shed) };
    for seq in 0..100 {
        let forecasts = match seq {
            10 => [learned(), held(80), held(240)],
            20 => [learned(), held(160), forecast(Quality::Kinematic, Cause::Shed)],
            30 => [
                learned(),
                held(80),
                Forecast { age_ns: 800_000_000, ..forecast(Quality::Held, Cause::Late) },
            ],
            _ => [learned(); 3],
        };
        recorder.forecasts(&header(seq, 3, &whole_chain(2)), &forecasts).unwrap();
    }
    let kept: Checkpoint =
        serde_json::from_slice(&serde_json::to_vec(&recorder.checkpoint()).unwrap()).unwrap();
    for report in [recorder.report(), Recorder::resume(RecorderOptions::default(), kept).report()] {
        let Shed { forecasts, ticks, share, agents_max, age_ms_max } = report.forecasts.shed;
        assert_eq!((forecasts, ticks, agents_max), (5, 3, 2));
        assert_eq!((share, age_ms_max), (Some(0.0167), Some(240.0)));
        assert_eq!((report.forecasts.causes["shed"], report.forecasts.degraded_ticks), (5, 3));
        let text = report.render(80);
        assert!(
            text.contains(
                " shed                 5    1.7 %   no time: in 3 ticks, at most 2 agents, at most 240 ms old"
            ),
            "{text}"
        );
        assert!(text.contains("forecasts not learned: 6 in 3 of 100 ticks (late 1, shed 5)"), "{text}");
    }
}

#[test]
fn the_time_since_the_stamp_needs_stamps_in_unix_time() {
    let offset_ns = 1_700_000_000_000_000_000;
    let since_ms = |stamped: fn(i64, u64) -> i64, offset_ns: Option<i64>| {
        let mut recorder = recorder();
        offset_ns.into_iter().for_each(|offset_ns| recorder.set_clock_offset(offset_ns));
        for seq in 0..10 {
            let of = header(seq, 1, &whole_chain(2));
            let of = Header { stamp_ns: stamped(1_700_000_000_000_000_000, of.released_ns), ..of };
            recorder.forecasts(&of, &[learned()]).unwrap();
        }
        recorder.report().since_stamp_ms.p50
    };
    // 10 ms before the release; the chain takes 14.4 ms.
    let unix: fn(i64, u64) -> i64 = |offset_ns, released_ns| offset_ns + released_ns as i64 - 10_000_000;
    let since = since_ms(unix, Some(offset_ns)).unwrap();
    assert!((since - 24.4).abs() < 0.3, "{since} ms");
    assert_eq!(since_ms(unix, None), None);
    // The clock of a recording, and one that is ahead.
    assert_eq!(since_ms(|_, released_ns| released_ns as i64, Some(offset_ns)), None);
    assert_eq!(
        since_ms(|offset_ns, released_ns| offset_ns + released_ns as i64 + 50_000_000, Some(offset_ns)),
        None
    );
}

#[test]
fn constant_velocity_that_proved_better_is_no_fault() {
    let mut recorder = recorder();
    let outdone = forecast(Quality::Kinematic, Cause::Outdone);
    for seq in 0..100 {
        let other = if seq < 10 { forecast(Quality::Kinematic, Cause::Young) } else { learned() };
        recorder.forecasts(&header(seq, 3, &whole_chain(2)), &[outdone, outdone, other]).unwrap();
    }
    let report = recorder.report();
    let counts = &report.forecasts;
    assert_eq!((report.verdict.status, counts.not_learned, counts.degraded_ticks), (Status::Ok, 0, 0));
    assert_eq!(counts.constant_velocity_share, Some(0.6667));
    assert_eq!(report.ok_lines()[1], "constant velocity: 67 % of the forecasts: its error was lower");

    let late = forecast(Quality::Held, Cause::Late);
    recorder.forecasts(&header(100, 3, &whole_chain(2)), &[outdone, late, late]).unwrap();
    let report = recorder.report();
    assert_eq!((report.forecasts.not_learned, report.forecasts.degraded_ticks), (2, 1));
    assert_eq!(report.verdict.reasons, ["forecasts not learned: 2 in 1 of 101 ticks (late 2)"]);
}

#[test]
fn a_late_void_tick_is_not_lost() {
    let mut recorder = recorder();
    for seq in 0..100 {
        let in_order = header(seq, 1, &whole_chain(2));
        if seq == 50 {
            let late = Header { stamp_ns: 48 * TICK_NS as i64 + 1, ..in_order };
            // A frame of an earlier tick is no session.
            let earlier = Header { seq: 48, ..late };
            assert!(matches!(recorder.forecasts(&earlier, &[learned()]), Err(Rejected::NotNewer { .. })));
            let counts = Counts { agents_len: 0, ..late.counts };
            recorder.forecasts(&Header { flags: flags::VOID, counts, ..late }, &[]).unwrap();
        } else {
            recorder.forecasts(&in_order, &[learned()]).unwrap();
        }
    }
    let report = recorder.report();
    assert_eq!((report.ticks, report.drops, report.run.played_s), (99, 1, Some(7.92)));
    assert_eq!(report.unpublished_ticks, 1, "the refused frame has no place, the VOID tick has one");
}

#[test]
fn the_report_has_the_keys_that_scripts_rely_on() {
    insta::assert_snapshot!(eventful().to_json());
}

#[test]
fn unknown_values_are_null() {
    let json: serde_json::Value =
        serde_json::from_str(&Recorder::new(RecorderOptions::default()).report().to_json()).unwrap();
    assert_eq!(json["ticks"], 0);
    assert_eq!(json["verdict"]["status"], "empty");
    for pointer in
        ["/end_to_end_ms/p50", "/overhead_ms/p99", "/accuracy/ade_m", "/accuracy/draws", "/agents/mean"]
    {
        assert_eq!(json.pointer(pointer), Some(&serde_json::Value::Null), "{pointer}");
    }
}

#[test]
fn a_report_can_be_read_from_its_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("report.json");
    let report = eventful();
    report.write(&path).unwrap();
    assert_eq!(Report::read(&path).unwrap(), report);
    std::fs::write(&path, "{\"version\": 1,\n \"ticks\": -3}").unwrap();
    let error = Report::read(&path).unwrap_err().to_string();
    assert!(error.contains("report.json") && error.contains("line 2"), "{error}");
}

#[test]
fn ticks_beyond_the_interval_or_the_limit_are_late() {
    let mut recorder = recorder();
    let mut fast = header(0, 0, &whole_chain(7));
    fast.interval_ns = 40 * MS;
    recorder.forecasts(&fast, &[]).unwrap();
    assert_eq!(recorder.report().late_ticks, 1, "49 ms at a frame every 40 ms");
    let mut slow = header(1, 0, &whole_chain(7));
    slow.interval_ns = 400 * MS;
    recorder.forecasts(&slow, &[]).unwrap();
    recorder.forecasts(&header(2, 0, &whole_chain(12)), &[]).unwrap();
    assert_eq!(recorder.report().late_ticks, 2, "49 ms is in time, 84 ms is not");
}

#[test]
fn gaps_are_drops_also_before_the_end_frame() {
    let mut recorder = recorder();
    for seq in [1, 2, 5] {
        recorder.forecasts(&header(seq, 1, &whole_chain(1)), &[learned()]).unwrap();
    }
    assert_eq!(recorder.report().drops, 3);
    let end = Header { flags: flags::END, ..header(7, 0, &[]) };
    recorder.forecasts(&end, &[]).unwrap();
    let report = recorder.report();
    assert_eq!((report.drops, report.ticks), (4, 3));
    assert_eq!(report.verdict.reasons, ["frames lost: 4 (recorder 4)"]);
}

/// A run of a hundred ticks with one agent and these doubts in its headers.
fn with_doubts(doubts: u32) -> Recorder {
    let mut recorder = recorder();
    for seq in 0..100 {
        let input = InputCounts { detections: seq as u32 + 1, doubts, ..InputCounts::default() };
        let header = Header { input, ..header(seq, 1, &whole_chain(2)) };
        recorder.forecasts(&header, &[learned()]).unwrap();
    }
    recorder
}

#[test]
fn doubts_about_the_input_make_a_run_doubtful() {
    let report = with_doubts(Doubt::HeadingsInDegrees.bit()).report();
    let reason = "input: headings look like degrees: divide them by 57.29578";
    let expected = Verdict { status: Status::Doubtful, reasons: vec![reason.to_owned()] };
    assert_eq!((report.verdict.clone(), report.input.detections), (expected, 100));
    assert!(report.is_doubtful() && report.render(80).contains(" DOUBTFUL    input: headings look"));
    assert!(!with_doubts(0).report().is_doubtful());
    // A fault of the run takes precedence, and the doubt remains a reason.
    let mut report = report;
    report.supervised(Supervision { ended_by: Some("a test".to_owned()), ..Supervision::default() });
    assert_eq!((report.verdict.status, report.verdict.reasons.len()), (Status::Degraded, 2));
    assert!(report.is_doubtful());
}

#[test]
fn the_noise_is_reported_and_its_change_is_a_doubt_with_figures() {
    let mut recorder = recorder();
    for seq in 0..800 {
        let doubts = if seq > 550 { Doubt::NoiseChanged.bit() } else { 0 };
        let input = InputCounts { doubts, ..InputCounts::default() };
        let noise_m = if seq < 500 { 0.1 } else { 0.35 };
        let forecast = Forecast { noise_m, noise_heading_rad: 0.05, ..learned() };
        recorder.forecasts(&Header { input, ..header(seq, 1, &whole_chain(2)) }, &[forecast]).unwrap();
    }
    let mut report = recorder.report();
    // The audit of the recording knows nothing of the noise.
    report.audited(&InputReport::of_recording(Vec::new(), BTreeMap::new(), 0));
    let figures = "the position noise of pedestrians rose from 0.10 m to 0.35 m at 40 s: check the detector";
    assert_eq!(report.verdict.reasons, [format!("input: {figures}")]);
    assert_eq!(report.input.noise_line().unwrap(), "pedestrians 0.35 m, headings 2.9°");
    assert!(report.render(80).contains(" noise       pedestrians 0.35 m, headings 2.9°"));
    // A recorder that starts after the change knows the kind alone.
    let report = with_doubts(Doubt::NoiseChanged.bit()).report();
    assert!(report.verdict.reasons[0].contains("has changed by a factor of three"), "{:?}", report.verdict);
    assert!(report.input.noise.is_empty());
}

#[test]
fn the_audit_of_the_recording_completes_the_verdict() {
    let mut report = with_doubts(Doubt::Repeated.bit()).report();
    let known = Found { rows: Some(3), of: Some(9), share: Some(0.3333), ..Found::of_kind(Doubt::Repeated) };
    let input = InputReport::of_recording(vec![known], BTreeMap::new(), 0);
    report.audited(&input);
    assert_eq!(report.verdict.status, Status::Doubtful);
    let [reason] = &report.verdict.reasons[..] else { panic!("{:?}", report.verdict) };
    assert!(reason.ends_with("(3 of 9 rows, 33.3 %)"), "{reason}");
}

#[test]
fn a_run_without_any_agent_is_empty() {
    let mut recorder = recorder();
    for seq in 0..9 {
        let input = InputCounts { detections: 5 * (seq as u32 + 1), ..InputCounts::default() };
        recorder.forecasts(&Header { input, ..header(seq, 0, &whole_chain(2)) }, &[]).unwrap();
    }
    let report = recorder.report();
    let reason = "no agent was tracked in any of 9 ticks, of 45 detections";
    assert_eq!(report.verdict, Verdict { status: Status::Empty, reasons: vec![reason.to_owned()] });
    assert!(report.is_doubtful());
}

#[test]
fn a_recorder_started_late_counts_from_its_first_tick() {
    let mut recorder = Recorder::new(RecorderOptions::default());
    recorder.forecasts(&header(500, 0, &whole_chain(1)), &[]).unwrap();
    assert_eq!(recorder.report().drops, 0);
}

#[test]
fn invalid_frames_are_only_counted() {
    let mut recorder = recorder();
    recorder.forecasts(&header(0, 1, &whole_chain(1)), &[learned()]).unwrap();
    let short = recorder.forecasts(&header(1, 2, &whole_chain(1)), &[learned()]);
    assert_eq!(short, Err(Rejected::Length { found: 1, expected: 2 }));
    let mut broken = learned();
    broken.mean[3][0] = f32::NAN;
    assert!(recorder.forecasts(&header(1, 1, &whole_chain(1)), &[broken]).is_err());
    assert!(recorder.forecasts(&header(0, 1, &whole_chain(1)), &[learned()]).is_err(), "the same tick again");
    let report = recorder.report();
    assert_eq!((report.ticks, report.forecasts.learned, report.drops), (1, 1, 3));
}

#[test]
fn warm_up_frames_are_not_counted() {
    let mut recorder = recorder();
    let link = Header { flags: flags::WARM_UP, ..header(0, 0, &whole_chain(70)) };
    recorder.truth(&link, &[]).unwrap();
    recorder.forecasts(&header(0, 0, &whole_chain(1)), &[]).unwrap();
    let report = recorder.report();
    assert_eq!((report.ticks, report.late_ticks, report.drops), (1, 0, 0));
}
