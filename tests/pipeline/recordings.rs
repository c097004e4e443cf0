//! Recordings: `predict` in one process and `run` in eight write the same bytes with any options.

use std::path::Path;

use nn::Precision;
use nn::kernels::Isa;
use testing::{Scratch, public_recording};

use crate::started::{Started, run, run_well, stderr, stdout, stgdat};

/// Plays a recording by `predict` twice and by a lockstep run, asserts that all write the same bytes, and
/// returns them.
fn same_bytes(scratch: &Scratch, recording: &str, arguments: &[&str]) -> Vec<u8> {
    for name in ["once", "again"] {
        run_well(&[&["predict", recording, "--out", &scratch.path(name)], arguments].concat());
    }
    let file = scratch.path("run");
    let run = ["run", "--recording", recording, "--speed", "max", "--quiet", "--forecasts", &file];
    run_well(&[&run[..], arguments].concat());
    let once = scratch.read("once");
    assert!(!once.is_empty());
    assert!(once == scratch.read("again"), "predict twice: {arguments:?}");
    assert!(once == scratch.read("run"), "predict and run: {arguments:?}");
    once
}

/// Number of learned forecasts in JSON lines.
fn learned_count(lines: &[u8]) -> usize {
    String::from_utf8_lossy(lines).matches("\"quality\":\"learned\"").count()
}

#[test]
fn predict_and_run_write_the_same_bytes() {
    let scratch = Scratch::new("recording");
    let recording = scratch.recording("scene.csv", 50);
    let trusted = same_bytes(&scratch, &recording, &["--seed", "3", "--ticks", "45"]);
    assert_eq!(trusted.iter().filter(|&&byte| byte == b'\n').count(), 45);
    assert!(learned_count(&trusted) > 200, "{} learned forecasts", learned_count(&trusted));
    let associated = same_bytes(&scratch, &recording, &["--seed", "3", "--ticks", "45", "--associate"]);
    assert!(learned_count(&associated) > 200);
    assert!(trusted != associated, "tracks by position have other ids");
}

#[test]
fn predict_and_run_agree_with_the_same_settings() {
    let scratch = Scratch::new("set");
    let recording = scratch.recording("scene.csv", 40);
    let set = |set: &[&str]| same_bytes(&scratch, &recording, set);
    let shipped = set(&[]);
    let kinematic = set(&["--set", "tracker.prior=kinematic", "--set", "extractor.workers=2"]);
    assert!(shipped != kinematic, "the setting changes the prior");
    let blind = set(&["--set", "localiser.map=none", "--set", "source.ticks=30"]);
    assert_eq!(blind.iter().filter(|&&byte| byte == b'\n').count(), 30);
    assert!(
        blind == set(&["--map", "online", "--ticks", "30", "--set", "localiser.map=none"]),
        "the last one counts"
    );
}

#[test]
fn neither_workers_nor_instruction_sets_change_a_byte() {
    let scratch = Scratch::new("workers");
    let recording = scratch.recording("scene.csv", 40);
    let default = same_bytes(&scratch, &recording, &[]);
    assert!(learned_count(&default) > 200, "{} learned forecasts", learned_count(&default));
    for workers in [1, 2, 4] {
        let settings = ["extractor", "encoder", "decoder"].map(|stage| format!("{stage}.workers={workers}"));
        let arguments: Vec<&str> = settings.iter().flat_map(|setting| ["--set", setting]).collect();
        assert!(default == same_bytes(&scratch, &recording, &arguments), "{workers} workers");
    }
    let fused = [Isa::Avx512, Isa::Avx2, Isa::Neon].into_iter().filter(|isa| isa.available());
    for isa in fused {
        assert!(default == same_bytes(&scratch, &recording, &["--kernels", isa.key()]), "{isa}");
    }
    match Precision::Bf16.check() {
        Ok(()) => {
            let bf16 = same_bytes(&scratch, &recording, &["--set", "decoder.precision=bf16"]);
            assert!(default != bf16, "the precision has an effect");
            for workers in ["decoder.workers=1", "decoder.workers=4"] {
                let arguments = ["--set", "decoder.precision=bf16", "--set", workers];
                assert!(bf16 == same_bytes(&scratch, &recording, &arguments), "bf16, {workers}");
            }
        }
        Err(why) => testing::skip(why),
    }
    // The multiply-adds of portable kernels round twice. The stages of the run use the option too.
    assert!(default != same_bytes(&scratch, &recording, &["--kernels", "portable"]));
}

#[test]
fn a_frame_rate_is_used_wherever_a_recording_is_opened() {
    let scratch = Scratch::new("fps");
    let mut text = "id,frame,label,x_est,y_est,vx_est,vy_est\n".to_owned();
    for (frame, id) in (0..360).flat_map(|frame| (0..3).map(move |id| (frame, id))) {
        let x_m = 1.4 * f64::from(frame) / 29.97;
        text += &format!("{id},{frame},ped,{x_m:.4},{id}.0,1.4,0.0\n");
    }
    let recording = scratch.file("walk_traj_ped_filtered.csv", &text);
    let given = same_bytes(&scratch, &recording, &["--fps", "29.97"]);
    assert!(given == same_bytes(&scratch, &recording, &["--set", "source.fps=29.97"]));
    // Every third of 360 frames is 10 Hz. At 23.98 frames a second every second frame is played.
    let line_count = |lines: &[u8]| lines.iter().filter(|&&byte| byte == b'\n').count();
    assert_eq!(line_count(&given), 120);
    assert_eq!(line_count(&same_bytes(&scratch, &recording, &[])), 180);
    let tracks = scratch.path("tracks.csv");
    for arguments in
        [&["predict", &recording, "--out", &tracks][..], &["track", &recording, "--out", &tracks]]
    {
        let usual = stderr(&run_well(arguments));
        assert!(usual.contains("warning: ") && usual.contains("at 29.97 frames a second"), "{usual}");
        let fitting = stderr(&run_well(&[arguments, &["--fps", "29.97"]].concat()));
        assert!(!fitting.contains("warning: "), "{fitting}");
    }
    let refused = run(&["predict", &scratch.recording("own.csv", 5), "--fps", "25"]);
    assert!(stderr(&refused).contains("csv has a time for every frame"), "{}", stderr(&refused));
}

#[test]
fn predict_and_run_agree_with_a_map_of_the_site() {
    let scratch = Scratch::new("map");
    let recording = scratch.recording("scene.csv", 30);
    let map = scratch.path("site.map");
    let site = mapper::build(&[data::open(Path::new(&recording), None).unwrap()]).unwrap();
    site.map.save(Path::new(&map)).unwrap();
    let with_map = same_bytes(&scratch, &recording, &["--map", &map]);
    let without = same_bytes(&scratch, &recording, &["--map", "none"]);
    assert!(with_map != without, "the map changes forecasts");
}

#[test]
fn predict_and_run_agree_on_public_recordings() {
    let names = [
        "interaction/recorded_trackfiles/DR_USA_Intersection_GL/vehicle_tracks_000.csv",
        "eth_ucy/raw/students001.txt",
    ];
    for (i, name) in names.into_iter().enumerate() {
        let Some(recording) = public_recording(name) else { continue };
        let scratch = Scratch::new(&format!("public-{i}"));
        let lines = same_bytes(&scratch, &recording.display().to_string(), &["--seed", "3", "--ticks", "80"]);
        assert_eq!(lines.iter().filter(|&&byte| byte == b'\n').count(), 80, "{name}");
        assert!(learned_count(&lines) > 80, "{name}: {} learned forecasts", learned_count(&lines));
    }
}

#[test]
fn a_retrieval_memory_is_kept_between_runs() {
    let scratch = Scratch::new("memory");
    let recording = scratch.recording("scene.csv", 90);
    let [memory, copy] = ["a.memory", "b.memory"].map(|name| scratch.path(name));
    let forecasts = scratch.path("run.jsonl");
    let play = ["run", "--recording", &recording, "--speed", "max", "--quiet"];
    run_well(&[&play[..], &["--memory", &memory, "--forecasts", &forecasts]].concat());
    let predict = |arguments: &[&str]| stdout(&run_well(&[&["predict", &recording], arguments].concat()));
    let first = predict(&["--memory", &copy]);
    assert_eq!(first, predict(&[]), "the memory is empty before the first run");
    assert_ne!(first, predict(&["--no-retrieval"]), "the memory changes forecasts within a run");
    assert!(first.as_bytes() == scratch.read("run.jsonl"), "predict and run agree");
    assert!(scratch.read("a.memory") == scratch.read("b.memory"), "and store the same memory");

    let second = predict(&["--memory", &copy]);
    assert_ne!(second, first, "a warm-started memory changes forecasts");
    assert!(scratch.read("a.memory").len() < scratch.read("b.memory").len(), "and grows");

    std::fs::copy(&copy, &memory).expect("a scratch folder");
    let pipeline =
        scratch.pipeline("p.toml", "deadline_ms = 72", &format!("deadline_ms = 72, memory = {memory:?}"));
    run_well(&[&play[..], &["--pipeline", &pipeline, "--forecasts", &forecasts]].concat());
    assert!(predict(&["--memory", &copy]).as_bytes() == scratch.read("run.jsonl"));
    assert!(scratch.read("a.memory") == scratch.read("b.memory"));

    run_well(&[&play[..], &["--pipeline", &pipeline, "--no-retrieval", "--forecasts", &forecasts]].concat());
    assert!(predict(&["--no-retrieval"]).as_bytes() == scratch.read("run.jsonl"));
    assert!(scratch.read("a.memory") == scratch.read("b.memory"), "left alone");
}

#[test]
fn an_unusable_memory_is_refused_before_the_run() {
    let scratch = Scratch::new("foreign-memory");
    let recording = scratch.recording("scene.csv", 5);
    let path = scratch.file("a.memory", "x,y\n");
    let nowhere = scratch.path("nowhere/a.memory");
    for (memory, text) in [(&path, "a.memory: not a retrieval memory"), (&nowhere, "nowhere: No such file")] {
        for verb in [&["run", "--recording"][..], &["predict"], &["track"]] {
            let output = run(&[verb, &[&recording, "--memory", memory]].concat());
            assert_eq!(output.status.code(), Some(65), "{}", stderr(&output));
            assert!(stderr(&output).contains(text), "{}", stderr(&output));
        }
    }
    assert_eq!(scratch.read("a.memory"), b"x,y\n", "it stays as it was");
}

#[test]
fn an_unwritable_memory_fails_the_run_after_its_report() {
    let scratch = Scratch::new("unkept-memory");
    let recording = scratch.recording("scene.csv", 60);
    std::fs::create_dir(scratch.path("gone")).expect("a scratch folder");
    let (memory, report) = (scratch.path("gone/a.memory"), scratch.path("report.json"));
    let mut run = stgdat();
    run.args(["run", "--recording", &recording, "--quiet", "--memory", &memory, "--report", &report]);
    let started = Started::spawn(&mut run);
    // The recording plays for five seconds. The launcher checks the folder before it starts the stages.
    started.wait_until_it_forecasts();
    std::fs::remove_dir(scratch.path("gone")).expect("still empty");
    let output = started.output();
    assert!(!output.status.success());
    assert!(stderr(&output).contains("gone/a.memory: No such file"), "{}", stderr(&output));
    assert!(!scratch.read("report.json").is_empty(), "the run itself went well");
}

#[test]
fn a_memory_without_forecasts_is_refused() {
    let scratch = Scratch::new("useless-memory");
    let recording = scratch.recording("scene.csv", 5);
    let output = run(&[
        "track",
        &recording,
        "--set",
        "tracker.prior=kinematic",
        "--memory",
        &scratch.path("a.memory"),
    ]);
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
}
