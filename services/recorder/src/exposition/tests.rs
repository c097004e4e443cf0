use bytemuck::Zeroable;
use wire::{Cause, Forecast, Header, Heartbeat, Hop, LinkCount, Quality, RefusalCause, Refusals};

use super::*;
use crate::record::RecorderOptions;
use crate::report::Errors;
use crate::status::{Facts, ProcessStatus};

const MS: u64 = 1_000_000;

/// A run of a few ticks, with a refusal, a restart and a title that requires escapes.
fn run_so_far() -> (RunStatus, Recorder) {
    let budgets_ms = [(StageId::Tracker, 5.0)].into();
    let options = RecorderOptions { scores: false, budgets_ms, ..RecorderOptions::default() };
    let mut measured = Recorder::new(options);
    let held = Forecast {
        quality: Quality::Held as u32,
        cause: Cause::Late as u32,
        age_ns: 80 * MS,
        noise_m: 0.11,
        noise_heading_rad: 0.5_f32.to_radians(),
        ..Forecast::zeroed()
    };
    for seq in 0..20 {
        let released_ns = 1_000 * MS + seq * 80 * MS;
        let mut header = Header { released_ns, ..Header::new(1, seq, (seq * 80 * MS) as i64) };
        header.counts.agents_len = 2;
        for (stage, at_ms) in [(StageId::Source, 0), (StageId::Tracker, 1), (StageId::Sampler, 7)] {
            let at_ns = released_ns + at_ms * MS;
            let (started_ns, finished_ns, sent_ns) = (at_ns + 1_000, at_ns + MS, at_ns + MS + 2_000);
            let stage = stage.number();
            header.push_hop(Hop {
                stage,
                incarnation: 0,
                received_ns: at_ns,
                started_ns,
                finished_ns,
                sent_ns,
            });
        }
        measured.forecasts(&header, &[Forecast::zeroed(), held]).unwrap();
    }
    let mut heartbeat = Heartbeat {
        stage: StageId::Sampler.number(),
        frames_len: 20,
        seq: 19,
        sent_ns: 9,
        ..Heartbeat::zeroed()
    };
    heartbeat.rejected_len = 3;
    Refusals::count(&mut heartbeat.refusals, StageId::Decoder.number(), RefusalCause::CheckValue, 3);
    Refusals::put_link(&mut heartbeat.refusals, [(LinkCount::WrongKey, 4)]);
    measured.heartbeat(&heartbeat);
    let process = ProcessStatus {
        state: "running".to_owned(),
        pid: Some(7),
        restarts: 2,
        cpu_s: Some(1.25),
        cpu: Some(0.5),
        memory_bytes: Some(1 << 20),
        shared_bytes: Some(1 << 21),
        ..ProcessStatus::default()
    };
    let facts = Facts {
        run: "stgdat_00000007".to_owned(),
        processes: [(StageId::Tracker, process)].into(),
        accuracy: Some(Errors { held_50: Some(0.51), held_90: Some(0.88), ..Errors::default() }),
        title: "say \"hello\"\\\nworld".to_owned(),
        ..Facts::default()
    };
    (RunStatus::new(&measured, facts), measured)
}

fn text() -> String {
    let (status, measured) = run_so_far();
    metrics(&status, &measured)
}

/// The value of the sample that begins with this text.
fn value(text: &str, sample: &str) -> Option<f64> {
    text.lines().find_map(|line| line.strip_prefix(sample)?.strip_prefix(' ')?.parse().ok())
}

#[test]
fn samples_have_the_values_of_the_run() {
    let text = text();
    let expected = [
        ("stgdat_ticks_total", 20.0),
        ("stgdat_degraded_ticks_total", 20.0),
        ("stgdat_forecasts_total{quality=\"held\"}", 20.0),
        ("stgdat_fallbacks_total{cause=\"late\"}", 20.0),
        ("stgdat_agents", 2.0),
        ("stgdat_refused_frames_total{reader=\"sampler\",sender=\"decoder\",cause=\"check value\"}", 3.0),
        ("stgdat_link_total{stage=\"sampler\",kind=\"another key\"}", 4.0),
        ("stgdat_dropped_frames_total{stage=\"sampler\",cause=\"refused\"}", 3.0),
        ("stgdat_restarts_total{stage=\"tracker\"}", 2.0),
        ("stgdat_stage_cpu_seconds_total{stage=\"tracker\"}", 1.25),
        ("stgdat_stage_memory_bytes{stage=\"tracker\"}", 1_048_576.0),
        ("stgdat_region_coverage_ratio{level=\"0.9\"}", 0.88),
        ("stgdat_end_to_end_seconds_count", 20.0),
        ("stgdat_end_to_end_seconds_bucket{le=\"0.005\"}", 0.0),
        ("stgdat_end_to_end_seconds_bucket{le=\"0.01\"}", 20.0),
        ("stgdat_stage_seconds_count{stage=\"tracker\",phase=\"compute\"}", 20.0),
        ("stgdat_stage_budget_seconds{stage=\"tracker\"}", 0.005),
        ("stgdat_detector_noise_meters{type=\"vehicle\"}", 0.11),
        ("stgdat_detector_noise_heading_degrees{type=\"vehicle\"}", 0.5),
    ];
    for (sample, expected) in expected {
        assert_eq!(value(&text, sample), Some(expected), "{sample}");
    }
    assert!(text.contains(r#"recording="say \"hello\"\\\nworld""#));
}

#[test]
fn the_text_follows_the_format() {
    let text = text();
    let (mut metric, mut seen) = (String::new(), std::collections::BTreeSet::new());
    let mut kind = String::new();
    for line in text.lines() {
        if let Some(help) = line.strip_prefix("# HELP ") {
            metric = help.split(' ').next().unwrap().to_owned();
            assert!(seen.insert(metric.clone()), "{metric} comes twice");
            continue;
        }
        if let Some(of) = line.strip_prefix("# TYPE ") {
            let (name, of_kind) = of.split_once(' ').unwrap();
            assert_eq!(name, metric);
            kind = of_kind.to_owned();
            assert_eq!(kind == "counter", name.ends_with("_total"), "{name}");
            continue;
        }
        let (sample, number) = line.rsplit_once(' ').unwrap();
        number.parse::<f64>().unwrap_or_else(|_| panic!("{line}"));
        let name = sample.split('{').next().unwrap();
        let of_histogram = ["_bucket", "_sum", "_count"].map(|end| format!("{metric}{end}"));
        let is_of_metric =
            if kind == "histogram" { of_histogram.contains(&name.to_owned()) } else { name == metric };
        assert!(is_of_metric, "{line} after {metric}");
        assert!(name.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'_'), "{name}");
    }
    assert!(text.ends_with('\n') && seen.len() > 25);
}

#[test]
fn buckets_increase_up_to_the_count() {
    let text = text();
    let buckets: Vec<f64> = text
        .lines()
        .filter(|line| line.starts_with("stgdat_end_to_end_seconds_bucket"))
        .map(|line| line.rsplit_once(' ').unwrap().1.parse().unwrap())
        .collect();
    assert!(buckets.is_sorted());
    assert_eq!(buckets.last().copied(), value(&text, "stgdat_end_to_end_seconds_count"));
}

#[test]
fn the_status_reads_back_as_written() {
    let (status, _) = run_so_far();
    let json = serde_json::to_string(&status).unwrap();
    assert_eq!(serde_json::from_str::<RunStatus>(&json).unwrap(), status);
    assert_eq!(status.newest.tick, Some(19));
    assert_eq!(status.newest.causes.get("late"), Some(&1));
    let sampler = status.stages.iter().find(|stage| stage.name == "sampler").unwrap();
    assert_eq!(sampler.behind_ticks, Some(0));
}

#[test]
fn a_run_that_has_not_begun_has_metrics_too() {
    let measured = Recorder::new(RecorderOptions::default());
    let status = RunStatus::new(&measured, Facts::default());
    let text = metrics(&status, &measured);
    assert_eq!(value(&text, "stgdat_ticks_total"), Some(0.0));
    assert!(!text.contains("NaN"));
}
