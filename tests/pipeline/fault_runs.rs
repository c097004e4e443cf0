//! `stgdat fault`: the scenarios of `tests/faults` give the expected results, and mistakes and failures are
//! reported.

use serde_json::Value;
use testing::Scratch;

use crate::programs::example;
use crate::started::{run, run_well, stderr, stdout};

/// The shortest scenarios of each kind of fault. `stgdat fault run` runs the others.
const SHORT: [&str; 9] = [
    "02-kill-in-a-step",
    "04-broken-command",
    "07-drop",
    "08-duplicate",
    "09-bit-flip",
    "09-bit-flip-lockstep",
    "10-foreign",
    "11-frozen-content",
    "16-launcher-killed",
];

/// Runs a scenario without assertions on tick numbers, and returns its verdict. The scenario must pass.
fn verdict(scratch: &Scratch, name: &str) -> Value {
    let json = scratch.path("verdicts.json");
    let output = run(&["fault", "run", "--no-timing", "--json", &json, name]);
    assert_eq!(output.status.code(), Some(0), "{}{}", stdout(&output), stderr(&output));
    let verdicts: Vec<Value> = serde_json::from_slice(&scratch.read("verdicts.json")).expect("JSON");
    assert_eq!((verdicts.len(), verdicts[0]["name"].as_str()), (1, Some(name)));
    verdicts.into_iter().next().expect("one verdict")
}

#[test]
fn scenarios_meet_what_they_expect() {
    let scratch = Scratch::new("scenarios");
    for name in SHORT {
        let verdict = verdict(&scratch, name);
        assert_eq!(verdict["cost"]["unexplained"], 0, "{verdict:#}");
        let checks = verdict["checks"].as_array().expect("checks");
        for what in ["files left", "forecasts with a wrong age", "ticks that came twice or back in order"] {
            assert!(checks.iter().any(|check| check["what"] == what), "{what}: {verdict:#}");
        }
        if name == "07-drop" {
            let (lost, injected) =
                (&verdict["cost"]["lost"], &verdict["cost"]["injected"]["detections: drop"]);
            assert!(injected.as_u64() > Some(0) && lost.as_u64() >= injected.as_u64(), "{verdict:#}");
        }
    }
}

#[test]
fn a_failure_is_told_kept_and_repeatable() {
    let scratch = Scratch::new("failure");
    let spec = scratch.file(
        "wrong.toml",
        "shows = \"an expectation that is not met\"\n[run]\nticks = 20\nagents = 4\n[[fault]]\nkind = \"drop\"\n\
         topic = \"controls\"\nticks = [5, 9]\n[expect]\nexit_code = 70\n",
    );
    let (junit, keep) = (scratch.path("junit.xml"), scratch.path("keep"));
    let output =
        run(&["fault", "run", &spec, "--seed", "3", "--no-timing", "--junit", &junit, "--keep", &keep]);
    assert_eq!(output.status.code(), Some(70), "{}", stderr(&output));
    let text = stdout(&output);
    let again = format!("again: stgdat fault run {spec} --seed 3");
    assert!(text.contains("exit code") && text.contains("0 of 1 passed") && text.contains(&again), "{text}");
    let junit = String::from_utf8(scratch.read("junit.xml")).expect("UTF-8");
    assert!(junit.contains("failures=\"1\"") && junit.contains("exit code: 0, expected 70"), "{junit}");
    let history = String::from_utf8(scratch.read("keep/wrong-3/history.jsonl")).expect("UTF-8");
    let lines: Vec<Value> = history.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    let dropped: Vec<&Value> = lines.iter().filter_map(|line| line.get("injected")?.get("tick")).collect();
    assert_eq!(dropped, [5, 6, 7, 8, 9]);
    let history = scratch.path("keep/wrong-3/history.jsonl");
    let verified = run(&["fault", "verify", &history]);
    assert_eq!(verified.status.code(), Some(0), "{}{}", stdout(&verified), stderr(&verified));
    assert!(stdout(&verified).contains("     0  forecasts with a wrong age"), "{}", stdout(&verified));
    let text = String::from_utf8(scratch.read("keep/wrong-3/history.jsonl")).expect("UTF-8");
    let lie = scratch.file("lie.jsonl", text.replace("\"learned\"", "\"held\""));
    let found = run(&["fault", "verify", &lie]);
    assert_eq!(found.status.code(), Some(70), "{}", stdout(&found));
    for file in ["pipeline.toml", "report.json", "forecasts.jsonl", "log.txt", "inject-controls.json"] {
        scratch.read(&format!("keep/wrong-3/{file}"));
    }
}

/// An added stage outside the tick's path. Its program does not know this project.
#[test]
fn an_added_stage_is_the_target_of_signals_and_has_no_points() {
    let scratch = Scratch::new("added-faults");
    let shipped = include_str!("../../launch/pipeline.toml");
    let monitor = "\n[[stage]]\nname = \"monitor\"\ncommand = [\"sleep\", \"600\"]\nreads = [\"tracks\"]\n";
    scratch.file("p.toml", format!("{shipped}{monitor}"));
    let head = "shows = \"faults on a stage of the user's own\"\n[run]\nticks = 60\nagents = 4\npipeline = \"p.toml\"\n";
    let kill = "[[fault]]\nkind = \"kill\"\nstage = \"monitor\"\n";
    let expect =
        "[expect]\nlost_max = 0\noutages = [{ stage = \"monitor\", cause = \"signal 9\", count = 1 }]\n";
    let killed = scratch.file("killed.toml", format!("{head}{kill}at = 30\n{expect}"));
    let output = run(&["fault", "run", "--no-timing", &killed]);
    assert_eq!(output.status.code(), Some(0), "{}{}", stdout(&output), stderr(&output));
    let lacking = scratch.file("lacking.toml", format!("{head}{kill}at = 30\npoint = \"mid-write\"\n"));
    let output = run(&["fault", "run", "--no-timing", &lacking]);
    assert_eq!(output.status.code(), Some(70), "{}{}", stdout(&output), stderr(&output));
    let told = "the monitor has the point mid-write";
    assert!(stdout(&output).contains(told), "{}", stdout(&output));
    let unknown =
        scratch.file("unknown.toml", format!("{head}{}at = 30\n", kill.replace("monitor", "moniter")));
    let output = run(&["fault", "check", &unknown]);
    assert_eq!(output.status.code(), Some(78), "{}", stdout(&output));
    assert!(
        stderr(&output).contains("unknown.toml:8") && stderr(&output).contains("\"moniter\""),
        "{}",
        stderr(&output)
    );
}

/// The pipeline of these scenarios has the two added stages of the examples.
#[test]
fn faults_act_on_topics_that_the_pipeline_file_declares() {
    let scratch = Scratch::new("added-topics");
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
    let read = |path: &str| std::fs::read_to_string(format!("{root}/{path}")).expect("the repository has it");
    let mut pipeline = read("tests/examples/pipeline.toml");
    for program in ["speed_limiter", "conflict_monitor"] {
        pipeline = pipeline.replace(&format!("target/release/examples/{program}"), &example(program));
    }
    let pipeline = scratch.file("pipeline.toml", pipeline);
    let json = scratch.path("verdicts.json");
    let cost = |name: &str| {
        let text = read(&format!("tests/faults/added/{name}.toml"));
        let spec = scratch.file("spec.toml", text.replace("../../examples/pipeline.toml", &pipeline));
        let output = run(&["fault", "run", "--no-timing", "--json", &json, &spec]);
        assert_eq!(output.status.code(), Some(0), "{}{}", stdout(&output), stderr(&output));
        let verdicts: Value = serde_json::from_slice(&scratch.read("verdicts.json")).expect("JSON");
        verdicts[0]["cost"].clone()
    };
    let injected = |cost: &Value, kind: &str| cost["injected"][kind].as_u64().unwrap_or(0);
    let in_the_way = cost("19-added-topic-foreign");
    assert_eq!(injected(&in_the_way, "limited-tracks: old-incarnation"), 10, "{in_the_way:#}");
    let both = cost("19-added-topic");
    assert!(
        injected(&both, "limited-tracks: drop") > 0 && injected(&both, "approaches: bit-flip") == 11,
        "{both:#}"
    );
    for topic in ["limited-tracks", "approaches"] {
        assert!(both["injector_us"][topic][1].as_u64() > Some(0), "{topic}: {both:#}");
    }
}

#[test]
fn specifications_are_listed_and_checked() {
    let listed = stdout(&run_well(&["fault", "list"]));
    assert!(SHORT.iter().all(|name| listed.lines().any(|line| line.starts_with(name))), "{listed}");
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/faults");
    let checked = stdout(&run_well(&["fault", "check", folder]));
    assert_eq!(checked.lines().count(), listed.lines().count(), "{checked}");
    let scratch = Scratch::new("mistake");
    let spec =
        scratch.file("bad.toml", "shows = \"a mistake\"\n[run]\nticks = 9\n[[fault]]\nkind = \"kil\"\n");
    let output = run(&["fault", "check", &spec]);
    let text = stderr(&output);
    assert_eq!(output.status.code(), Some(78), "{text}");
    assert!(text.contains("bad.toml:5") && text.contains("unknown variant `kil`"), "{text}");
}
