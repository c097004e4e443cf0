//! Unusable input is refused with its location and an exit code, and leaves no files behind.

use safetensors::SafeTensors;
use safetensors::tensor::TensorView;
use testing::{SHIPPED_PIPELINE, Scratch};

use crate::started::{self, LeftoverWatch, piped, run, run_well, stderr, stdout};

const WEIGHTS: &[u8] = include_bytes!("../../shared/weights/onboard.safetensors");

/// Asserts that `stgdat` with these arguments ends with this code and a message that contains these texts,
/// and leaves no files.
fn assert_refused(arguments: &[&str], code: i32, texts: &[&str]) {
    let watch = LeftoverWatch::begin();
    let output = started::assert_refused(arguments, code, texts);
    assert_eq!(stdout(&output), "", "{arguments:?}: nothing to report");
    watch.assert_nothing_new();
}

/// The embedded weights with one tensor as a single row.
fn with_wrong_shape(tensor: &str) -> Vec<u8> {
    let file = SafeTensors::deserialize(WEIGHTS).expect("the embedded weights are safetensors");
    let (_, header) = SafeTensors::read_metadata(WEIGHTS).expect("the embedded weights are safetensors");
    assert!(file.tensor(tensor).is_ok(), "there is no {tensor}");
    let tensors = file.iter().map(|(name, view)| {
        let len = view.shape().iter().product();
        let shape = if name == tensor { vec![1, len] } else { view.shape().to_vec() };
        (name, TensorView::new(view.dtype(), shape, view.data()).expect("as many numbers as before"))
    });
    safetensors::serialize(tensors, header.metadata().clone()).expect("all tensors have their numbers")
}

#[test]
fn places_that_can_not_be_written_are_refused_before_any_work() {
    assert_refused(&["run", "--report", "no/such/folder/file"], 65, &["no/such/folder: No such file"]);
    assert_refused(&["run", "--report", "."], 65, &["is a directory"]);
}

#[test]
fn files_that_are_not_weights_are_refused() {
    let scratch = Scratch::new("weights");
    let recording = scratch.recording("scene.csv", 5);
    let foreign = scratch.file("foreign.safetensors", "PNG and nothing else");
    let truncated = scratch.file("truncated.safetensors", &WEIGHTS[..WEIGHTS.len() / 2]);
    let empty = scratch.file("empty.safetensors", "");
    let cases = [
        (foreign.as_str(), "foreign.safetensors"),
        (&truncated, "truncated: "),
        (&empty, "empty.safetensors"),
        ("no/such.safetensors", "no/such.safetensors"),
    ];
    for (weights, texts) in cases {
        assert_refused(&["run", "--weights", weights], 65, &[texts]);
        assert_refused(&["predict", &recording, "--weights", weights], 65, &[texts]);
    }
}

#[test]
fn tensors_of_another_shape_are_refused_by_their_stage() {
    let scratch = Scratch::new("shape");
    let recording = scratch.recording("scene.csv", 5);
    for (tensor, stage) in
        [("fe.context.fc.weight", "extractor"), ("decoder.vehicle.gru.weight_ih", "decoder")]
    {
        let weights = scratch.file("shape.safetensors", with_wrong_shape(tensor));
        let texts = format!("tensor {tensor} has shape [1, ");
        assert_refused(&["predict", &recording, "--weights", &weights], 65, &[&texts]);
        assert_refused(&["run", "--ticks", "5", "--weights", &weights], 65, &[&texts, stage]);
    }
}

#[test]
fn errors_in_a_pipeline_are_reported_with_their_place() {
    let scratch = Scratch::new("pipeline");
    let place = |file: &str, text: &str| {
        let line =
            SHIPPED_PIPELINE.lines().position(|line| line.contains(text)).expect("the text is there") + 1;
        format!("{file}:{line}:")
    };
    let unknown_key = scratch.pipeline("key.toml", "budget_ms = 6", "budget = 6");
    let no_producer = scratch.pipeline(
        "producer.toml",
        "name = \"encoder\"",
        "name = \"encoder\"\ncommand = [\"./mine\"]\nreads = [\"features\"]",
    );
    let cycle = scratch.pipeline(
        "cycle.toml",
        "name = \"localiser\"",
        "name = \"localiser\"\ncommand = [\"./mine\"]\nreads = [\"tracks\", \"forecasts\"]\nwrites = [\"context\"]",
    );
    let cases: [(&str, &[&str]); 4] = [
        (&unknown_key, &["unknown field `budget`", &place("key.toml", "budget_ms = 6")]),
        (&no_producer, &["no stage writes \"encodings\"", "producer.toml:"]),
        (&cycle, &["needs its own output", "cycle.toml:"]),
        ("no/such.toml", &["no/such.toml"]),
    ];
    for (pipeline, texts) in cases {
        assert_refused(&["check", pipeline], 78, texts);
        assert_refused(&["run", "--pipeline", pipeline], 78, texts);
    }
}

#[test]
fn a_stage_that_cannot_start_or_ends_early_ends_the_run() {
    let scratch = Scratch::new("stage");
    let no_such_program = scratch.pipeline_with("localiser", &["./none"]);
    assert_refused(&["run", "--pipeline", &no_such_program], 78, &["the localiser", "./none"]);
    let ends_at_once = scratch.pipeline_with("encoder", &["true"]);
    assert_refused(&["run", "--pipeline", &ends_at_once], 70, &["the encoder ended with exit code 0"]);
    let words = "echo no key >&2; exit 78";
    let last_words = scratch.pipeline_with("source", &["sh", "-c", words]);
    assert_refused(
        &["run", "--pipeline", &last_words],
        78,
        &["the source ended with exit code 78", "no key"],
    );
    let again_and_again = scratch.pipeline_with("encoder", &["sh", "-c", "exit 3"]);
    assert_refused(
        &["run", "--pipeline", &again_and_again],
        70,
        &["the encoder ended with exit code 3 and is given up: it was restarted too often"],
    );
}

#[test]
fn unreadable_recordings_are_refused_with_their_place() {
    let scratch = Scratch::new("recordings");
    let header = "stamp_s,id,type,x_m,y_m\n";
    let broken = scratch.file("broken.csv", format!("{header}0.00,1,vehicle,1.5,2\n0.08,1,vehicle,nan,2\n"));
    let short = scratch.file("short.csv", format!("{header}0.00,1,vehicle\n"));
    let twice = scratch.file("twice.csv", format!("{header}0,1,vehicle,1,2\n0,1,vehicle,1,2\n"));
    let binary = scratch.file("binary.txt", b"\x7fELF\0\0\0\xff\xfe");
    let empty = scratch.file("empty.csv", "");
    let cases: [(&str, &[&str]); 6] = [
        (&broken, &["broken.csv:3:16", "nan", "x_m"]),
        (&short, &["short.csv:2"]),
        (&twice, &["twice.csv:3", "twice.csv:2"]),
        (&binary, &["binary.txt"]),
        (&empty, &["empty.csv"]),
        ("no/such/file.txt", &["no/such/file.txt"]),
    ];
    for (recording, texts) in cases {
        assert_refused(&["run", "--recording", recording], 65, texts);
        assert_refused(&["predict", recording], 65, texts);
    }
    assert_refused(&["run", "--map", &broken], 65, &["broken.csv"]);
}

#[test]
fn invalid_command_lines_end_with_exit_code_2() {
    let cases: [(&[&str], &str); 8] = [
        (&["runn"], "runn"),
        (&["run", "--tick", "3"], "--tick"),
        (&["run", "--ticks", "0"], "--ticks"),
        (&["run", "--agents", "0"], "--agents"),
        (&["run", "--agents", "4000"], "--agents"),
        (&["run", "--speed", "fast"], "--speed"),
        (&["run", "--recording", "a.csv", "--format", "xml"], "xml"),
        (&["predict", "a.csv", "b.csv"], "b.csv"),
    ];
    for (arguments, texts) in cases {
        assert_refused(arguments, 2, &[texts]);
    }
}

#[test]
fn full_shared_memory_is_reported_with_exit_code_69() {
    let watch = LeftoverWatch::begin();
    // A private mount hides the machine's shared memory from this one process and its children.
    let in_little_memory = |script: &str| {
        let script = format!("mount -t tmpfs -o size=16m tmpfs /dev/shm && {script}");
        piped("unshare").args(["-m", "sh", "-c", &script, env!("CARGO_BIN_EXE_stgdat")]).output()
    };
    if !in_little_memory("true").is_ok_and(|output| output.status.success()) {
        testing::skip("no right to a mount of its own");
        return;
    }
    let output = in_little_memory("\"$0\" run --ticks 5; code=$?; ls /dev/shm; exit $code");
    let output = output.expect("unshare has just worked");
    assert_eq!(output.status.code(), Some(69), "{}", stderr(&output));
    assert!(stderr(&output).contains("/dev/shm has 16 MiB free, a run needs"), "{}", stderr(&output));
    assert_eq!(stdout(&output), "", "files are left");
    watch.assert_nothing_new();
}

#[test]
fn verify_fails_if_one_weight_is_changed() {
    let golden = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/golden/pedestrian");
    let scratch = Scratch::new("verify");
    let mut names = Vec::new();
    for entry in std::fs::read_dir(golden).expect("the golden vectors are part of the repository") {
        let entry = entry.expect("a folder can be read");
        let name = entry.file_name().to_string_lossy().into_owned();
        scratch.file(&name, std::fs::read(entry.path()).expect("a file can be read"));
        names.push(name);
    }
    let folder = scratch.path("");
    run_well(&["verify", &folder]);
    let mut weights = scratch.read("weights.safetensors");
    let last = weights.len() - 4;
    let value = f32::from_le_bytes(weights[last..].try_into().expect("four bytes"));
    weights[last..].copy_from_slice(&(value + 0.5).to_le_bytes());
    scratch.file("weights.safetensors", weights);
    let output = run(&["verify", &folder]);
    assert_eq!(output.status.code(), Some(70), "{}", stdout(&output));
}

#[test]
fn verify_skips_folders_without_vectors() {
    let golden = |name: &str| format!("{}/../tests/golden/{name}", env!("CARGO_MANIFEST_DIR"));
    let [readme, reference, vectors] = ["README.md", "reference", "pedestrian"].map(golden);
    let output = run_well(&["verify", &readme, &vectors, &reference]);
    assert!(stderr(&output).contains("README.md: skipped"), "{}", stderr(&output));
    assert!(stderr(&output).contains("reference: skipped"), "{}", stderr(&output));
    let output = run(&["verify", &readme]);
    assert_eq!(output.status.code(), Some(65));
    assert!(stderr(&output).contains("README.md: not a folder with golden vectors"), "{}", stderr(&output));
    assert_eq!(run(&["verify", &readme, &reference]).status.code(), Some(65));
    assert_eq!(run(&["verify", &vectors, &golden("nowhere")]).status.code(), Some(65));
}
