//! A running pipeline as metrics in Prometheus' text format, version 0.0.4.
//!
//! Names start with `stgdat_`, units are seconds and bytes, and counters end in `_total`. Histograms cover
//! the whole run. `recent` gauges cover the last ten seconds.

use std::fmt::{Display, Write};

use audit::TypeNoise;
use wire::StageId;

use crate::distribution::Distribution;
use crate::passage::Phases;
use crate::record::Recorder;
use crate::report::{Percentiles, Report};
use crate::status::{RunStatus, StageStatus};

/// Media type of the text.
pub const CONTENT_TYPE: &str = "text/plain; version=0.0.4; charset=utf-8";

/// Upper bounds of the histograms' buckets, except infinity.
const BOUNDS_NS: [u64; 17] = [
    50_000,
    100_000,
    250_000,
    500_000,
    1_000_000,
    2_500_000,
    5_000_000,
    10_000_000,
    15_000_000,
    20_000_000,
    30_000_000,
    40_000_000,
    60_000_000,
    80_000_000,
    120_000_000,
    250_000_000,
    1_000_000_000,
];

/// The kind of a metric.
#[derive(Clone, Copy)]
enum Kind {
    Counter,
    Gauge,
    Histogram,
}

impl Kind {
    const fn name(self) -> &'static str {
        match self {
            Self::Counter => "counter",
            Self::Gauge => "gauge",
            Self::Histogram => "histogram",
        }
    }
}

/// The text of the metrics while it is written.
#[derive(Default)]
struct Text(String);

/// Names and values of a sample's labels.
type Labels<'a> = &'a [(&'a str, &'a str)];

impl Text {
    /// Begins a metric. Its samples must follow immediately.
    fn metric(&mut self, kind: Kind, name: &str, help: &str) {
        // Here and below: writing to a string does not fail.
        let _ = writeln!(self.0, "# HELP {name} {help}\n# TYPE {name} {}", kind.name());
    }

    fn sample(&mut self, name: &str, labels: Labels<'_>, value: impl Display) {
        self.0.push_str(name);
        for ((label, text), before) in labels.iter().zip(std::iter::once('{').chain(std::iter::repeat(','))) {
            let _ = write!(self.0, "{before}{label}=\"{}\"", escaped(text));
        }
        let close = if labels.is_empty() { "" } else { "}" };
        let _ = writeln!(self.0, "{close} {value}");
    }

    /// A metric with one sample.
    fn single(&mut self, kind: Kind, name: &str, help: &str, value: impl Display) {
        self.metric(kind, name, help);
        self.sample(name, &[], value);
    }

    fn histogram(&mut self, name: &str, labels: Labels<'_>, times: &Distribution) {
        let bucket = format!("{name}_bucket");
        let counts = times.counts_up_to(&BOUNDS_NS);
        let bounds = BOUNDS_NS.iter().map(|&bound_ns| seconds(bound_ns).to_string());
        for (bound, count) in bounds.zip(counts).chain([("+Inf".to_owned(), times.len())]) {
            let all: Vec<(&str, &str)> = labels.iter().copied().chain([("le", bound.as_str())]).collect();
            self.sample(&bucket, &all, count);
        }
        self.sample(&format!("{name}_sum"), labels, seconds(times.sum_ns()));
        self.sample(&format!("{name}_count"), labels, times.len());
    }

    /// Median, 99th percentile and maximum, as gauges with a label.
    fn quantiles(&mut self, name: &str, labels: Labels<'_>, times: &Percentiles) {
        for (quantile, value_ms) in [("0.5", times.p50), ("0.99", times.p99), ("1", times.max)] {
            let Some(value_ms) = value_ms else { continue };
            let all: Vec<(&str, &str)> = labels.iter().copied().chain([("quantile", quantile)]).collect();
            self.sample(name, &all, value_ms / 1e3);
        }
    }
}

/// Escapes the value of a label.
fn escaped(text: &str) -> String {
    text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}

fn seconds(time_ns: u64) -> f64 {
    time_ns as f64 / 1e9
}

/// The metrics of a run, from its status and its measurements.
#[must_use]
pub fn metrics(status: &RunStatus, measured: &Recorder) -> String {
    let mut text = Text::default();
    run(&mut text, status);
    ticks(&mut text, status, measured);
    forecasts(&mut text, status);
    input(&mut text, status);
    losses(&mut text, status);
    stage_times(&mut text, status, measured);
    processes(&mut text, status);
    text.0
}

fn run(text: &mut Text, status: &RunStatus) {
    text.metric(Kind::Gauge, "stgdat_run_info", "The run: its name, recording and version; always 1.");
    let version = status.report.stgdat_version.as_str();
    let labels = [("run", status.run.as_str()), ("recording", status.title.as_str()), ("version", version)];
    text.sample("stgdat_run_info", &labels, 1);
    let linked = u8::from(status.linked);
    text.single(Kind::Gauge, "stgdat_linked", "1 once a frame has passed through the whole chain.", linked);
    let elapsed = "Time since the release of the first tick.";
    text.single(Kind::Gauge, "stgdat_run_elapsed_seconds", elapsed, status.elapsed_s);
}

fn ticks(text: &mut Text, status: &RunStatus, measured: &Recorder) {
    let report = &status.report;
    let counters = [
        ("stgdat_ticks_total", "Ticks whose forecasts were received.", report.ticks),
        ("stgdat_late_ticks_total", "Ticks whose forecasts were sent after the limit.", report.late_ticks),
        (
            "stgdat_degraded_ticks_total",
            "Ticks with a forecast that is held or kinematic through a fault.",
            report.forecasts.degraded_ticks,
        ),
        (
            "stgdat_predicted_ticks_total",
            "Ticks of predicted tracks, whose detections are missing.",
            report.forecasts.predicted_ticks,
        ),
    ];
    for (name, help, count) in counters {
        text.single(Kind::Counter, name, help, count);
    }
    if let Some(limit_ms) = report.late_limit_ms {
        let help = "A tick that takes longer is late.";
        text.single(Kind::Gauge, "stgdat_tick_limit_seconds", help, limit_ms / 1e3);
    }
    let [end_to_end, overhead] = measured.latencies();
    for (name, help, times) in [
        (
            "stgdat_end_to_end_seconds",
            "From the release of a tick to the sending of its forecasts.",
            end_to_end,
        ),
        ("stgdat_overhead_seconds", "End to end less the compute of all stages.", overhead),
    ] {
        text.metric(Kind::Histogram, name, help);
        text.histogram(name, &[], times);
    }
    let name = "stgdat_recent_end_to_end_seconds";
    text.metric(Kind::Gauge, name, "Quantiles of the end-to-end latency of the last ten seconds.");
    text.quantiles(name, &[], &status.recent_end_to_end_ms);
}

fn forecasts(text: &mut Text, status: &RunStatus) {
    let report = &status.report;
    let forecasts = &report.forecasts;
    let name = "stgdat_forecasts_total";
    text.metric(Kind::Counter, name, "Forecasts of single agents by quality.");
    for (quality, count) in forecasts.by_quality() {
        text.sample(name, &[("quality", quality)], count);
    }
    let name = "stgdat_fallbacks_total";
    text.metric(Kind::Counter, name, "Forecasts that are held or kinematic, by cause.");
    for (cause, count) in &forecasts.causes {
        text.sample(name, &[("cause", cause)], count);
    }
    let name = "stgdat_track_states_total";
    text.metric(Kind::Counter, name, "Track states by the prior that predicted them.");
    let priors = &report.priors;
    for (prior, count) in
        [("learned", priors.learned), ("held", priors.held), ("kinematic", priors.kinematic)]
    {
        text.sample(name, &[("prior", prior)], count);
    }
    let counters = [
        (
            "stgdat_silent_forecasts_total",
            "Forecasts left out by the policy of degradation.",
            forecasts.silent,
        ),
        (
            "stgdat_out_of_distribution_forecasts_total",
            "Forecasts of agents that move as none did in training.",
            report.out_of_distribution.forecasts,
        ),
        ("stgdat_agents_left_out_total", "Agents left out of full frames.", report.agents_left_out),
    ];
    for (name, help, count) in counters {
        text.single(Kind::Counter, name, help, count);
    }
    let agents: u64 = status.newest.qualities.values().sum();
    text.single(Kind::Gauge, "stgdat_agents", "Agents forecast in the newest tick.", agents);
    let Some(accuracy) = &status.accuracy else { return };
    let name = "stgdat_region_coverage_ratio";
    text.metric(Kind::Gauge, name, "Share of the regions of that level that held the truth so far.");
    for (level, held) in [("0.5", accuracy.held_50), ("0.9", accuracy.held_90)] {
        if let Some(held) = held {
            text.sample(name, &[("level", level)], held);
        }
    }
    for (name, help, value) in [
        ("stgdat_min_ade_meters", "minADE of the forecasts so far.", accuracy.ade_m),
        ("stgdat_min_fde_meters", "minFDE of the forecasts so far.", accuracy.fde_m),
    ] {
        if let Some(value) = value {
            text.single(Kind::Gauge, name, help, value);
        }
    }
}

fn input(text: &mut Text, status: &RunStatus) {
    let state = u8::from(status.input.is_silent);
    text.single(Kind::Gauge, "stgdat_input_silent", "1 while no input arrives.", state);
    for (name, help, value) in [
        ("stgdat_input_age_seconds", "Age of the last input.", status.input.age_s),
        ("stgdat_input_rate_hertz", "Rate of the input.", status.input.rate_hz),
    ] {
        if let Some(value) = value {
            text.single(Kind::Gauge, name, help, value);
        }
    }
    let Report { silences, sessions, .. } = &status.report;
    let help = "Times without input from a live source.";
    text.single(Kind::Counter, "stgdat_silences_total", help, silences.count);
    let help = "Sessions: parts of the run in which the stamps have one clock.";
    text.single(Kind::Counter, "stgdat_sessions_total", help, sessions.count);
    let input = &status.report.input;
    let name = "stgdat_input_detections_total";
    text.metric(Kind::Counter, name, "Detections by what became of them; `detections` counts all.");
    for (kind, count) in input.counts() {
        text.sample(name, &[("kind", kind)], count);
    }
    let (name, help) =
        ("stgdat_input_poses_missing", "Frames of the recording without a pose of the sensor.");
    text.single(Kind::Gauge, name, help, input.poses_missing);
    let name = "stgdat_input_finding_share";
    text.metric(Kind::Gauge, name, "Share of the rows that a finding of the audit concerns.");
    for (found, share) in input.findings.iter().filter_map(|found| Some((found, found.share?))) {
        text.sample(name, &[("kind", &found.kind)], share);
    }
    let name = "stgdat_input_doubt";
    text.metric(Kind::Gauge, name, "1 for each doubt about the input.");
    for found in input.doubts() {
        text.sample(name, &[("kind", &found.kind)], 1);
    }
    type Deviation = fn(&TypeNoise) -> Option<f64>;
    for (name, help, deviation) in [
        (
            "stgdat_detector_noise_meters",
            "Noise of the detections' positions, per axis.",
            (|noise| Some(noise.position_m)) as Deviation,
        ),
        ("stgdat_detector_noise_heading_degrees", "Noise of the detections' headings.", |noise| {
            noise.heading_deg
        }),
        ("stgdat_detector_noise_speed_meters_per_second", "Noise of the detections' speeds.", |noise| {
            noise.speed_mps
        }),
    ] {
        text.metric(Kind::Gauge, name, help);
        for (of_type, value) in input.noise.iter().filter_map(|noise| Some((noise, deviation(noise)?))) {
            text.sample(name, &[("type", &of_type.agent_type)], value);
        }
    }
}

fn losses(text: &mut Text, status: &RunStatus) {
    let report = &status.report;
    let name = "stgdat_dropped_frames_total";
    text.metric(Kind::Counter, name, "Frames lost, by the stage that lost them first and cause.");
    for stage in &report.stages {
        let causes =
            [("gap", stage.drops.gap), ("refused", stage.drops.refused), ("restart", stage.drops.restart)];
        for (cause, count) in causes {
            text.sample(name, &[("stage", &stage.name), ("cause", cause)], count);
        }
    }
    let name = "stgdat_refused_frames_total";
    text.metric(Kind::Counter, name, "Frames refused, by reader, sender and cause.");
    for refused in &report.refusals {
        let labels = [
            ("reader", refused.reader.as_str()),
            ("sender", refused.sender.as_str()),
            ("cause", refused.cause.as_str()),
        ];
        text.sample(name, &labels, refused.frames);
    }
    let name = "stgdat_link_total";
    text.metric(Kind::Counter, name, "Counts of links to other boxes, by stage and kind.");
    for (stage, counts) in &report.links {
        for (kind, count) in counts {
            text.sample(name, &[("stage", stage), ("kind", kind)], count);
        }
    }
    let help = "Processes beside the stages that read topics and have died.";
    let dead = report.supervision.dead_readers;
    text.single(Kind::Counter, "stgdat_dead_readers_total", help, dead);
    let name = "stgdat_lost_lines_total";
    text.metric(Kind::Counter, name, "Lines that are missing in the log, by stage and for the launcher.");
    for (origin, lines) in &report.supervision.lost_lines {
        text.sample(name, &[("stage", origin)], lines);
    }
}

fn stage_times(text: &mut Text, status: &RunStatus, measured: &Recorder) {
    let name = "stgdat_stage_seconds";
    text.metric(Kind::Histogram, name, "Time of a tick in each phase of each stage.");
    for stage in StageId::known() {
        let Some(times) = measured.phases(stage) else { continue };
        for (phase, times) in Phases::NAMES.into_iter().zip(times) {
            text.histogram(name, &[("stage", stage.name()), ("phase", phase)], times);
        }
    }
    let name = "stgdat_recent_stage_seconds";
    text.metric(Kind::Gauge, name, "Quantiles of each phase over the last ten seconds.");
    for stage in &status.stages {
        let StageStatus {
            recent_waiting_ms, recent_wake_up_ms, recent_compute_ms, recent_publish_ms, ..
        } = stage;
        let all = [recent_waiting_ms, recent_wake_up_ms, recent_compute_ms, recent_publish_ms];
        for (phase, times) in Phases::NAMES.into_iter().zip(all) {
            text.quantiles(name, &[("stage", &stage.name), ("phase", phase)], times);
        }
    }
    let name = "stgdat_stage_budget_seconds";
    text.metric(Kind::Gauge, name, "The stage's share of the tick.");
    for (stage, budget_ms) in status.stages.iter().filter_map(|stage| Some((stage, stage.budget_ms?))) {
        text.sample(name, &[("stage", &stage.name)], budget_ms / 1e3);
    }
    let name = "stgdat_stage_over_budget_total";
    text.metric(Kind::Counter, name, "Ticks whose compute exceeded the stage's budget.");
    for stage in &status.report.stages {
        text.sample(name, &[("stage", &stage.name)], stage.late_ticks);
    }
}

fn processes(text: &mut Text, status: &RunStatus) {
    let mut metric = |kind, name: &str, help: &str, value: fn(&StageStatus) -> Option<f64>| {
        text.metric(kind, name, help);
        for (stage, value) in status.stages.iter().filter_map(|stage| Some((stage, value(stage)?))) {
            text.sample(name, &[("stage", &stage.name)], value);
        }
    };
    metric(Kind::Gauge, "stgdat_stage_up", "1 where the stage's last heartbeat is recent.", |stage| {
        Some(f64::from(u8::from(stage.alive?)))
    });
    metric(Kind::Counter, "stgdat_restarts_total", "Restarts of the stage.", |stage| {
        Some(stage.process.restarts.into())
    });
    metric(
        Kind::Gauge,
        "stgdat_stage_behind_ticks",
        "Ticks that the stage lags behind the forecasts.",
        |stage| Some(stage.behind_ticks? as f64),
    );
    let cpu = "CPU time of the stage's process since it was started.";
    metric(Kind::Counter, "stgdat_stage_cpu_seconds_total", cpu, |stage| stage.process.cpu_s);
    let own = "Memory of the stage's own that lies in RAM.";
    metric(Kind::Gauge, "stgdat_stage_memory_bytes", own, |stage| Some(stage.process.memory_bytes? as f64));
    let shared = "Memory that the stage shares with others, and files that it has mapped.";
    metric(Kind::Gauge, "stgdat_stage_shared_bytes", shared, |stage| {
        Some(stage.process.shared_bytes? as f64)
    });
}

#[cfg(test)]
mod tests;
