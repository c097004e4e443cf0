//! Files of a test, removed at its end.

use std::fmt::Write as _;
use std::path::PathBuf;

use data::{Frame, GeneratedScene, SceneOptions};
use wire::{Detection, detection_flags};

/// The built-in pipeline.
pub const SHIPPED_PIPELINE: &str = include_str!("../../../launch/pipeline.toml");

/// The directory of one test, removed when dropped.
#[derive(Debug)]
pub struct Scratch(PathBuf);

impl Scratch {
    /// Creates the directory. Each test of a process needs its own name.
    pub fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("stgdat-test-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).expect("the temporary directory can be written to");
        Self(path)
    }

    /// A path in the directory.
    pub fn path(&self, name: &str) -> String {
        self.0.join(name).display().to_string()
    }

    /// Writes a file in the directory and returns its path.
    pub fn file(&self, name: &str, content: impl AsRef<[u8]>) -> String {
        std::fs::write(self.0.join(name), content).expect("the temporary directory can be written to");
        self.path(name)
    }

    /// Reads a file of the directory.
    pub fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.0.join(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    /// Writes the shipped pipeline with one text replaced.
    pub fn pipeline(&self, name: &str, from: &str, to: &str) -> String {
        assert!(SHIPPED_PIPELINE.contains(from), "the shipped pipeline.toml has no {from:?}");
        self.file(name, SHIPPED_PIPELINE.replacen(from, to, 1))
    }

    /// Writes the shipped pipeline with a further line: a program replaces a stage.
    pub fn pipeline_with(&self, stage: &str, command: &[&str]) -> String {
        let name = format!("name = \"{stage}\"\n");
        self.pipeline(&format!("{stage}.toml"), &name, &format!("{name}command = {command:?}\n"))
    }

    /// Writes a recording in the project's own format: detections with identities of a generated
    /// intersection.
    pub fn recording(&self, name: &str, ticks: usize) -> String {
        let options =
            SceneOptions { agents: 14, identities: true, clutter_mean: 0.0, ..SceneOptions::default() };
        let scene = GeneratedScene::new(options).expect("the options are in their ranges").recording(ticks);
        let mut csv = "stamp_s,id,type,x_m,y_m,heading_rad,length_m,width_m,score\n".to_owned();
        for frame in &scene.frames {
            for detection in &frame.detections {
                write_row(&mut csv, frame, detection);
            }
        }
        self.file(name, csv)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Writes a detection. Columns of unknown values stay empty.
fn write_row(csv: &mut String, frame: &Frame, detection: &Detection) {
    let given = |flag: u32, value: f32| if detection.has(flag) { value.to_string() } else { String::new() };
    let stamp_ms = frame.stamp_ns / 1_000_000;
    let agent_type = wire::AGENT_TYPES[detection.agent_type as usize].name();
    let Detection { id, x_m, y_m, score, .. } = detection;
    writeln!(
        csv,
        "{}.{:03},{id},{agent_type},{x_m},{y_m},{},{},{},{score}",
        stamp_ms / 1_000,
        stamp_ms % 1_000,
        given(detection_flags::HAS_HEADING, detection.heading_rad),
        given(detection_flags::HAS_SIZE, detection.length_m),
        given(detection_flags::HAS_SIZE, detection.width_m),
    )
    .expect("a string takes all");
}
