//! The bridge at both ends of a pipeline: detections in over one link, forecasts out over another, on loopback.
//!
//! The test needs the program `stgdat` beside `stgdat-bridge`, and prints why it is skipped.
#![expect(clippy::unwrap_used, reason = "a test ends at what it can't do")]

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpListener;
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use bridge::auth::Key;
use bridge::frame::detections;
use bridge::frame::{Kind, TickHead};
use bridge::sender::Sender;
use ports::monotonic_ns;
use serde_json::Value;
use wire::Detection;

const PIPELINE: &str = include_str!("../../../launch/pipeline.toml");
const READER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/examples/bridge_reader.py");

/// A process that is killed at the end of the test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn start(program: &Path, arguments: &[&str]) -> Running {
    spawn(Command::new(program).args(arguments))
}

fn spawn(command: &mut Command) -> Running {
    let child = command.stdout(Stdio::piped()).spawn();
    Running(child.unwrap_or_else(|error| panic!("{command:?}: {error}")))
}

fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

fn write_key(path: &Path, key: &[u8]) {
    let mut file = std::fs::OpenOptions::new().write(true).create_new(true).mode(0o600).open(path).unwrap();
    file.write_all(key).unwrap();
}

struct Scene {
    folder: tempfile::TempDir,
    bridge: PathBuf,
    key: String,
    detections: String,
    forecasts: String,
}

impl Scene {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let key = folder.path().join("key");
        write_key(&key, b"0123456789abcdef0123456789abcdef\n");
        Self {
            bridge: env!("CARGO_BIN_EXE_stgdat-bridge").into(),
            key: key.to_str().unwrap().to_owned(),
            detections: folder.path().join("detections").to_str().unwrap().to_owned(),
            forecasts: format!("127.0.0.1:{}", free_port()),
            folder,
        }
    }

    /// `source` has further options of the source.
    fn pipeline(&self, source: &str) -> String {
        let Self { key, detections, forecasts, .. } = self;
        let (bridge, more) = (self.bridge.display(), source);
        let source = format!(
            "name = \"source\"\ncommand = [\"{bridge}\"]\n\
             options = {{ connect = \"{detections}\", key = \"{key}\", max_age_ms = 60000, timeout_ms = 5000{more} }}\n"
        );
        let output = format!(
            "\n[[stage]]\nname = \"to-planner\"\ncommand = [\"{bridge}\"]\nreads = [\"forecasts\"]\n\
             options = {{ listen = \"{forecasts}\", key = \"{key}\", modes = 5, timeout_ms = 5000 }}\n"
        );
        let path = self.folder.path().join("pipeline.toml");
        std::fs::write(&path, PIPELINE.replace("name = \"source\"\n", &source) + &output).unwrap();
        path.to_str().unwrap().to_owned()
    }

    /// The folder of the run, whose parent is the scene's. The hidden folder holds second names of its files.
    fn run(&self) -> PathBuf {
        let entries = std::fs::read_dir(self.folder.path()).unwrap().map(|entry| entry.unwrap());
        let mut runs = entries.filter(|entry| entry.file_name().to_string_lossy().starts_with("stgdat_"));
        runs.find(|entry| entry.path().join("run").is_file()).unwrap().path()
    }

    /// The counts of the links, as soon as they reach `expected`: stage, kind and least count.
    fn links(&self, program: &Path, expected: &[(&str, &str, u64)]) -> Value {
        loop {
            let mut command = Command::new(program);
            let output = command.args(["top", "--once", "--json", "--run"]).arg(self.run()).output().unwrap();
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
            let status: Value = serde_json::from_slice(&output.stdout).unwrap();
            let links = &status["report"]["links"];
            if expected.iter().all(|(stage, kind, least)| links[stage][kind].as_u64() >= Some(*least)) {
                return links.clone();
            }
        }
    }

    /// A detector on another box.
    fn detector(&self) -> Running {
        let arguments = ["play", &self.detections, "--agents", "8", "--ticks", "5000", "--key", &self.key];
        start(&self.bridge, &arguments)
    }
}

/// The next line with an agent that `is_expected`.
fn awaited(lines: &mut impl Iterator<Item = String>, is_expected: impl Fn(&Value) -> bool) -> Value {
    for line in lines {
        let frame: Value = serde_json::from_str(&line).unwrap();
        if frame["agents"].as_array().is_some_and(|agents| agents.iter().any(&is_expected)) {
            return frame;
        }
    }
    panic!("the receiver has ended");
}

#[test]
fn detections_come_in_and_forecasts_go_out_and_a_lost_link_comes_back() {
    let scene = Scene::new();
    let stgdat = scene.bridge.with_file_name("stgdat");
    if !stgdat.is_file() {
        println!("skipped: no {}: build it with the same profile", stgdat.display());
        return;
    }
    let detector = scene.detector();
    let folder = scene.folder.path();
    let mut command = Command::new(&stgdat);
    let run = spawn(command.args(["run", "--pipeline", &scene.pipeline(""), "--runtime-dir"]).arg(folder));
    let arguments =
        ["receive", &scene.forecasts, "--key", &scene.key, "--max-age", "60000", "--timeout", "5000"];
    let mut receiver = start(&scene.bridge, &arguments);
    let mut lines = BufReader::new(receiver.0.stdout.take().unwrap()).lines().map_while(Result::ok);

    let is_learned = |agent: &Value| agent["quality"] == "learned";
    let frame = awaited(&mut lines, is_learned);
    let agent = frame["agents"].as_array().unwrap().iter().find(|agent| is_learned(agent)).unwrap();
    assert_eq!(agent["best_m"].as_array().map(Vec::len), Some(12), "{agent}");
    assert!(agent["modes"].as_array().is_some_and(|modes| (1..=5).contains(&modes.len())), "{agent}");

    // Another reader, in another language.
    let (host, port) = scene.forecasts.split_once(':').unwrap();
    match Command::new("python3").args([READER, host, port, &scene.key, "3"]).output() {
        Ok(read) => {
            let text = String::from_utf8_lossy(&read.stdout);
            assert!(read.status.success(), "{text}{}", String::from_utf8_lossy(&read.stderr));
            assert!(text.contains("agent ") && text.contains("modes"), "{text}");
        }
        Err(error) => println!("skipped: python3: {error}"),
    }

    // The other box dies, and the road does not look empty: forecasts continue from predicted ticks.
    drop(detector);
    let last = |frame: Value| frame["seq"].as_u64().unwrap();
    let seq = last(awaited(&mut lines, |_| true));
    let predicted = last(lines.by_ref().map(|line| serde_json::from_str(&line).unwrap()).nth(12).unwrap());
    assert!(predicted >= seq + 12, "{predicted} after {seq}");
    let detector = scene.detector();
    awaited(&mut lines, is_learned);

    // The counts of both links reach the user. They include the connection with another key.
    let stranger = scene.folder.path().join("stranger");
    write_key(&stranger, b"fedcba9876543210fedcba9876543210\n");
    let stranger = start(&scene.bridge, &["receive", &scene.forecasts, "--key", stranger.to_str().unwrap()]);
    let expected = [
        ("source", "connections", 2),
        ("source", "frames", 1),
        ("source", "lost", 1),
        ("to-planner", "connections", 1),
        ("to-planner", "frames", 1),
        ("to-planner", "another key", 1),
    ];
    let links = scene.links(&stgdat, &expected);
    assert_eq!(links["source"]["another key"], Value::Null, "{links}");
    drop((stranger, receiver, detector, run));
}

#[test]
fn a_clock_of_the_other_box_that_is_set_begins_a_session() {
    let scene = Scene::new();
    let stgdat = scene.bridge.with_file_name("stgdat");
    if !stgdat.is_file() {
        println!("skipped: no {}: build it with the same profile", stgdat.display());
        return;
    }
    let key = Key::read(Path::new(&scene.key)).unwrap();
    let address = scene.detections.parse().unwrap();
    let mut sender = Sender::listen(&address, Kind::Detections, key, Duration::from_secs(5)).unwrap();
    let folder = scene.folder.path();
    let report = folder.join("report.json");
    let mut command = Command::new(&stgdat);
    command.args(["run", "--quiet", "--pipeline", &scene.pipeline(", ticks = 160"), "--runtime-dir"]);
    command.arg(folder).arg("--report").arg(&report).stderr(Stdio::piped());
    let mut run = spawn(&mut command);
    while sender.receivers() == 0 {
        std::thread::sleep(Duration::from_millis(10));
    }
    // Three cars at 10 Hz. The clock is set every 3 s.
    let begun = Instant::now();
    let mut frame = 0_u32;
    while run.0.try_wait().unwrap().is_none() {
        let set_s: f64 = [-0.5, -10.0, -40.0, 60.0].iter().take(frame as usize / 30).sum();
        let stamp_ns = ((1_000.0 + set_s + f64::from(frame) * 0.1) * 1e9) as i64;
        let head = TickHead { stamp_ns, interval_ns: 100_000_000, observed_types: 7, ..TickHead::default() };
        let car = |lane: u8| Detection {
            x_m: f32::from(6 + lane) * 0.1 * frame as f32,
            y_m: 6.0 * f32::from(lane),
            score: 1.0,
            ..Detection::default()
        };
        sender.send(monotonic_ns(), |body| detections::write(body, &head, &[0, 1, 2].map(car)));
        frame += 1;
        std::thread::sleep((Duration::from_millis(100) * frame).saturating_sub(begun.elapsed()));
    }
    let mut log = String::new();
    run.0.stderr.take().unwrap().read_to_string(&mut log).unwrap();
    let report: Value = serde_json::from_slice(&std::fs::read(report).unwrap()).unwrap();
    assert_eq!(report["sessions"]["count"], 5, "{report}\n{log}");
    assert_eq!(log.matches("a new session begins").count(), 4, "{log}");
    assert_eq!(report["agents"]["max"], 3, "{report}");
}
