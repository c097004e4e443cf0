//! Foxglove's websocket of a running pipeline, read by PyPI's `websockets` if it is installed.

use std::collections::BTreeMap;
use std::path::Path;

use recording::bag_messages;
use scene::MapBuilder;
use testing::Scratch;

use crate::started::{Started, assert_nothing_left, piped, run, stderr, stdout, stgdat};

/// Messages in the order of each topic.
type ByTopic = BTreeMap<String, Vec<Vec<u8>>>;

fn client(url: &str, file: &str, more: &[&str]) -> Started {
    let python = std::env::var("STGDAT_PYTHON").unwrap_or_else(|_| "python3".into());
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/interop/read_foxglove.py");
    Started::spawn(piped(python).args([script, url, file]).args(more))
}

/// The messages that a client has written down.
fn received(text: &str) -> ByTopic {
    let mut messages = ByTopic::new();
    for line in text.lines() {
        let [topic, _, hex] = line.splitn(3, ' ').collect::<Vec<_>>()[..] else { panic!("{line}") };
        let byte = |place| u8::from_str_radix(&hex[place..place + 2], 16).expect("hexadecimal");
        let bytes = (0..hex.len()).step_by(2).map(byte).collect();
        messages.entry(topic.to_owned()).or_default().push(bytes);
    }
    messages
}

fn recorded(file: &[u8]) -> ByTopic {
    let mut messages = ByTopic::new();
    let all = bag_messages(file, |message| {
        messages.entry(message.topic.to_owned()).or_default().push(message.data.to_vec());
        Ok::<_, String>(())
    });
    all.expect("the recording is whole");
    messages
}

#[test]
fn foxglove_receives_live_what_a_recording_holds() {
    if !Path::new(env!("CARGO_BIN_EXE_stgdat")).with_file_name("stgdat-foxglove").is_file() {
        println!(
            "skipped: `cargo build --release -p stgdat-foxglove --features websocket` builds the server"
        );
        return;
    }
    let scratch = Scratch::new("foxglove-live");
    let [file, live, map] = ["a.mcap", "live.txt", "map.safetensors"].map(|name| scratch.path(name));
    let mut visited = MapBuilder::new([-50.0, -50.0], 100, 100).expect("a small map");
    assert!(visited.visit([3.5, -2.5], [1.0, 2.0]));
    visited.build().save(Path::new(&map)).expect("a map");
    let scene = ["--agents", "12", "--ticks", "250", "--quiet", "--map", &map];
    let run = Started::run(&[&scene[..], &["--record", &file, "--for", "foxglove"]].concat());
    let root = run.wait_until_it_runs();
    let mut view =
        Started::spawn(stgdat().args(["view", "--foxglove", "--address", "0", "--run"]).arg(&root));
    let url = view.line().split(' ').next().unwrap_or_default().to_owned();
    assert!(url.starts_with("ws://127.0.0.1:"), "{url}");
    // A client that subscribes and does not read.
    let mut stalled = client(&url, &scratch.path("stalled.txt"), &["stall"]);
    let _ = stalled.line();
    let reader = client(&url, &live, &[]).output();
    drop(stalled);
    let view = view.output();
    assert!(view.status.success(), "the server ends with its run: {}", stderr(&view));
    let output = run.output();
    assert!(output.status.success(), "{}", stderr(&output));
    assert_nothing_left(&root);
    if reader.status.code() == Some(77) {
        testing::skip(format_args!(
            "{} (STGDAT_PYTHON names another interpreter)",
            stdout(&reader).trim_end()
        ));
        return;
    }
    assert!(reader.status.success(), "{}{}", stdout(&reader), stderr(&reader));
    let (live, file) =
        (received(&String::from_utf8_lossy(&scratch.read("live.txt"))), recorded(&scratch.read("a.mcap")));
    // The map is sent once, and to the second client when it subscribes. Only its stamp is another one.
    let of_map = [&live, &file].map(|messages| &messages["/stgdat/map"]);
    assert_eq!(of_map.map(Vec::len), [1, 1]);
    let cells = of_map.map(|messages| &messages[0][messages[0].len() - 100 * 100 * 12..]);
    assert!(cells[0] == cells[1] && cells[0].iter().any(|byte| *byte != 0));
    for topic in ["/stgdat/scene", "/stgdat/tf"] {
        let (live, file) = (&live[topic], &file[topic]);
        assert!(live.len() > 20, "{} messages of {topic}", live.len());
        let begin = file.iter().position(|message| *message == live[0]).expect("the first one is recorded");
        assert!(file[begin..].starts_with(live), "{topic}: none is missing or different");
    }
}

#[test]
fn options_of_foxglove_need_foxglove() {
    let without = run(&["view", "--paths", "5"]);
    assert_eq!(without.status.code(), Some(2));
    assert!(stderr(&without).contains("--foxglove"), "{}", stderr(&without));
}
