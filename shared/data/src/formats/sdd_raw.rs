//! Stanford Drone's own annotations: `id xmin ymin xmax ymax frame lost occluded generated "label"`, pixels,
//! 30 Hz.
//!
//! The position of an agent is the centre of its box. Pixels are converted to metres by the scale of the
//! video in `estimated_scales.yaml`, two folders up. y is negated, because the image's y points down and the
//! world is right-handed. Rows with `lost = 1` are outside the image; they are left out and counted.
//! Pedestrians and skaters are pedestrians, bikers are cyclists, and carts, cars and buses are vehicles.

use std::path::Path;

use wire::{AgentType, Detection};

use crate::input::need;
use crate::rows::{self, ALL_TYPES, PEDESTRIAN_IDS, Rows};
use crate::text::{self, Field, Line, Separator};
use crate::{FrameRate, Input, LeftOut, ReadError, Recording, Role, sweeps};

const NAMES: [&str; 10] =
    ["id", "xmin", "ymin", "xmax", "ymax", "frame", "lost", "occluded", "generated", "label"];
const TABLE_NAMES: [&str; 13] = [
    "File",
    "Dataset",
    "Nr",
    "Version",
    "Feet",
    "Inch",
    "Meters",
    "Pixel X",
    "Pixel Y",
    "Pixel Dist",
    "Average",
    "Diff",
    "Ratio",
];
/// The frame rate of the videos.
pub(crate) const RATE: FrameRate = FrameRate::of_centihertz(3_000);
/// Largest valid pixel coordinate. At the largest scale it is still within the world.
const PIXEL_MAX: f64 = wire::POSITION_MAX_M as f64;
/// Valid scales, m per px.
const PIXEL_M: std::ops::RangeInclusive<f64> = 1e-4..=1.0;

/// Reads the annotations of a video.
pub(crate) fn parse(inputs: &[Input], rate: FrameRate) -> Result<Recording, ReadError> {
    let input = need(inputs, Role::Rows)?;
    let pixel_m = video_pixel_m(need(inputs, Role::Scales)?, &input.path)?;
    let mut rows = Rows::default();
    let mut lost_count = 0;
    for line in text::lines(input) {
        let line = line?;
        let fields = line.split(Separator::Space, &NAMES)?;
        match row(fields, pixel_m, rate)? {
            Some((stamp_ns, detection)) => rows.push(&line, stamp_ns, detection)?,
            None => lost_count += 1,
        }
    }
    let lost = LeftOut { reason: "lost = 1".to_owned(), row_count: lost_count };
    let left_out = Vec::from_iter((lost_count > 0).then_some(lost));
    let recording = sweeps::identified(rows, input, ALL_TYPES, rate, 1)?;
    Ok(Recording { left_out, pixel_m: Some(pixel_m), ..recording })
}

fn row(
    fields: [Field<'_>; 10],
    pixel_m: f64,
    rate: FrameRate,
) -> Result<Option<(i64, Detection)>, ReadError> {
    let [id, xmin, ymin, xmax, ymax, frame, lost, occluded, generated, label] = fields;
    let middle = |low: Field<'_>, high: Field<'_>| {
        let [from, to] = [low.number_in(-PIXEL_MAX..=PIXEL_MAX)?, high.number_in(-PIXEL_MAX..=PIXEL_MAX)?];
        if from > to { Err(high.error("less than the box's other side")) } else { Ok((from + to) / 2.0) }
    };
    let position_m = [middle(xmin, xmax)? * pixel_m, -middle(ymin, ymax)? * pixel_m].map(|x| x as f32);
    let agent_type = match label.text {
        "\"Pedestrian\"" | "\"Skater\"" => AgentType::Pedestrian,
        "\"Biker\"" => AgentType::Cyclist,
        "\"Cart\"" | "\"Car\"" | "\"Bus\"" => AgentType::Vehicle,
        _ => {
            return Err(
                label.error("expected \"Pedestrian\", \"Biker\", \"Skater\", \"Cart\", \"Car\" or \"Bus\"")
            );
        }
    };
    let stamp_ns = frame.stamp_ns(rate)?;
    let id = id.id_below(PEDESTRIAN_IDS)?;
    for bit in [occluded, generated] {
        flag(bit)?;
    }
    Ok(if flag(lost)? { None } else { Some((stamp_ns, rows::identified(agent_type, position_m, id))) })
}

fn flag(field: Field<'_>) -> Result<bool, ReadError> {
    match field.text {
        "0" => Ok(false),
        "1" => Ok(true),
        _ => Err(field.error("expected 0 or 1")),
    }
}

/// The scale (m per px) of the video with annotations at `path`, from `estimated_scales.yaml`. The file has
/// two levels of names (scene, video) that end with a colon, then `scale: NUMBER` and `certainty: NUMBER`.
fn video_pixel_m(scales: &Input, path: &str) -> Result<f64, ReadError> {
    let folder = |depth: usize| Path::new(path).ancestors().nth(depth)?.file_name()?.to_str();
    let video = folder(2).zip(folder(1));
    let (mut scene, mut name, mut pixel_m) = ("", "", None);
    for line in text::lines(scales) {
        let line = line?;
        let key = line.text.trim();
        if let Some(key) = key.strip_suffix(':') {
            if line.text.starts_with(char::is_whitespace) {
                name = key;
            } else {
                (scene, name) = (key, "");
            }
            continue;
        }
        let value = scale_value(&line)?;
        if key.starts_with("scale") && video == Some((scene, name)) {
            pixel_m = Some(value);
        }
    }
    let missing =
        || ReadError::missing(path, "the scale of its scene and video", &format!(" in {}", scales.path));
    pixel_m.ok_or_else(missing)
}

/// The value of `scale: NUMBER` or `certainty: NUMBER`.
fn scale_value(line: &Line<'_>) -> Result<f64, ReadError> {
    let [key, value] = line.split(Separator::Space, &["key", "value"])?;
    match key.text {
        "scale:" => value.number_in(PIXEL_M),
        "certainty:" => value.number_in(0.0..=1.0),
        _ => Err(key.error("expected scale: or certainty:")),
    }
}

/// The scale (m per px) of a scene of the TrajNet split, from the table `H_SDD.txt`. It is the first of two
/// measurements, which was used to make the split. `None` if the table does not contain the scene.
pub(crate) fn table_pixel_m(table: &Input, scene: &str) -> Result<Option<f64>, ReadError> {
    for line in text::lines(table).skip(1) {
        let line = line?;
        let fields = line.split(Separator::Space, &TABLE_NAMES)?;
        let pixel_m = fields[12].number_in(PIXEL_M)?;
        if fields[0].text.strip_suffix(".jpg") == Some(scene) {
            return Ok(Some(pixel_m));
        }
    }
    Ok(None)
}
