//! Eclipse Cyclone DDS on the other side of the bridge (`tests/interop/ros2_bridge.py`), in a network
//! namespace.
//!
//! The tests need the program `stgdat` beside `stgdat-ros2`, `unshare` and `ip`, and a Python with PyPI's
//! `cyclonedds` and `mcap` (STGDAT_PYTHON names another interpreter). They print why they are skipped.

use std::path::Path;
use std::process::Command;
use std::sync::Mutex;

use serde_json::Value;

/// Two runs at once would delay each other.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

/// The findings of a scenario; `None`, with a printed note, if it can't be tried on this machine.
fn tried(scenario: &[&str]) -> Option<Value> {
    let _guard = ONE_AT_A_TIME.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    let bridge = Path::new(env!("CARGO_BIN_EXE_stgdat-ros2"));
    let programs = bridge.parent().expect("a program is in a folder");
    if !programs.join("stgdat").is_file() {
        println!("skipped: no stgdat in {}: build it with the same profile", programs.display());
        return None;
    }
    let python = std::env::var("STGDAT_PYTHON").unwrap_or_else(|_| "python3".into());
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/interop/ros2_bridge.py");
    let output = match Command::new(&python).arg(script).arg(programs).args(scenario).output() {
        Ok(output) => output,
        Err(error) => {
            println!("skipped: {python}: {error}");
            return None;
        }
    };
    let text = String::from_utf8_lossy(&output.stdout);
    if output.status.code() == Some(77) {
        println!("{text} (STGDAT_PYTHON names another interpreter)");
        return None;
    }
    assert!(output.status.success(), "{scenario:?}: {text}{}", String::from_utf8_lossy(&output.stderr));
    let line = text.lines().last().unwrap_or_default();
    Some(serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {text}")))
}

/// A busy machine loses messages, so a test asks for one at least.
fn has_answers(figures: &Value) -> bool {
    figures["answered"].as_u64().is_some_and(|answered| answered > 0)
}

#[test]
fn detections_of_cyclone_come_back_as_forecasts() {
    for count in [8, 32, 128] {
        let Some(found) = tried(&["round-trip", &count.to_string(), "4"]) else { return };
        assert!(has_answers(&found), "{found}");
        assert_eq!(found["objects"], count, "{found}");
        assert!(found["paths"].as_u64().is_some_and(|paths| (1..=3).contains(&paths)), "{found}");
        // The bridge publishes after the pipeline's forecasts, and before the slowest arrival at the reader.
        let ms = |of: &str| found[of].as_f64().unwrap_or(f64::NAN);
        assert!(ms("published_p50_ms") > ms("end_to_end_p50_ms"), "{found}");
        assert!(ms("published_p50_ms") <= ms("max_ms"), "{found}");
    }
}

#[test]
fn a_stopped_and_a_killed_reader_cost_the_others_nothing() {
    let Some(found) = tried(&["stopped-reader"]) else { return };
    for phase in ["both run", "one is stopped", "continued", "killed", "started again", "after", "again"] {
        assert!(has_answers(&found[phase]), "{phase}: {found}");
    }
}

#[test]
fn objects_are_moved_by_the_transform_at_their_stamp() {
    let Some(found) = tried(&["transforms"]) else { return };
    assert!(has_answers(&found), "{found}");
    // The previous transform would be off by 1.6 m.
    assert!(found["farthest_m"].as_f64().is_some_and(|far_m| far_m < 1.0), "{found}");
}

#[test]
fn tracked_objects_keep_their_identities() {
    let Some(found) = tried(&["tracked"]) else { return };
    // An identity of the input, marked as such: both halves, exclusive or.
    let expected = ["fc", "fd", "fe"].map(|end| format!("737467646174800100000000000000{end}"));
    assert_eq!(found["identities"], serde_json::json!(expected));
}

#[test]
fn a_killed_bridge_comes_back() {
    let Some(found) = tried(&["killed-bridge"]) else { return };
    for phase in ["before", "after the source was killed", "after the ros2 was killed"] {
        assert!(has_answers(&found[phase]), "{phase}: {found}");
    }
}

#[test]
fn a_running_pipeline_is_published_until_it_ends() {
    let Some(found) = tried(&["attached"]) else { return };
    assert_eq!(found["exit"], 0, "{found}");
    assert!(found["messages"].as_u64().is_some_and(|messages| messages > 0), "{found}");
}

#[test]
fn markers_reach_rviz_with_the_colours_of_the_causes() {
    let Some(found) = tried(&["markers"]) else { return };
    // Eight vehicles and two pedestrians: a box or a cylinder, a label, and up to three paths.
    assert_eq!(found["frames"], serde_json::json!(["map"]), "{found}");
    assert_eq!((&found["first"], &found["types"]), (&3.into(), &serde_json::json!([1, 3])), "{found}");
    assert_eq!((&found["counts"][0], &found["counts"][2]), (&10.into(), &10.into()), "{found}");
    assert!(
        (10..=30).contains(&found["counts"][1].as_u64().unwrap_or(0)) && found["pairs"] == true,
        "{found}"
    );
    assert_eq!(found["texts"], serde_json::json!(["pedestrian", "vehicle"]), "{found}");
    let hex = |[red, green, blue]: wire::vocabulary::Rgb| format!("{red:02x}{green:02x}{blue:02x}");
    let looks = wire::vocabulary::LOOKS.map(|look| hex(look.dark));
    let colors = found["colors"].as_array().expect("colours");
    assert!(!colors.is_empty(), "{found}");
    assert!(colors.iter().all(|color| looks.iter().any(|look| color == look)), "{found}");
}

#[test]
fn a_reader_in_another_domain_receives_nothing() {
    let Some(found) = tried(&["domains"]) else { return };
    assert!(has_answers(&found["same"]), "{found}");
    assert_eq!(found["other"], 0, "{found}");
}

/// Whether a list of lines, or a text, contains a text.
fn contains(found: &Value, text: &str) -> bool {
    found.to_string().replace("\\\"", "\"").contains(text)
}

#[test]
fn planners_and_monitors_receive_messages_during_silence() {
    let Some(found) = tried(&["silence"]) else { return };
    assert!(contains(&found["waiting"], "WAITING for input"), "{found}");
    // 8 s of silence. Diagnostics are sent each second, frames more often.
    assert!(found["frames"].as_u64().is_some_and(|frames| frames >= 16), "{found}");
    assert!(found["longest_gap_s"].as_f64().is_some_and(|gap_s| gap_s < 3.0), "{found}");
    assert_eq!(found["objects"].as_array().and_then(|objects| objects.last()), Some(&0.into()), "{found}");
    for of in ["tick", "input"] {
        assert!(contains(&found[of][1], "NO INPUT for "), "{found}");
    }
    assert!(found["input_messages"].as_u64().is_some_and(|messages| messages >= 4), "{found}");
    assert!(contains(&found["log"], "NO INPUT for"), "{found}");
    assert!(found["again"].as_u64().is_some_and(|again| again > 0), "{found}");
}

#[test]
fn publishers_that_do_not_fit_are_named_with_the_option_that_helps() {
    let Some(found) = tried(&["near-misses"]) else { return };
    for (of, option) in [
        ("qos", "set best_effort = true"),
        ("type", "set tracks = ["),
        ("namespace", ":=/car/objects\"]"),
        ("domain", "set domain = 7"),
    ] {
        assert!(contains(&found[of], option), "{of}: {found}");
    }
}

#[test]
fn a_simulated_clock_runs_at_any_rate_and_may_go_back() {
    for rate in ["0.5", "2"] {
        let Some(found) = tried(&["clock", rate]) else { return };
        let answered = found["answered"].as_array().expect("three rounds");
        assert!(answered.iter().all(|answered| answered.as_u64() >= Some(5)), "{found}");
        // The speed is the one of the stamps.
        let speeds = found["speeds"].as_array().expect("speeds");
        assert!(speeds.iter().all(|of| of.as_f64().is_some_and(|of| (of - 8.0).abs() < 1.5)), "{found}");
        assert!(found["diagnostics_s"][1].as_i64() <= Some(1_005), "{found}");
    }
}
