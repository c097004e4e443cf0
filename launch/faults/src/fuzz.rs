//! Fuzz targets for the texts that the launcher reads: pipeline.toml and fault specifications.
//!
//! Each target starts from a valid text and lets the fuzzer edit it. Nothing may panic, each error must point
//! into the text, and each accepted text must satisfy the launcher's assumptions. `tests/fuzz/readers.rs` has
//! the command for a longer search.

use std::path::Path;

use configuration::pipeline_file::SHIPPED;
use configuration::stages::declared;

use crate::spec::{Action, Due, Spec};

/// Iterations of a target in an ordinary test run.
const ITERATIONS: usize = 5_000;
/// Longest list of edits, in bytes.
const EDITS_BYTES_MAX: usize = 64;
/// Words that tend to break parsers of TOML and of numbers.
const WORDS: [&str; 24] = [
    "nan",
    "-inf",
    "1e999",
    "-1",
    "0",
    "18446744073709551616",
    "\"",
    "'''",
    "[[stage]]\n",
    "[[fault]]\n",
    "[",
    "]",
    "{",
    "}",
    "=",
    ",",
    "\n",
    "\\u0000",
    "é",
    "\"source\"",
    "\"sampler\"",
    "kind = ",
    "stage = ",
    "ticks = [0, 1]\n",
];

/// Applies edits of four bytes each: position (two bytes), kind and word.
fn edit(text: &mut Vec<char>, edits: &[u8]) {
    for edit in edits.chunks_exact(4) {
        let place = usize::from(u16::from_le_bytes([edit[0], edit[1]])) % (text.len() + 1);
        let end = (place + usize::from(edit[3] % 40)).min(text.len());
        match edit[2] % 5 {
            0 => drop(text.splice(place..place, [char::from(edit[3])])),
            1 => drop(text.drain(place..end)),
            2 => {
                let copied = text[place..end].to_vec();
                text.extend(copied);
            }
            3 => drop(text.splice(place..end, WORDS[usize::from(edit[3]) % WORDS.len()].chars())),
            _ => drop(text.splice(place..place, WORDS[usize::from(edit[3]) % WORDS.len()].chars())),
        }
    }
}

/// Passes `read` the edited valid text, and the fuzzer's bytes unchanged.
fn fuzz(good: &str, read: fn(&str)) {
    read(good);
    let good: Vec<char> = good.chars().collect();
    bolero::check!().with_iterations(ITERATIONS).with_max_len(EDITS_BYTES_MAX).for_each(|bytes: &[u8]| {
        let mut edited = good.clone();
        edit(&mut edited, bytes);
        read(&edited.into_iter().collect::<String>());
        read(&String::from_utf8_lossy(bytes));
    });
}

#[test]
fn pipeline_file() {
    fuzz(SHIPPED, |text| match configuration::Pipeline::parse("p.toml", text, &declared()) {
        Ok(pipeline) => {
            assert!(!pipeline.stages.is_empty());
            assert!(pipeline.stages.iter().all(|stage| stage.restart.restarts_max > 0));
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    });
}

/// The first fault has all kinds of keys.
const SPEC: &str = r#"
shows = "everything"
[run]
ticks = 100
agents = 8
seed = 3
protect = ["detections"]
stages = { tracker = { restarts_max = 2 } }
arguments = ["--speed", "max"]
[[fault]]
kind = "kill"
stage = "decoder"
point = "mid-write"
at = [10, 20]
[[fault]]
kind = "kill"
stage = "launcher"
within_ms = [0, 3000]
[[fault]]
kind = "random"
stages = ["encoder"]
ticks = [10, 20]
count = 3
for_ms = 200
[[fault]]
kind = "delay"
topic = "controls"
ticks = [5, 9]
delay_ms = 20
jitter_ms = 5
probability = 0.5
seed = 9
[[fault]]
kind = "bit-flip"
topic = "detections"
ticks = [1, 2]
bits = 3
in = "header"
[[fault]]
kind = "limit"
stage = "recorder"
at = 9
resource = "memory"
value = 1000
[expect]
hole_max = 3
outages = [{ stage = "decoder", cause = "signal 9", count = 2 }]
[[expect.counted]]
stage = "tracker"
cause = "check value"
min = 1
"#;

#[test]
fn fault_specification() {
    fuzz(SPEC, |text| match Spec::parse(Path::new("a.toml"), text) {
        Ok(spec) => {
            assert!(spec.run.ticks > 0);
            let faults = &spec.faults;
            assert!(faults.topics.iter().all(|fault| fault.ticks[0] <= fault.ticks[1]));
            assert!(faults.topics.iter().all(|fault| fault.probability > 0.0 && fault.probability <= 1.0));
            let is_in_run = |action: &Action| match action.at {
                Due::Tick(tick) => tick < spec.run.ticks,
                Due::AfterStart(..) => true,
            };
            assert!(faults.actions.iter().all(is_in_run));
            let in_order = |within: &[u64; 2]| within[0] < within[1];
            assert!(faults.consumers.iter().all(|consumer| consumer.within_ms.iter().all(in_order)));
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    });
}
