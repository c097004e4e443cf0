//! Warm spares: after a stage dies its spare continues, with the state that the stage's output contains.

use std::collections::BTreeSet;

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use testing::Scratch;

use crate::started::{Started, assert_nothing_left, stderr, stdout, wait_for};

/// The shipped pipeline with spares for these stages.
fn pipeline(scratch: &Scratch, stages: &[&str]) -> String {
    let mut text = include_str!("../../launch/pipeline.toml").to_owned();
    for stage in stages {
        let name = format!("name = \"{stage}\"\n");
        assert!(text.contains(&name), "the shipped pipeline.toml has no {name:?}");
        text = text.replacen(&name, &format!("{name}spare = true\n"), 1);
    }
    scratch.file("spares.toml", text)
}

/// The processes of a stage, oldest first: the stage itself, then its spare.
fn processes(run: &Started, stage: &str) -> Vec<Pid> {
    let stages = run.stages();
    let of_stage = stages.iter().filter(|(_, line)| line.get(2).is_some_and(|name| name == stage));
    of_stage.map(|(pid, _)| *pid).collect()
}

/// Waits until a stage has a spare other than `before`, and returns it.
fn spare(run: &Started, stage: &str, before: Option<Pid>) -> Pid {
    wait_for("a spare is started", || match processes(run, stage)[..] {
        [_, spare] if Some(spare) != before => Some(spare),
        _ => None,
    })
}

/// Ids of the agents in each tick, by tick number.
fn ids(forecasts: &[u8]) -> Vec<(u64, BTreeSet<u64>)> {
    let line = |line: &str| {
        let tick: Value = serde_json::from_str(line).expect("JSON");
        let agents = tick["agents"].as_array().expect("agents").iter();
        let ids = agents.map(|agent| agent["id"].as_u64().expect("an id")).collect();
        (tick["seq"].as_u64().expect("a number"), ids)
    };
    String::from_utf8_lossy(forecasts).lines().map(line).collect()
}

#[test]
fn a_spare_takes_the_place_of_a_dead_tracker_with_its_tracks_and_of_a_sampler() {
    let scratch = Scratch::new("spares");
    let pipeline = pipeline(&scratch, &["tracker", "sampler"]);
    let (report, forecasts) = (scratch.path("report.json"), scratch.path("forecasts.jsonl"));
    let files = ["--pipeline", &pipeline, "--report", &report, "--forecasts", &forecasts];
    let run = Started::run(&[&files[..], &["--ticks", "150", "--agents", "6"]].concat());
    let root = run.wait_until_it_runs();
    let first = spare(&run, "tracker", None);
    spare(&run, "sampler", None);
    run.wait_until_it_forecasts();
    for stage in ["tracker", "sampler"] {
        run.signal_stage(stage, Signal::KILL);
    }
    // Another spare is warmed up. Its death changes nothing.
    let second = spare(&run, "tracker", Some(first));
    assert_eq!(processes(&run, "tracker")[0], first, "the spare is the stage now");
    kill_process(second, Signal::KILL).expect("the spare waits");
    spare(&run, "tracker", Some(second));

    let output = run.output();
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(stdout(&output).contains("SPARES"), "{}", stdout(&output));
    let errors = stderr(&output);
    let resumed = |line: &str| line.starts_with("sampler: ") && line.contains("restarted with ");
    assert!(errors.lines().any(resumed), "the sampler resumes with its state: {errors}");
    let report: Value = serde_json::from_slice(&scratch.read("report.json")).expect("JSON");
    let supervision = &report["supervision"];
    for (stage, deaths) in [("tracker", 1), ("sampler", 0)] {
        let spare = &supervision["spares"][stage];
        assert_eq!((&spare["promotions"], &spare["deaths"]), (&1.into(), &deaths.into()), "{supervision:#}");
    }
    let outages = supervision["outages"].as_array().expect("outages");
    assert_eq!(outages.len(), 2, "a spare's death is no outage: {outages:#?}");
    for outage in outages {
        assert_eq!(outage["by_spare"], true, "{outages:#?}");
        assert!(outage["ticks_to_learned"].is_u64(), "{outages:#?}");
    }
    for stage in report["stages"].as_array().expect("stages") {
        let expected = u64::from(stage["name"] == "tracker" || stage["name"] == "sampler");
        assert_eq!(stage["restarts"], expected, "{stage:#}");
    }

    // Agents that were already tracked keep their ids. New ids of the second tracker differ from all ids of
    // the first.
    let died = outages.iter().filter_map(|outage| outage["tick"].as_u64()).min().expect("a tick");
    let ticks = ids(&scratch.read("forecasts.jsonl"));
    let of = |range: std::ops::Range<u64>| -> BTreeSet<u64> {
        let ticks = ticks.iter().filter(|(seq, _)| range.contains(seq));
        ticks.flat_map(|(_, ids)| ids.iter().copied()).collect()
    };
    let (before, after) = (of(died.saturating_sub(5)..died), of(died + 15..died + 25));
    assert!(!before.is_empty() && before.iter().all(|id| *id < 1 << 40), "{before:?}");
    let kept = before.intersection(&after).count();
    assert!(2 * kept >= before.len(), "{kept} of {} ids are kept: {before:?}, {after:?}", before.len());
    assert_nothing_left(&root);
}

#[test]
fn no_spare_is_started_in_lockstep() {
    let scratch = Scratch::new("spares-lockstep");
    let pipeline = pipeline(&scratch, &["encoder"]);
    let report = scratch.path("report.json");
    let arguments = ["--speed", "max", "--ticks", "40", "--agents", "4", "--pipeline", &pipeline];
    let output = crate::started::run_well(&[&["run", "--report", &report][..], &arguments].concat());
    let report: Value = serde_json::from_slice(&scratch.read("report.json")).expect("JSON");
    assert_eq!(report["supervision"]["spares"]["encoder"]["state"], "waiting", "{}", stdout(&output));
    assert_eq!(report["supervision"]["spares"]["encoder"]["memory_kib"], 0);
}

#[test]
fn a_spare_of_a_stage_that_is_never_restarted_is_refused() {
    let scratch = Scratch::new("spares-never");
    let name = "name = \"encoder\"\n";
    let text = format!("{name}restart = \"never\"\nspare = true\n");
    let pipeline = scratch.pipeline("never.toml", name, &text);
    let output = crate::started::run(&["run", "--pipeline", &pipeline]);
    assert_eq!(output.status.code(), Some(78), "{}", stderr(&output));
    let told = stderr(&output);
    assert!(told.contains("never.toml:") && told.contains("would never take its place"), "{told}");
}
