//! A stage's processors and memory, and conditions on a run's figures.

use recorder::Report;
use testing::Scratch;

use crate::started::{run, run_well, stderr, stdout};

#[test]
fn a_run_fails_where_a_figure_is_out_of_bounds() {
    let scene = ["run", "--quiet", "--agents", "3", "--ticks", "15", "--speed", "max"];
    let with = |conditions: &[&str]| {
        let conditions = conditions.iter().flat_map(|condition| ["--fail-if", condition]);
        run(&scene.into_iter().chain(conditions).collect::<Vec<_>>())
    };
    let passed = with(&["lost_frames > 0", "end_to_end_max > 600 s"]);
    assert!(passed.status.success(), "{}", stderr(&passed));
    let failed = with(&["end_to_end_p50 > 0 us", "lost_frames > 0", "end_to_end_p999 > 1 s"]);
    assert_eq!(failed.status.code(), Some(70), "{}", stderr(&failed));
    let told = stderr(&failed);
    assert!(told.contains("--fail-if 'end_to_end_p50 > 0 us': it is "), "{told}");
    assert!(told.contains("'end_to_end_p999 > 1 s': the run was too short to measure it"), "{told}");
    assert!(!told.contains("lost_frames") && stdout(&failed).contains("LATENCY ms"), "{told}");
    let unknown = with(&["speed > 3 ms"]);
    assert_eq!(unknown.status.code(), Some(2), "{}", stderr(&unknown));
    assert!(stderr(&unknown).contains("there is no figure \"speed\""), "{}", stderr(&unknown));
}

#[test]
fn a_run_tells_its_memory_and_which_processors_it_could_not_have() {
    let scratch = Scratch::new("processors");
    let pipeline = scratch.pipeline("p.toml", "name = \"encoder\"", "name = \"encoder\"\ncpu = [1023]");
    let file = format!("awake = true\n{}", std::fs::read_to_string(&pipeline).unwrap());
    std::fs::write(&pipeline, file).unwrap();
    let report = scratch.path("report.json");
    let scene = ["run", "--quiet", "--agents", "3", "--ticks", "1500", "--speed", "max"];
    let output = run_well(&[&scene[..], &["--pipeline", &pipeline, "--report", &report]].concat());
    let note = "the encoder can't have processor 1023: it runs on any";
    assert!(stderr(&output).contains(note) && stdout(&output).contains(note), "{}", stderr(&output));
    let report = Report::read(report.as_ref()).unwrap();
    let (of_processors, others): (Vec<&str>, Vec<&str>) =
        report.supervision.notes.iter().map(String::as_str).partition(|said| *said == note);
    assert_eq!(of_processors.len(), 1);
    let may_hold = std::fs::File::options().write(true).open("/dev/cpu_dma_latency").is_ok();
    assert_eq!(others.len(), usize::from(!may_hold), "{others:?}");
    assert!(others.iter().all(|said| said.contains("may sleep between ticks")), "{others:?}");
    let memory = &report.supervision.memory;
    for stage in ["tracker", "localiser", "extractor", "encoder", "decoder", "sampler"] {
        let of_stage = memory.get(stage).unwrap_or_else(|| panic!("{stage}: {memory:?}"));
        assert!(of_stage.ticks > 0 && of_stage.resident_kib > 0, "{stage}: {memory:?}");
    }
    assert!(stdout(&output).contains(" MEMORY      page faults in the last "), "{}", stdout(&output));
}

#[test]
fn a_limit_that_the_kernel_refuses_is_reported_once_and_the_run_continues() {
    let scratch = Scratch::new("refused");
    let pipeline = scratch.pipeline("p.toml", "name = \"source\"", "name = \"source\"");
    let shipped = std::fs::read_to_string(&pipeline).unwrap();
    let keys = "[realtime]\nprofile = \"vehicle\"\nawake = false\ncpu = [1023]";
    std::fs::write(&pipeline, format!("{keys}\n{shipped}")).unwrap();
    let report = scratch.path("report.json");
    let scene = ["run", "--quiet", "--agents", "3", "--ticks", "30", "--speed", "max"];
    let output = run_well(&[&scene[..], &["--pipeline", &pipeline, "--report", &report]].concat());
    let chain = "the source, tracker, localiser, extractor, encoder, decoder and sampler can't have";
    let of_cpus = format!("{chain} processor 1023: they run on any");
    let notes = Report::read(report.as_ref()).unwrap().supervision.notes;
    assert_eq!(notes.iter().filter(|note| **note == of_cpus).count(), 1, "{notes:?}");
    assert_eq!(stderr(&output).matches(&of_cpus).count(), 1, "{}", stderr(&output));
    // These depend on the user's permissions.
    for start in [format!("{chain} priorities 30 to 36"), "memory is locked up to".to_owned()] {
        assert!(notes.iter().filter(|note| note.starts_with(&start)).count() <= 1, "{notes:?}");
    }
    assert!(notes.len() <= 3, "{notes:?}");
}
