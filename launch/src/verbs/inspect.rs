use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use clap::Args;
use console::failure::Failure;
use console::say;
use console::show::show;
use data::{BagTopic, Gap, Inspection, Recording, TypeInspection};
use drawing::{Overview, overview};
use lanes::LaneMap;
use run::Exit;
use wire::detection_flags;

use crate::arguments::{ModelArguments, ReadArguments};
use crate::files::quoted;
use crate::tracking::add_noise;

/// Width of the picture, pt.
const WIDTH: f64 = 516.0;
/// Maximum pause in an agent's path that is drawn as one line.
const PAUSE_MAX_NS: i64 = 3_000_000_000;

/// Arguments of `stgdat inspect`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Recording to examine
    recording: PathBuf,
    #[command(flatten)]
    read: ReadArguments,
    #[command(flatten)]
    model: ModelArguments,
    /// Draw the paths of all agents, the sensor and the lanes of --lanes in this SVG file
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Print the audit as JSON
    #[arg(long)]
    json: bool,
    /// Exit with 65 if the input is doubtful
    #[arg(long)]
    strict: bool,
}

/// Prints a recording's contents and its probable defects.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let recording = data::open_with(&arguments.recording, arguments.read.options()).map_err(Failure::data)?;
    let mut inspection = data::inspect(&recording);
    let lanes = arguments.model.open_lanes(arguments.read.options().origin)?;
    if let Some(out) = &arguments.out {
        if !out.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("svg")) {
            return Err(Failure::file(out, "the picture is written as SVG: name a file that ends in .svg"));
        }
        let drawing = drawing(&recording, &inspection, lanes.as_ref());
        let picture = overview(&drawing, WIDTH).map_err(Failure::data)?;
        std::fs::write(out, picture).map_err(|error| Failure::output(out, error))?;
    }
    add_noise(&mut inspection, recording);
    if arguments.json {
        say!("{}", serde_json::to_string_pretty(&inspection).map_err(Failure::data)?);
    } else {
        show(&text(&inspection, arguments.out.as_deref()))?;
        say!("\n{}", next(arguments, &inspection));
    }
    let is_doubtful = inspection.findings.iter().any(|found| found.doubtful);
    Ok(if arguments.strict && is_doubtful { Exit::Data } else { Exit::Done })
}

/// Formats the audit for people.
fn text(inspection: &Inspection, out: Option<&Path>) -> String {
    let Inspection { recording, frames, rows, span_s, interval_ms, identities, .. } = inspection;
    let mut text = String::new();
    let mut line = |label: &str, words: String| {
        // Writing to a string does not fail.
        let _ = writeln!(text, "{label:<12} {words}");
    };
    line("recording", recording.clone());
    line("frames", format!("{frames} in {span_s:.1} s, {:.1} Hz", 1e3 / interval_ms));
    if let Some([low, high]) = inspection.intervals_ms {
        line("intervals", format!("{interval_ms:.1} ms; 5th to 95th percentile {low:.1} to {high:.1} ms"));
    }
    if let Some(Gap { at_s, length_s }) = inspection.longest_gap {
        line("gaps", format!("{}, the longest of {length_s:.2} s after {at_s:.2} s", inspection.gaps));
    }
    for (place, topic) in inspection.topics.iter().enumerate() {
        let BagTopic { name, schema, messages, is_read } = topic;
        let read = if *is_read { ", read" } else { "" };
        let label = if place == 0 { "topics" } else { "" };
        line(label, format!("{name}: {messages} messages, {schema}{read}"));
    }
    let with = if *identities { "all with identities" } else { "not all with identities" };
    line("detections", format!("{rows}, {with}"));
    for (kind, row_count) in &inspection.left_out {
        line("", recorder::text::rows(kind, *row_count as u64));
    }
    inspection.types.iter().for_each(|of_type| line(&of_type.agent_type, type_words(of_type)));
    if let Some(share) = inspection.agreeing_headings {
        line("headings", format!("{:.1} % agree with the motion", share * 100.0));
    }
    if let Some(words) = audit::noise_words(&inspection.noise) {
        line("noise", words);
    }
    let Inspection { frames_with_ego, poses_missing, .. } = inspection;
    if frames_with_ego + poses_missing > 0 {
        let missing = match poses_missing {
            0 => String::new(),
            frames => format!("; {frames} frames have no pose that is near enough"),
        };
        line("sensor", format!("its pose is known in {frames_with_ego} frames{missing}"));
    }
    if let Some(out) = out {
        line("picture", out.display().to_string());
    }
    let (doubts, others): (Vec<_>, Vec<_>) = inspection.findings.iter().partition(|found| found.doubtful);
    doubts.iter().for_each(|found| line("DOUBT", found.to_string()));
    others.iter().for_each(|found| line("note", found.to_string()));
    if inspection.findings.is_empty() {
        line("no doubts", "nothing looks wrong".to_owned());
    }
    text
}

fn type_words(of_type: &TypeInspection) -> String {
    let TypeInspection { rows, agents, moving_mps, reported_ratio, length_m, .. } = of_type;
    // An agent has the type of its first detection.
    let mut words = match agents {
        0 => format!("{rows} detections of agents of another type before"),
        _ => format!("{agents} agents, {rows} detections"),
    };
    if let Some([median, high]) = moving_mps {
        words += &format!("; moving at {median:.1} m/s, 95th percentile {high:.1} m/s");
    }
    if let Some(ratio) = reported_ratio {
        words += &format!("; {ratio:.2} of the reported speeds");
    }
    if let Some(length_m) = length_m {
        words += &format!("; {length_m:.1} m long");
    }
    words
}

/// Returns the command to run next.
fn next(arguments: &Arguments, inspection: &Inspection) -> String {
    let mut command = format!("stgdat run --recording {}", quoted(&arguments.recording.to_string_lossy()));
    command += &arguments.read.written();
    command += &arguments.model.written();
    let jumps = |found: &audit::Found| found.doubtful && found.kind == audit::Doubt::IdentitiesJump.name();
    if inspection.identities && inspection.findings.iter().any(jumps) {
        command += " --associate";
    }
    let is_doubtful = inspection.findings.iter().any(|found| found.doubtful);
    let when = if is_doubtful { "next, once the doubts are settled:" } else { "next:" };
    format!("{when}\n  {command}")
}

/// Draws the paths of all agents and of the sensor.
fn drawing(recording: &Recording, inspection: &Inspection, lanes: Option<&LaneMap>) -> Overview {
    let mut drawing = Overview {
        title: recording.name.clone(),
        note: format!(
            "{} frames in {:.1} s, {} detections; a dot is the end of a way",
            inspection.frames, inspection.span_s, inspection.rows
        ),
        lines: lanes.into_iter().flat_map(LaneMap::lanes).flat_map(|lane| lane.bounds_m.clone()).collect(),
        ..Overview::default()
    };
    // The newest path of each agent, by index, and the time at which the agent was last seen.
    let mut newest: BTreeMap<u64, (usize, i64)> = BTreeMap::new();
    let mut ego_ns = None;
    for frame in &recording.frames {
        for detection in &frame.detections {
            let Ok(agent_type) = detection.agent_type() else { continue };
            let point = [detection.x_m, detection.y_m];
            let known =
                detection.has(detection_flags::HAS_ID).then(|| newest.get_mut(&detection.id)).flatten();
            match known.filter(|(_, seen_ns)| frame.stamp_ns - *seen_ns <= PAUSE_MAX_NS) {
                Some((place, seen_ns)) => {
                    drawing.ways[*place].1.push(point);
                    *seen_ns = frame.stamp_ns;
                }
                None => {
                    newest.insert(detection.id, (drawing.ways.len(), frame.stamp_ns));
                    drawing.ways.push((agent_type, vec![point]));
                }
            }
        }
        if frame.ego.is_sensor {
            let goes_on = ego_ns.is_some_and(|ego_ns| frame.stamp_ns - ego_ns <= PAUSE_MAX_NS);
            match drawing.ego.last_mut().filter(|_| goes_on) {
                Some(way) => way.push(frame.ego.position_m),
                None => drawing.ego.push(vec![frame.ego.position_m]),
            }
            ego_ns = Some(frame.stamp_ns);
        }
    }
    drawing
}
