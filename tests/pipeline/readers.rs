//! Readers that come and go. The places of a reader that dies become free, and the death is counted. A reader
//! that finds no place gets an error with the reason.

use std::io::{BufRead as _, BufReader, Read as _};
use std::path::Path;
use std::process::{Child, Command};

use rustix::process::Signal;
use serde_json::Value;
use testing::Scratch;

use crate::programs::example;
use crate::started::{Started, assert_nothing_left, piped, run_well, stderr, stdout, wait_for};

/// A consumer of forecasts beside a run, killed when dropped.
struct Consumer(Child);

impl Consumer {
    fn start(command: &mut Command) -> Self {
        Self(command.spawn().unwrap_or_else(|error| panic!("{command:?}: {error}")))
    }

    /// The consumer's first line, which it prints once it has a frame; or its errors.
    fn first_line(&mut self) -> Result<String, String> {
        let mut line = String::new();
        let output = self.0.stdout.as_mut().expect("its output is kept");
        BufReader::new(output).read_line(&mut line).expect("a pipe can be read");
        if !line.is_empty() {
            return Ok(line);
        }
        let mut told = String::new();
        self.0.stderr.as_mut().expect("it is kept").read_to_string(&mut told).expect("a pipe can be read");
        Err(told)
    }
}

impl Drop for Consumer {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The consumer of the examples.
fn in_rust(root: &Path) -> Command {
    let mut command = piped(example("consumer"));
    command.arg("--run").arg(root.join("run"));
    command
}

/// The number of dead readers that `stgdat top` shows.
fn dead_readers(root: &Path) -> u64 {
    let root = root.display().to_string();
    let status = stdout(&run_well(&["top", "--run", &root, "--once", "--json"]));
    let status: Value = serde_json::from_str(&status).expect("JSON");
    status["report"]["supervision"]["dead_readers"].as_u64().expect("a number")
}

#[test]
fn readers_that_die_give_their_places_back_and_are_counted() {
    let scratch = Scratch::new("dead-readers");
    let report = scratch.path("report.json");
    let run = Started::run(&["--agents", "4", "--ticks", "2000", "--quiet", "--report", &report]);
    let root = run.wait_until_it_forecasts();
    let mut deaths = 0;
    let mut kill = |command: &mut Command| {
        let mut consumer = Consumer::start(command);
        let line = consumer.first_line().unwrap_or_else(|told| panic!("after {deaths} deaths: {told}"));
        assert!(line.starts_with("tick "), "{line}");
        deaths += 1;
    };
    // Three of the six places are taken, so the fourth start would fail without clean-up.
    (0..8).for_each(|_| kill(&mut in_rust(&root)));
    wait_for("deaths are not counted", || (dead_readers(&root) == deaths).then_some(()));
    // A recording takes one more place.
    let file = scratch.path("a.mcap");
    run_well(&["record", &file, "--run", &root.display().to_string(), "--seconds", "1"]);
    run.signal(Signal::TERM);
    let output = run.output();
    assert_eq!(output.status.code(), Some(143), "{}", stderr(&output));
    assert!(stderr(&output).contains("launcher: a reader has died: consumer ("), "{}", stderr(&output));
    assert!(stdout(&output).contains("readers of topics have died"), "{}", stdout(&output));
    let report: Value = serde_json::from_slice(&scratch.read("report.json")).expect("JSON");
    let counted = report["supervision"]["dead_readers"].as_u64().expect("a number");
    assert_eq!(counted, deaths, "each once: by the launcher's look, or by the clean-up after another death");
    assert_eq!(report["supervision"]["outages"], Value::Array(Vec::new()), "no stage died for it");
    assert_nothing_left(&root);
}

#[test]
fn a_reader_without_a_place_names_the_limit_and_the_key_that_raises_it() {
    let scratch = Scratch::new("places");
    let more =
        scratch.pipeline("more.toml", "[[stage]]\nname", "readers = { forecasts = 2 }\n\n[[stage]]\nname");
    for (arguments, places, most) in [(&[][..], 3, 6), (&["--pipeline", &more][..], 5, 8)] {
        let run = Started::run(&[&["--agents", "4", "--quiet"][..], arguments].concat());
        let root = run.wait_until_it_forecasts();
        let start = |_| {
            let mut consumer = Consumer::start(&mut in_rust(&root));
            consumer.first_line().map(|_| consumer)
        };
        let living: Vec<Consumer> =
            (0..places).map(start).collect::<Result<_, _>>().expect("there are places");
        let told = start(places).err().expect("all places are taken");
        let limit = format!("all {most} places for readers of topic \"forecasts\" are taken");
        let names_the_limit =
            |told: &str| told.contains(&limit) && told.contains("readers = { forecasts = 2 }");
        assert!(names_the_limit(&told), "{told}");
        let root_name = root.display().to_string();
        for arguments in [&["record", &scratch.path("none.mcap")][..], &["stage", "replace", "sampler"]] {
            let refused = crate::started::run(&[arguments, &["--run", &root_name]].concat());
            assert!(!refused.status.success() && names_the_limit(&stderr(&refused)), "{}", stderr(&refused));
        }
        drop(living);
        run.signal(Signal::TERM);
        assert_eq!(run.output().status.code(), Some(143));
        assert_nothing_left(&root);
    }
}
