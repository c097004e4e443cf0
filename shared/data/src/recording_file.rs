//! Writes frames of a recording in the project's own format, whatever format they were read from.

use std::io::{self, Write};

use wire::{Detection, detection_flags};

use crate::Frame;
use crate::formats::csv;
use crate::track_file::Seconds;

/// Columns of [`csv::NAMES`] that a detection has, without its sensor.
const COLUMNS: usize = 11;

/// Writes frames as CSV. The file holds the positions of the world frame. True positions and observed types
/// have no columns. The column of the sensors is written if any is known.
///
/// # Errors
/// Those of the output; [`io::ErrorKind::InvalidInput`] for an unknown agent type.
pub fn write_frames(output: &mut impl Write, frames: &[Frame]) -> io::Result<()> {
    let has_sensors = frames.iter().flat_map(|frame| &frame.detections).any(|detection| detection.sensor > 0);
    writeln!(output, "{}", csv::NAMES[..COLUMNS + usize::from(has_sensors)].join(","))?;
    let end = if has_sensors { "," } else { "" };
    for frame in frames {
        let (kind, [x, y]) = (if frame.ego.is_sensor { csv::EGO } else { csv::ABOVE }, frame.ego.position_m);
        let heading = frame.ego.heading_rad;
        writeln!(output, "{},,{kind},{x},{y},{heading},,,,,{end}", Seconds(frame.stamp_ns))?;
        for place in 0..frame.detections.len() {
            let Some(detection) = frame.written(place) else { continue };
            write_row(output, frame.stamp_ns, &detection)?;
            if has_sensors { writeln!(output, ",{}", detection.sensor) } else { writeln!(output) }?;
        }
    }
    output.flush()
}

fn write_row(output: &mut impl Write, stamp_ns: i64, detection: &Detection) -> io::Result<()> {
    let kind = detection.agent_type().map_err(|why| io::Error::new(io::ErrorKind::InvalidInput, why))?.name();
    let given =
        |flag: u32, value: &dyn ToString| if detection.has(flag) { value.to_string() } else { String::new() };
    let Detection { x_m, y_m, length_m, width_m, score, sigma_m, .. } = detection;
    write!(
        output,
        "{},{},{kind},{x_m},{y_m},{},{},{},{},{score},{sigma_m}",
        Seconds(stamp_ns + detection.offset_ns),
        given(detection_flags::HAS_ID, &detection.id),
        given(detection_flags::HAS_HEADING, &detection.heading_rad),
        given(detection_flags::HAS_SPEED, &detection.speed_mps),
        given(detection_flags::HAS_SIZE, length_m),
        given(detection_flags::HAS_SIZE, width_m),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Format, GeneratedScene, Input, Role, SceneOptions, parse};

    #[test]
    fn written_frames_are_read_back_as_they_were() {
        let scene = GeneratedScene::new(SceneOptions { agents: 12, ..SceneOptions::default() }).unwrap();
        let mut generated = scene.recording(40);
        generated.frames[3].detections[0].sensor = 2;
        let read = |frames: &[Frame]| {
            let mut bytes = Vec::new();
            write_frames(&mut bytes, frames).unwrap();
            parse(Format::Csv, &[Input::new(Role::Rows, "a.csv", bytes)]).unwrap()
        };
        let first = read(&generated.frames);
        assert!(first.frames.iter().map(|frame| frame.detections.len()).sum::<usize>() > 300);
        // The generated scene has no scores and no truth in a file, so the comparison is between two reads.
        let again = read(&first.frames);
        assert_eq!(again.frames, first.frames);
        assert_eq!((again.interval_ns, again.has_identities), (first.interval_ns, first.has_identities));
        let detections = |frames: &[Frame]| {
            let all = frames.iter().flat_map(|frame| {
                frame
                    .detections
                    .iter()
                    .map(|of| (frame.stamp_ns + of.offset_ns, of.id, of.x_m, of.y_m, of.sensor))
            });
            all.collect::<Vec<_>>()
        };
        let mut of_generated = detections(&generated.frames);
        let mut of_first = detections(&first.frames);
        of_generated.sort_by(|a, b| a.partial_cmp(b).unwrap());
        of_first.sort_by(|a, b| a.partial_cmp(b).unwrap());
        assert_eq!(of_first, of_generated);
    }
}
