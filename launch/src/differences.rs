//! The differences between two recordings, or between a recording and its replay, as text.

use std::fmt::Write as _;

use recording::{Comparison, Difference, Ending, ReadError, Recording, TopicComparison};
use wire::{ForecastsTopic, Topic as _};

/// Number of shown digits of a run id or weights hash; enough to distinguish them.
const DIGITS: usize = 12;

/// Describes a recording's run in one line. One more line follows for each missing, damaged or unread part.
pub fn title(recording: &Recording, damages: &[ReadError]) -> String {
    let about = recording.about();
    let pace = if about.run.lockstep { "lockstep" } else { "real time" };
    let weights: String = about.weights_sha256.chars().take(DIGITS).collect();
    let mut text = format!(
        "{}: {}, {pace}, weights {weights}, kernels {}\n",
        recording.path().display(),
        about.scene,
        about.kernels
    );
    if recording.has_topic(ForecastsTopic::NAME) && !recording.has_whole(ForecastsTopic::NAME) {
        text += "  forecasts without their controls\n";
    }
    match recording.ending() {
        Ending::Complete { lost_on_disk, .. } if lost_on_disk != "{}" => {
            // Writing to a string does not fail.
            let _ = writeln!(text, "  messages that the disk did not take: {lost_on_disk}");
        }
        Ending::Complete { .. } => {}
        Ending::Incomplete { at, why } => {
            let _ = writeln!(text, "  INCOMPLETE: byte {at}: {why}");
        }
    }
    if let [first, more @ ..] = damages {
        let _ = writeln!(text, "  DAMAGED: the ticks of damaged parts are missing; {first}");
        if !more.is_empty() {
            let _ = writeln!(text, "  {} more parts are damaged", more.len());
        }
    }
    if let topics @ [_, ..] = recording.foreign_topics() {
        let _ = writeln!(text, "  topics that are not stgdat's, left out: {}", topics.join(", "));
    }
    text
}

/// Formats the comparison as one sentence on the first difference and a table with one row per topic.
pub fn table(comparison: &Comparison, names: [&str; 2]) -> String {
    let mut text = String::new();
    if let Some(Difference { tick, topic, field, a, b }) = comparison.first() {
        let apart = (a - b).abs();
        let _ = writeln!(
            text,
            "first difference: tick {tick}, {topic}{}{field}: {a} {}, {b} {}: {apart:.3e} apart",
            if field.starts_with('[') { "" } else { " " },
            names[0],
            names[1]
        );
    }
    let head = ["topic", "ticks", "differ", "alone", "first", "apart there", "median", "greatest", "at"];
    let mut rows = vec![head.map(str::to_owned).to_vec()];
    rows.extend(comparison.topics.iter().map(|(name, topic)| row(name, topic)));
    text + &columns(&rows, &[0, 8])
}

/// Formats rows of equal length as lines. Columns in `texts` are left-aligned, numbers right-aligned.
pub fn columns(rows: &[Vec<String>], texts: &[usize]) -> String {
    let len = rows.first().map_or(0, Vec::len);
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..len).map(width).collect();
    let mut text = String::new();
    for row in rows {
        let mut line = String::new();
        for (column, (cell, width)) in row.iter().zip(&widths).enumerate() {
            // Writing to a string does not fail.
            let _ = if texts.contains(&column) {
                write!(line, "  {cell:width$}")
            } else {
                write!(line, "  {cell:>width$}")
            };
        }
        text += line.trim_end();
        text.push('\n');
    }
    text
}

fn row(name: &str, topic: &TopicComparison) -> Vec<String> {
    let apart = |value: f64| format!("{value:.2e}");
    let mut growth: Vec<f64> = topic.growth.values().copied().collect();
    growth.sort_by(f64::total_cmp);
    let median = growth.get(growth.len() / 2).map_or_else(String::new, |median| apart(*median));
    let first = topic.first.as_ref();
    let farthest = topic.farthest.as_ref();
    let at = |difference: &Difference| format!("tick {} {}", difference.tick, difference.field);
    vec![
        name.to_owned(),
        topic.ticks.to_string(),
        topic.different.to_string(),
        (topic.only_a + topic.only_b).to_string(),
        first.map_or_else(String::new, |first| first.tick.to_string()),
        first.and_then(|first| topic.growth.get(&first.tick)).map_or_else(String::new, |there| apart(*there)),
        median,
        farthest.map_or_else(String::new, |farthest| apart(farthest.apart())),
        farthest.map_or_else(String::new, at),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use recording::Frame;
    use wire::{Detection, DetectionsTopic, Header, Track, TracksTopic};

    #[test]
    fn the_first_difference_and_its_growth_are_shown() {
        let detection = |x_m: f32, seq| {
            let element = Detection { x_m, ..bytemuck::Zeroable::zeroed() };
            let header = Header {
                counts: wire::Counts { agents_len: 1, ..Default::default() },
                ..Header::new(1, seq, 0)
            };
            Frame::of::<DetectionsTopic>(&header, &[element], 0)
        };
        let track = |vx_mps: f32, seq| {
            let element = Track { vx_mps, ..bytemuck::Zeroable::zeroed() };
            let header = Header {
                counts: wire::Counts { agents_len: 1, ..Default::default() },
                ..Header::new(1, seq, 0)
            };
            Frame::of::<TracksTopic>(&header, &[element], 0)
        };
        let mut comparison = Comparison::default();
        for seq in 0..10 {
            comparison.pair(&track(1.0, seq), &track(1.0 + seq as f32, seq));
            comparison.pair(&detection(1.0, seq), &detection(if seq == 1 { 1.5 } else { 1.0 }, seq));
        }
        comparison.alone("tracks", 12, true);
        let text = table(&comparison, ["in a", "in b"]);
        let lines: Vec<String> =
            text.lines().map(|line| line.split_whitespace().collect::<Vec<_>>().join(" ")).collect();
        assert_eq!(lines[0], "first difference: tick 1, detections[0].x_m: 1 in a, 1.5 in b: 5.000e-1 apart");
        assert_eq!(lines[2], "detections 10 1 0 1 5.00e-1 5.00e-1 5.00e-1 tick 1 [0].x_m");
        assert_eq!(lines[3], "tracks 10 9 1 1 1.00e0 5.00e0 9.00e0 tick 9 [0].vx_mps");
    }
}
