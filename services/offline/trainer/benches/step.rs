//! Times a training step of whole configurations, on generated road users that move in circles.
//!
//! The times come from the run's log, which has one line every few updates. Other load on the machine only
//! adds time, so the shortest interval counts. `step_in_pytorch.py` in this folder times the same step in
//! PyTorch.

use std::error::Error;
use std::fmt::Write;
use std::path::Path;

use serde_json::Value;
use trainer::{TrainOptions, recipe, train};

/// Updates per run.
const STEPS: u64 = 120;
/// Frames of a recording, 0.4 s apart.
const FRAMES: u32 = 400;
/// Scale of the recordings in pixels, m per px.
const PIXEL_M: f64 = 0.04;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    write_crowd(folder.path())?;
    write_traffic(folder.path())?;
    let mut with_map = TrainOptions {
        sets: vec!["sdd-raw".to_owned()],
        validation_sets: vec!["sdd-raw".to_owned()],
        without_map: 0.0,
        site_map: 0.0,
        ..TrainOptions::default()
    };
    let mut without_map = with_map.clone();
    without_map.model.context = false;
    let mut pedestrians = recipe("zara1").ok_or("no recipe zara1")?;
    let cases = [
        ("onboard without map", &mut without_map),
        ("onboard with map", &mut with_map),
        ("pedestrians", &mut pedestrians),
    ];
    for (name, options) in cases {
        // Whole histories, so that every step is as large as in the script.
        (options.short_history, options.noisy_history) = (0.0, 0.0);
        (options.steps, options.validate_every, options.validation_agents) = (STEPS, u64::MAX, 8);
        options.data = folder.path().to_owned();
        options.out = folder.path().join("weights.safetensors");
        options.checkpoints = folder.path().join("checkpoints");
        let step_s = step_s(options)?;
        println!("{name}: {:.1} ms, {:.2} steps/s", step_s * 1e3, 1.0 / step_s);
    }
    Ok(())
}

fn step_s(options: &TrainOptions) -> Result<f64, Box<dyn Error>> {
    train(options)?;
    let log = std::fs::read_to_string(options.checkpoints.join("log.jsonl"))?;
    let lines = log.lines().map(serde_json::from_str).collect::<Result<Vec<Value>, _>>()?;
    let times: Vec<(f64, f64)> = lines
        .iter()
        .filter(|line| line.get("validation").is_none())
        .filter_map(|line| Some((line.get("step")?.as_f64()?, line.get("seconds")?.as_f64()?)))
        .collect();
    let stretches = times.windows(2).map(|pair| (pair[1].1 - pair[0].1) / (pair[1].0 - pair[0].0));
    stretches.reduce(f64::min).ok_or_else(|| "the log has too few times".into())
}

/// Position of a road user on its circle.
fn place_m(frame: u32, id: u32) -> [f64; 2] {
    let radius_m = 1.5 + 0.2 * f64::from(id);
    let angle_rad = f64::from(id) + 1.2 * 0.4 * f64::from(frame) / radius_m;
    [radius_m * angle_rad.cos(), radius_m * angle_rad.sin()]
}

fn write_to(folder: &Path, file: &str, rows: &str) -> std::io::Result<()> {
    std::fs::create_dir_all(folder)?;
    std::fs::write(folder.join(file), rows)
}

/// Sixteen pedestrians.
fn write_crowd(data: &Path) -> Result<(), Box<dyn Error>> {
    let mut rows = String::new();
    for (frame, id) in (0..FRAMES).flat_map(|frame| (0..16).map(move |id| (frame, id))) {
        let [x, y] = place_m(frame, id);
        writeln!(rows, "{}\t{id}\t{x:.4}\t{y:.4}", frame * 10)?;
    }
    for part in ["train", "val"] {
        write_to(&data.join("eth_ucy/zara1").join(part), "circles.txt", &rows)?;
    }
    Ok(())
}

/// Twelve road users, four of each type.
fn write_traffic(data: &Path) -> Result<(), Box<dyn Error>> {
    let mut rows = String::new();
    for (frame, id) in (0..FRAMES).flat_map(|frame| (0..12).map(move |id| (frame, id))) {
        let [x, y] = place_m(frame, id).map(|x_m| x_m / PIXEL_M);
        let label = ["Car", "Biker", "Pedestrian"][id as usize % 3];
        let corners = format!("{} {} {} {}", x - 5.0, y - 5.0, x + 5.0, y + 5.0);
        writeln!(rows, "{id} {corners} {} 0 0 0 \"{label}\"", frame * 12)?;
    }
    let videos = data.join("sdd/raw");
    let mut scales = String::new();
    for scene in ["quad", "nexus"] {
        write_to(&videos.join(scene).join("video0"), "annotations.txt", &rows)?;
        writeln!(scales, "{scene}:\n  video0:\n    scale: {PIXEL_M}\n    certainty: 1.0")?;
    }
    write_to(&videos, "estimated_scales.yaml", &scales)?;
    Ok(())
}
