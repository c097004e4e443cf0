//! Torn, damaged or rewritten recordings, through the verbs that read them.

use std::fs;
use testing::Scratch;

use crate::recorded::lockstep;
use crate::started::{piped, run, run_well, stderr, stdout};

/// The positions of the chunks, found by the name of their compression.
fn chunks(file: &[u8]) -> Vec<usize> {
    let name = b"\x03\0\0\0lz4";
    let names = file.windows(name.len()).enumerate().filter(|(_, window)| window == name);
    names.map(|(place, _)| place - 37).filter(|at| file[*at] == 0x06).collect()
}

#[test]
fn zeros_after_a_power_loss_end_a_recording_at_its_last_whole_chunk() {
    let scratch = Scratch::new("torn-zeros");
    let (whole, torn) = (lockstep(&scratch, "a.mcap", "3"), scratch.path("torn.mcap"));
    let mut bytes = fs::read(&whole).expect("it was recorded");
    // How many ticks a chunk has depends on the times in the recording.
    let second = chunks(&bytes)[1];
    bytes[second + 1_000..].fill(0);
    fs::write(&torn, bytes).expect("a file can be written");
    let replayed = stdout(&run_well(&["replay", &torn]));
    assert!(replayed.contains("INCOMPLETE: byte"), "{replayed}");
    let ticks = replayed.split_once("equal to the byte: ").and_then(|(_, rest)| rest.split_once(" ticks"));
    let ticks: u64 = ticks.expect(&replayed).0.parse().expect("a number");
    assert!((1..60).contains(&ticks), "{ticks} of 60 ticks");
    let same = stdout(&run_well(&["diff", &torn, &torn]));
    assert!(same.matches("INCOMPLETE").count() == 2 && same.contains("equal to the byte"), "{same}");
    let compared = run(&["diff", &whole, &torn]);
    assert_eq!(compared.status.code(), Some(1), "ticks are missing: {}", stdout(&compared));
    for arguments in [&["tick", &torn, "3"][..], &["trace", &torn]] {
        let shown = run_well(arguments);
        assert!(stderr(&shown).contains("INCOMPLETE"), "{}", stderr(&shown));
    }
}

#[test]
fn a_damaged_chunk_is_skipped_and_named() {
    let scratch = Scratch::new("torn-chunk");
    let (whole, hurt) = (lockstep(&scratch, "a.mcap", "3"), scratch.path("hurt.mcap"));
    let mut bytes = fs::read(&whole).expect("it was recorded");
    let middle = chunks(&bytes).into_iter().find(|at| *at > bytes.len() / 2).expect("chunks");
    bytes[middle + 1_000] ^= 0x10;
    fs::write(&hurt, bytes).expect("a file can be written");
    for arguments in [&["replay", &hurt][..], &["diff", &whole, &hurt]] {
        let output = run(arguments);
        let text = stdout(&output);
        assert_eq!(output.status.code(), Some(65), "{text}{}", stderr(&output));
        assert!(text.contains("DAMAGED") && text.contains(&format!("byte {middle}:")), "{text}");
        let forecasts = text.lines().find(|line| line.trim_start().starts_with("forecasts")).expect(&text);
        let ticks: u64 = forecasts.split_whitespace().nth(1).expect(&text).parse().expect("a number");
        assert!((30..60).contains(&ticks), "ticks before and behind the damage: {text}");
    }
    let last = run(&["tick", &hurt, "59"]);
    assert_eq!(last.status.code(), Some(65), "{}", stderr(&last));
    assert!(stdout(&last).contains("tick 59"), "{}", stdout(&last));
}

/// PyPI's `mcap` rewrites the file, if it is installed.
#[test]
fn what_python_rewrites_replays_to_the_same_bytes() {
    let scratch = Scratch::new("torn-python");
    let whole = lockstep(&scratch, "a.mcap", "3");
    let python = std::env::var("STGDAT_PYTHON").unwrap_or_else(|_| "python3".into());
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/interop/rewrite_mcap.py");
    for mode in ["zstd", "lz4", "none", "loose", "bare", "topics"] {
        let other = scratch.path(&format!("{mode}.mcap"));
        let output = match piped(&python).args([script, &whole, &other, mode]).output() {
            Ok(output) => output,
            Err(error) => return testing::skip(format_args!("{python}: {error}")),
        };
        if output.status.code() == Some(77) {
            return testing::skip(format_args!(
                "{} (STGDAT_PYTHON names another interpreter)",
                stdout(&output).trim_end()
            ));
        }
        assert!(output.status.success(), "{mode}: {}", stderr(&output));
        for arguments in [&["diff", &whole, &other][..], &["replay", &other]] {
            let text = stdout(&run_well(arguments));
            assert!(text.contains("equal to the byte: 60 ticks"), "{mode}: {text}");
            assert!(text.contains("topics that are not stgdat's, left out: camera"), "{mode}: {text}");
        }
    }
}
