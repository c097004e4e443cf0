//! Inputs that look wrong: the findings of `inspect`, `predict`, `track` and `run`, and their exit codes.

use std::fmt::Write as _;
use testing::Scratch;

use crate::started::{run, run_well, stderr, stdout};

/// Two cars in two directions for 10 s. Headings are multiplied by `unit`, and stamps by `per_s`.
fn cars(scratch: &Scratch, name: &str, unit: f64, per_s: f64) -> String {
    let mut text = "stamp_s,id,type,x_m,y_m,heading_rad,speed_mps\n".to_owned();
    for step in 0..100 {
        let way_m = 0.8 * f64::from(step);
        let stamp = per_s * f64::from(step) / 10.0;
        let north = unit * std::f64::consts::FRAC_PI_2;
        let written =
            writeln!(text, "{stamp},1,vehicle,{way_m:.2},0,0,8\n{stamp},2,vehicle,5,{way_m:.2},{north:.4},8");
        written.expect("writing to a string does not fail");
    }
    scratch.file(name, text)
}

fn report(scratch: &Scratch, name: &str) -> serde_json::Value {
    serde_json::from_slice(&scratch.read(name)).expect("a report is JSON")
}

#[test]
fn headings_in_degrees_are_doubted_by_every_verb() {
    let scratch = Scratch::new("audit-degrees");
    let degrees = cars(&scratch, "degrees.csv", 57.29578, 1.0);
    let words = "headings look like degrees: divide them by 57.29578 (100 of 200 rows, 50.0 %; first: ";
    let inspected = stdout(&run_well(&["inspect", &degrees, "--out", &scratch.path("scene.svg")]));
    assert!(inspected.contains(&format!("{words}{degrees}:3)")), "{inspected}");
    assert!(inspected.ends_with(&format!("stgdat run --recording {degrees}\n")), "{inspected}");
    assert!(scratch.read("scene.svg").starts_with(b"<svg"));
    for verb in ["predict", "track"] {
        let file = scratch.path("report.json");
        let played = run_well(&[verb, &degrees, "--out", &scratch.path("out"), "--report", &file]);
        assert!(
            stderr(&played).contains(words) && stderr(&played).contains("DOUBTFUL"),
            "{}",
            stderr(&played)
        );
        let report = report(&scratch, "report.json");
        assert_eq!(report["verdict"]["status"], "doubtful");
        assert_eq!(report["input"]["findings"][0]["kind"], "headings_in_degrees");
        let strict = run(&[verb, &degrees, "--out", &scratch.path("out"), "--strict"]);
        assert_eq!(strict.status.code(), Some(65), "{}", stderr(&strict));
    }
    let file = scratch.path("run.json");
    let played = run(&["run", "--recording", &degrees, "--speed", "max", "--report", &file, "--strict"]);
    assert_eq!(played.status.code(), Some(65), "{}", stderr(&played));
    assert!(
        stdout(&played).contains(" DOUBTFUL    input: headings look like degrees"),
        "{}",
        stdout(&played)
    );
    let report = report(&scratch, "run.json");
    assert_eq!(report["verdict"]["status"], "doubtful");
    assert_eq!(report["input"]["findings"][0]["first"], format!("{degrees}:3"));
}

#[test]
fn a_clean_recording_is_ok_with_strict() {
    let scratch = Scratch::new("audit-clean");
    let clean = cars(&scratch, "clean.csv", 1.0, 1.0);
    let inspected = run_well(&["inspect", &clean, "--strict", "--json"]);
    let inspected: serde_json::Value = serde_json::from_str(&stdout(&inspected)).expect("JSON");
    assert_eq!(inspected["findings"], serde_json::json!([]));
    assert_eq!((&inspected["rows"], &inspected["types"][0]["agents"]), (&200.into(), &2.into()));
    let predicted = run_well(&["predict", &clean, "--out", &scratch.path("out"), "--strict"]);
    assert_eq!(stderr(&predicted), "");
}

#[test]
fn stamps_in_milliseconds_are_never_ok() {
    let scratch = Scratch::new("audit-ms");
    let milliseconds = cars(&scratch, "ms.csv", 1.0, 1e3);
    let file = scratch.path("report.json");
    let played = run_well(&["predict", &milliseconds, "--out", &scratch.path("out"), "--report", &file]);
    assert!(stderr(&played).contains("stamps look like milliseconds"), "{}", stderr(&played));
    let status = &report(&scratch, "report.json")["verdict"]["status"];
    assert!(["empty", "doubtful", "degraded"].contains(&status.as_str().expect("a word")), "{status}");
    assert_eq!(run(&["inspect", &milliseconds, "--strict"]).status.code(), Some(65));
}

/// Four cars for 60 s. From 41 s on, the noise of their positions is `factor` times 0.1 m.
fn noisy_cars(scratch: &Scratch, name: &str, factor: f64) -> String {
    // Sums of twelve numbers that are uniform within 0 and 1 have the variance 1.
    let mut state = 1_u64;
    let mut uniform = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    let mut normal = || (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
    let mut text = "stamp_s,id,type,x_m,y_m\n".to_owned();
    for (step, car) in (0..600).flat_map(|step| (1..=4).map(move |car| (step, car))) {
        let sigma_m = if step < 410 { 0.1 } else { 0.1 * factor };
        let [x_m, y_m] = [0.8 * f64::from(step), 20.0 * f64::from(car)].map(|at_m| at_m + sigma_m * normal());
        writeln!(text, "{:.1},{car},vehicle,{x_m:.3},{y_m:.3}", f64::from(step) / 10.0)
            .expect("writing to a string does not fail");
    }
    scratch.file(name, text)
}

/// The time at which the noise rose, by the only doubt in a report, and the reported noise of the vehicles.
fn noise(report: &serde_json::Value) -> (Option<f64>, f64) {
    let rose_s = match &report["findings"].as_array().expect("findings")[..] {
        [] => None,
        [found] => {
            assert_eq!((&found["kind"], &found["doubtful"]), (&"noise_changed".into(), &true.into()));
            let sentence = found["sentence"].as_str().expect("a sentence");
            let rest = sentence.strip_prefix("the position noise of vehicles rose from 0.").expect(sentence);
            let at = rest.split(" m at ").nth(1).and_then(|rest| rest.split(' ').next()).expect(sentence);
            Some(at.parse().expect(sentence))
        }
        more => panic!("{more:?}"),
    };
    let [vehicles] = &report["noise"].as_array().expect("noise")[..] else { panic!("{report}") };
    assert_eq!(vehicles["type"], "vehicle");
    (rose_s, vehicles["position_m"].as_f64().expect("a number"))
}

#[test]
fn noise_that_triples_is_doubted_by_inspect_predict_and_run() {
    let scratch = Scratch::new("audit-noise");
    for (factor, name) in [(1.0, "same"), (3.0, "worse")] {
        let cars = noisy_cars(&scratch, &format!("{name}.csv"), factor);
        let inspected = run_well(&["inspect", &cars, "--json"]);
        let inspected = serde_json::from_str(&stdout(&inspected)).expect("JSON");
        let shown = stdout(&run_well(&["inspect", &cars]));
        assert!(shown.contains("noise        vehicles 0."), "{shown}");

        let (out, file, recorded) =
            (scratch.path("out"), scratch.path("report.json"), scratch.path(&format!("{name}.mcap")));
        let predicted = run_well(&["predict", &cars, "--out", &out, "--report", &file]);
        assert!(stdout(&predicted).contains("noise: vehicles 0."), "{}", stdout(&predicted));
        let predicted = report(&scratch, "report.json");
        let run = ["run", "--recording", &cars, "--speed", "max", "--quiet", "--record", &recorded];
        run_well(&[&run[..], &["--report", &file]].concat());
        let played = report(&scratch, "report.json");

        for report in [&inspected, &predicted["input"], &played["input"]] {
            let (rose_s, position_m) = noise(report);
            assert!((position_m / (0.1 * factor) - 1.0).abs() < 0.2, "{position_m} m");
            assert_eq!(rose_s.is_some(), factor > 1.0);
            assert!(rose_s.is_none_or(|at_s| (39.0..45.0).contains(&at_s)), "{rose_s:?}");
        }
        assert_eq!(noise(&predicted["input"]), noise(&played["input"]));

        let replayed = stdout(&run_well(&["replay", &recorded]));
        assert!(replayed.contains("equal to the byte"), "{replayed}");
        assert!(replayed.contains("\nnoise: vehicles 0."), "{replayed}");
        assert_eq!(
            replayed.contains("\ndoubt: the position noise of vehicles rose"),
            factor > 1.0,
            "{replayed}"
        );
    }
}

/// Four agents for 10 s, with an id for each agent and frame.
fn agents(scratch: &Scratch, name: &str, id: impl Fn(u32, u32) -> u32) -> String {
    let mut text = "stamp_s,id,type,x_m,y_m\n".to_owned();
    for step in 0..100 {
        for (agent, (kind, speed_mps)) in
            (0..).zip([("vehicle", 9.0), ("vehicle", 7.0), ("cyclist", 4.0), ("pedestrian", 1.4)])
        {
            let (id, y_m) = (id(step, agent), 7 * agent);
            let x_m = speed_mps * f64::from(step) / 10.0 - 40.0;
            writeln!(text, "{:.1},{id},{kind},{x_m:.3},{y_m}", f64::from(step) / 10.0)
                .expect("writing to a string does not fail");
        }
    }
    scratch.file(name, text)
}

#[test]
fn ids_that_are_no_identities_are_ignored() {
    let scratch = Scratch::new("audit-identities");
    let (new, renewed) = (|step, agent| 4 * step + agent, |step, agent| 4 * (step / 3) + agent);
    let permuted = |step, agent| (3 * agent + 7 * step % 11) % 4;
    for (name, file) in [
        ("new", agents(&scratch, "new.csv", new)),
        ("renewed", agents(&scratch, "renewed.csv", renewed)),
        ("permuted", agents(&scratch, "permuted.csv", permuted)),
    ] {
        let path = scratch.path("report.json");
        let played = run_well(&["predict", &file, "--out", &scratch.path("out"), "--report", &path]);
        let words = "identities change while their agents continue";
        assert!(stderr(&played).contains(words), "{name}: {}", stderr(&played));
        let report = report(&scratch, "report.json");
        assert_eq!(report["verdict"]["status"], "doubtful", "{name}");
        let lines = std::fs::read_to_string(scratch.path("out")).expect("forecasts");
        let ids: Vec<Vec<u64>> = lines
            .lines()
            .map(|line| {
                let line: serde_json::Value = serde_json::from_str(line).expect("JSON");
                let agents = line["agents"].as_array().expect("an array").iter();
                agents.map(|agent| agent["id"].as_u64().expect("an id")).collect()
            })
            .collect();
        assert!(ids[50].len() == 4 && ids[50..].iter().all(|of| *of == ids[50]), "{name}: {ids:?}");
        let inspected = stdout(&run_well(&["inspect", &file]));
        assert!(inspected.contains(words), "{inspected}");
    }
    let good = stdout(&run_well(&["inspect", &agents(&scratch, "good.csv", |_, agent| agent)]));
    assert!(good.contains("all with identities") && good.contains("nothing looks wrong"), "{good}");
}
