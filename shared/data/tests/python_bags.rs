//! Bags that PyPI's `rosbags` writes, if it is installed.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::process::Command;

use data::{PredictedAgent, Recording, predicted_objects};
use interop::messages::{PredictedObjects, TrackedObjects};
use wire::{AgentType, Detection, WorldOrigin};

const SCRIPTS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/interop");
/// Type, position and speed along +x of the agents that the script writes, besides an animal.
const AGENTS: [(AgentType, [f32; 2], f32); 3] = [
    (AgentType::Vehicle, [10.0, 5.0], 8.0),
    (AgentType::Vehicle, [-20.0, -5.0], 4.0),
    (AgentType::Pedestrian, [3.0, 9.0], 1.25),
];

/// Runs a script; `false`, with a printed note, if a Python package is missing.
fn script(name: &str, arguments: &[&str]) -> bool {
    let python = std::env::var("STGDAT_PYTHON").unwrap_or_else(|_| "python3".into());
    let output = match Command::new(&python).arg(format!("{SCRIPTS}/{name}")).args(arguments).output() {
        Ok(output) => output,
        Err(error) => {
            testing::skip(format_args!("{python}: {error}"));
            return false;
        }
    };
    let said = String::from_utf8_lossy(&output.stdout);
    if output.status.code() == Some(77) {
        testing::skip(format_args!("{} (STGDAT_PYTHON names another interpreter)", said.trim_end()));
        return false;
    }
    assert!(output.status.success(), "{said}{}", String::from_utf8_lossy(&output.stderr));
    true
}

/// A bag with the definitions of Autoware's messages, which `rosbags` does not have.
fn schemas(folder: &Path) -> String {
    let mut bytes = Cursor::new(Vec::new());
    let mut writer = mcap::WriteOptions::new().compression(None).create(&mut bytes).expect("a bag");
    for definition in [&PredictedObjects::DEFINITION, &TrackedObjects::DEFINITION] {
        let schema =
            writer.add_schema(definition.name, "ros2msg", definition.schema().as_bytes()).expect("a bag");
        let channel_id = writer.add_channel(schema, definition.name, "cdr", &BTreeMap::new()).expect("a bag");
        let header = mcap::records::MessageHeader { channel_id, sequence: 0, log_time: 0, publish_time: 0 };
        writer.write_to_known_channel(&header, &[]).expect("a bag");
    }
    writer.finish().expect("a bag");
    drop(writer);
    let path = folder.join("schemas.mcap");
    std::fs::write(&path, bytes.into_inner()).expect("a bag");
    path.display().to_string()
}

/// A bag of a kind of objects as MCAP; `None` if a Python package is missing.
fn written(folder: &Path, kind: &str, storage: &str) -> Option<PathBuf> {
    let (schemas, bag) = (schemas(folder), folder.join("bag"));
    script("write_bag.py", &[&bag.display().to_string(), &schemas, kind, storage]).then_some(())?;
    if storage == "mcap" {
        let file = |entry: std::io::Result<std::fs::DirEntry>| Some(entry.ok()?.path());
        let mut files = std::fs::read_dir(&bag).expect("a bag").filter_map(file);
        return files.find(|path| path.extension().is_some_and(|ending| ending == "mcap"));
    }
    let converted = folder.join("converted.mcap");
    let arguments = [bag, converted.clone()].map(|path| path.display().to_string());
    script("bag_to_mcap.py", &arguments.each_ref().map(String::as_str)).then_some(converted)
}

/// The positions of a frame's agents are those that the script wrote, moved from base_link to the world.
fn assert_agents(found: &[(AgentType, [f32; 2])], after_s: f32) {
    assert_eq!(found.len(), AGENTS.len());
    // Each agent keeps its own y.
    let (mut found, mut agents) = (found.to_vec(), AGENTS);
    found.sort_by(|a, b| a.1[1].total_cmp(&b.1[1]));
    agents.sort_by(|a, b| a.1[1].total_cmp(&b.1[1]));
    for (found, (agent_type, [x_m, y_m], speed_mps)) in found.iter().zip(agents) {
        let [x, y] = found.1;
        assert_eq!(found.0, agent_type);
        assert!((x - x_m - speed_mps * after_s).abs() < 1e-3 && (y - y_m).abs() < 1e-3, "{x} {y} {after_s}");
    }
}

fn assert_recording(recording: &Recording, has_identities: bool) {
    assert_eq!((recording.frames.len(), recording.interval_ns), (60, 100_000_000));
    assert_eq!((recording.has_identities, recording.left_out[0].row_count), (has_identities, 60));
    for (number, frame) in recording.frames.iter().enumerate() {
        let of = |detection: &Detection| {
            (AgentType::try_from(detection.agent_type).expect("a type"), [detection.x_m, detection.y_m])
        };
        let found: Vec<_> = frame.detections.iter().map(of).collect();
        assert_agents(&found, number as f32 / 10.0);
    }
}

#[test]
fn objects_of_rosbags_are_read_from_both_storages() {
    for (kind, storage) in
        [("detected", "mcap"), ("tracked", "mcap"), ("detected", "sqlite3"), ("tracked", "sqlite3")]
    {
        let folder = tempfile::tempdir().unwrap();
        let Some(path) = written(folder.path(), kind, storage) else { return };
        let recording = data::open(&path, None).unwrap_or_else(|error| panic!("{kind} {storage}: {error}"));
        assert_recording(&recording, kind == "tracked");
    }
}

#[test]
fn forecasts_of_rosbags_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let Some(path) = written(folder.path(), "predicted", "mcap") else { return };
    let frames = predicted_objects(&path, WorldOrigin::default()).unwrap();
    assert_eq!(frames.len(), 60);
    for (number, frame) in frames.iter().enumerate() {
        let now_s = number as f32 / 10.0;
        let now: Vec<_> = frame.objects.iter().map(|agent| (agent.agent_type, agent.position_m)).collect();
        assert_agents(&now, now_s);
        assert_eq!(frame.other_len, 1);
        // The second path goes on at the agent's speed.
        let later = |agent: &PredictedAgent| (agent.agent_type, agent.paths[1].at(2_250_000_000).unwrap());
        assert_agents(&frame.objects.iter().map(later).collect::<Vec<_>>(), now_s + 2.25);
        let confidences =
            |agent: &PredictedAgent| agent.paths[0].confidence == 0.25 && agent.paths.len() == 2;
        assert!(frame.objects.iter().all(confidences));
    }
}

/// Writes a bag in sqlite3 of which half of the messages are in the write-ahead log, as after a recorder was
/// killed.
const KILLED: &str = r#"
import pathlib, sqlite3, sys
folder = pathlib.Path(sys.argv[1])
folder.mkdir()
data = bytes.fromhex(sys.argv[2])
base = sqlite3.connect(folder / "work", isolation_level=None)
base.execute("PRAGMA journal_mode=WAL")
base.execute("PRAGMA wal_autocheckpoint=0")
base.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)")
base.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)")
base.execute("INSERT INTO topics VALUES(1, '/objects', 'autoware_perception_msgs/msg/DetectedObjects', 'cdr')")
for k in range(40):
    if k == 20:
        base.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    stamp = int(k + 1).to_bytes(4, "little")
    base.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES(1, ?, ?)", (k * 10**9, data[:4] + stamp + data[8:]))
for end in ("", "-wal"):
    (folder / f"drive_0.db3{end}").write_bytes((folder / f"work{end}").read_bytes())
base.close()
(folder / "metadata.yaml").write_text("""rosbag2_bagfile_information:
  message_count: 40
  relative_file_paths:
    - drive_0.db3
  files:
    - path: drive_0.db3
      message_count: 40
""")
"#;

#[test]
fn a_bag_of_a_killed_recorder_is_converted_with_all_messages_or_not_at_all() {
    use interop::messages::{DetectedObject, DetectedObjects, ObjectClassification, label};
    let car = DetectedObject {
        classification: vec![ObjectClassification { label: label::CAR, probability: 1.0 }],
        ..DetectedObject::default()
    };
    let message = DetectedObjects { header: crate::rosbags::header(0, "map"), objects: vec![car] };
    let hex: String = interop::cdr::to_bytes(&message).iter().map(|byte| format!("{byte:02x}")).collect();
    let outer = tempfile::tempdir().unwrap();
    let (bag, out) = (outer.path().join("drive"), outer.path().join("drive.mcap"));
    let python = std::env::var("STGDAT_PYTHON").unwrap_or_else(|_| "python3".into());
    match Command::new(&python).args(["-c", KILLED]).arg(&bag).arg(hex).status() {
        Ok(status) => assert!(status.success()),
        Err(error) => return println!("skipped: {python}: {error}"),
    }
    let convert = || {
        let script = format!("{SCRIPTS}/bag_to_mcap.py");
        let output = Command::new(&python).arg(script).arg(&bag).arg(&out).output().unwrap();
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    assert_eq!(convert().0, Some(0));
    assert_eq!(data::open(&out, None).unwrap().frames.len(), 40);
    std::fs::remove_file(bag.join("drive_0.db3-wal")).unwrap();
    let (code, error) = convert();
    assert_eq!(code, Some(65));
    assert!(error.contains("20 messages, and metadata.yaml lists 40"), "{error}");
    assert!(!out.exists());
}
