//! Recorded runs: the content of the file, its replay, and no cost for the run.

use std::path::Path;
use std::time::{Duration, Instant};

use recording::{Happened, Message, Recording};
use rustix::process::Signal;
use safetensors::SafeTensors;
use testing::Scratch;

use crate::started::{Started, assert_nothing_left, piped, run, run_well, stderr, stdout, stgdat, wait_for};

/// Records a generated scene in lockstep, with all topics.
pub fn lockstep(scratch: &Scratch, name: &str, seed: &str) -> String {
    let file = scratch.path(name);
    let forecasts = scratch.path(&format!("{name}.jsonl"));
    let scene = ["run", "--ticks", "60", "--agents", "10", "--speed", "max", "--quiet", "--seed", seed];
    let record = ["--record", &file, "--record-topics", "all", "--forecasts", &forecasts];
    run_well(&[&scene[..], &record].concat());
    file
}

fn messages(path: &str) -> (Recording, Vec<Message>) {
    let recording = Recording::open(Path::new(path)).unwrap_or_else(|error| panic!("{error}"));
    let messages = recording.messages().collect::<Result<_, _>>().unwrap_or_else(|error| panic!("{error}"));
    (recording, messages)
}

/// The ticks of a topic in their order of arrival.
fn ticks(messages: &[Message], topic: &str) -> Vec<u64> {
    let frames = messages.iter().filter_map(|message| match message {
        Message::Frame(frame) if frame.topic().name == topic && frame.header().is_tick() => {
            Some(frame.header().seq)
        }
        _ => None,
    });
    frames.collect()
}

#[test]
fn a_lockstep_recording_replays_to_the_same_bytes() {
    let scratch = Scratch::new("record-lockstep");
    let file = lockstep(&scratch, "a.mcap", "3");
    let (recording, all) = messages(&file);
    assert!(recording.is_complete());
    recording.verify().unwrap_or_else(|error| panic!("{error}"));
    for topic in ["detections", "tracks", "context", "features", "encodings", "controls", "forecasts"] {
        assert_eq!(ticks(&all, topic), (0..60).collect::<Vec<_>>(), "{topic}");
    }
    let about = recording.about();
    assert!(about.run.lockstep && about.run.seed == 3 && about.pipeline.contains("[[stage]]"));
    let happened =
        |what: &Happened| all.iter().any(|m| matches!(m, Message::Event(event) if event.what == *what));
    assert!(happened(&Happened::Linked) && happened(&Happened::Ended { how: "done".to_owned() }));

    let replayed = run_well(&["replay", &file]);
    assert!(stdout(&replayed).contains("equal to the byte: 60 ticks"), "{}", stdout(&replayed));
    for stage in ["tracker", "localiser", "extractor", "encoder", "decoder", "sampler"] {
        let replayed = run_well(&["replay", &file, "--stage", stage]);
        assert!(stdout(&replayed).contains("equal to the byte: 60 ticks"), "{stage}: {}", stdout(&replayed));
    }
    let began = Instant::now();
    let paced = run_well(&["replay", &file, "--stage", "decoder", "--speed", "real"]);
    assert!(began.elapsed() >= 59 * Duration::from_millis(80), "60 ticks in {:?}", began.elapsed());
    let said = stdout(&paced);
    assert!(said.contains("in its own time") && said.contains("equal to the byte: 60 ticks"), "{said}");
    read_by_python(&file, &scratch.path("a.mcap.jsonl"), &["tracks 6", "forecasts 6", "events 2"]);
}

/// PyPI's `mcap` reads the file, if it is installed.
fn read_by_python(file: &str, forecasts: &str, lines: &[&str]) {
    python("read_mcap.py", &[file, forecasts], lines);
}

/// Runs a script of tests/interop, if the packages that it needs are installed.
fn python(script: &str, arguments: &[&str], lines: &[&str]) {
    let python = std::env::var("STGDAT_PYTHON").unwrap_or_else(|_| "python3".into());
    let script = format!("{}/../tests/interop/{script}", env!("CARGO_MANIFEST_DIR"));
    let output = match piped(&python).arg(script).args(arguments).output() {
        Ok(output) => output,
        Err(error) => return testing::skip(format_args!("{python}: {error}")),
    };
    let said = stdout(&output);
    if output.status.code() == Some(77) {
        return testing::skip(format_args!("{} (STGDAT_PYTHON names another interpreter)", said.trim_end()));
    }
    assert!(output.status.success(), "{said}{}", stderr(&output));
    for line in lines.iter().chain(&["different: none"]) {
        assert!(said.contains(line), "no {line:?}: {said}");
    }
}

#[test]
fn other_tools_read_the_published_numbers_in_a_recording() {
    let scratch = Scratch::new("record-for");
    let [file, exported, scene, lines] =
        ["a.mcap", "ros.mcap", "both.mcap", "a.jsonl"].map(|n| scratch.path(n));
    let scene_of = ["--ticks", "60", "--agents", "8", "--seed", "3", "--speed", "max", "--quiet"];
    let record = ["--record", &file, "--for", "autoware", "--forecasts", &lines];
    run_well(&[&scene_of[..], &record].concat());
    let replayed = run_well(&["replay", &file]);
    assert!(stdout(&replayed).contains("equal to the byte: 60 ticks"), "{}", stdout(&replayed));
    run_well(&["export", &file, &exported, "--for", "autoware", "--paths", "20"]);
    run_well(&["export", &file, &scene, "--for", "foxglove,autoware"]);
    let bytes = std::fs::read(&exported).expect("the exported file");
    let whole = recording::bag_messages(&bytes, |message| {
        assert_eq!(message.encoding, "cdr", "{}", message.topic);
        Ok::<(), String>(())
    });
    assert_eq!(whole, Ok(recording::Damage::default()));

    let objects = "/perception/object_recognition/objects 60";
    let of_ros = [objects, "/perception/object_recognition/tracking/objects 60", "/tf 60", "/diagnostics 60"];
    for file in [&file, &exported] {
        python("read_views.py", &[file, &lines, "rosbags"], &[&of_ros[..], &["rosbags"]].concat());
        python("cdr_by_cyclonedds.py", &[file], &of_ros);
    }
    python("read_views.py", &[&scene, &lines], &of_ros);
    python("read_scene.py", &[&scene, &lines], &["foxglove.SceneUpdate 60", "foxglove.FrameTransforms 60"]);

    // The scene needs the tracks and forecasts, which are recorded with it.
    let [small, lines] = ["small.mcap", "small.jsonl"].map(|n| scratch.path(n));
    let record =
        ["--record", &small, "--record-topics", "events", "--for", "foxglove", "--forecasts", &lines];
    run_well(&[&scene_of[..], &record].concat());
    python("read_scene.py", &[&small, &lines], &["foxglove.SceneUpdate 60"]);
    let bare = scratch.path("bare.mcap");
    run_well(&[&scene_of[..], &["--record", &bare, "--record-topics", "detections"]].concat());
    let without = run(&["export", &bare, &scratch.path("none.mcap"), "--for", "autoware"]);
    assert!(!without.status.success() && stderr(&without).contains("forecasts"), "{}", stderr(&without));

    let again = run(&["export", &file, &exported, "--for", "foxglove"]);
    assert!(!again.status.success() && stderr(&again).contains("--force"), "{}", stderr(&again));
    run_well(&["export", &file, &exported, "--for", "foxglove", "--force"]);
    let itself = run(&["export", &file, &file, "--for", "foxglove", "--force"]);
    assert!(stderr(&itself).contains("can't be exported to itself"), "{}", stderr(&itself));
    let without = run(&["--ticks", "9", "--quiet", "--for", "foxglove"]);
    assert!(!without.status.success() && stderr(&without).contains("--record FILE"), "{}", stderr(&without));
}

#[test]
fn two_runs_of_a_seed_are_equal_and_of_two_seeds_differ() {
    let scratch = Scratch::new("record-diff");
    let [a, b, other] =
        [("a.mcap", "3"), ("b.mcap", "3"), ("c.mcap", "4")].map(|(n, s)| lockstep(&scratch, n, s));
    let same = run_well(&["diff", &a, &b]);
    assert!(stdout(&same).contains("equal to the byte: 60 ticks"), "{}", stdout(&same));
    let different = run(&["diff", &a, &other]);
    assert_eq!(different.status.code(), Some(1), "{}", stderr(&different));
    let text = stdout(&different);
    assert!(text.contains("the runs differ in seed: 3 and 4"), "{text}");
    assert!(text.contains("first difference: tick 0, detections"), "{text}");
}

#[test]
fn a_run_with_a_stopped_stage_replays_to_the_same_bytes() {
    let scratch = Scratch::new("record-stop");
    let file = scratch.path("stop.mcap");
    let started = Started::run(&["--ticks", "150", "--agents", "8", "--quiet", "--record", &file]);
    // Before the first tick a new decoder would cost none.
    let root = started.wait_until_it_forecasts();
    started.signal_stage("decoder", Signal::STOP);
    std::thread::sleep(std::time::Duration::from_millis(600));
    // If the decoder was not killed and restarted meanwhile, it continues.
    started.signal_stage("decoder", Signal::CONT);
    let output = started.output();
    assert!(output.status.success(), "{}", stderr(&output));
    assert_nothing_left(&root);
    let (_, all) = messages(&file);
    let not_learned = all.iter().filter(|message| match message {
        Message::Frame(frame) if frame.topic().name == "forecasts" && frame.header().is_tick() => {
            frame.header().hop(wire::StageId::Decoder).is_none()
        }
        _ => false,
    });
    assert!(not_learned.count() >= 1, "the stop cost ticks their controls");
    let replayed = run(&["replay", &file]);
    let text = stdout(&replayed);
    assert!(text.contains("equal to the byte: "), "{text}{}", stderr(&replayed));
}

/// The embedded weights with the first number of a tensor changed.
fn with_another_number(tensor: &str) -> Vec<u8> {
    let mut bytes = include_bytes!("../../shared/weights/onboard.safetensors").to_vec();
    let file = SafeTensors::deserialize(&bytes).expect("the embedded weights are safetensors");
    let data = file.tensor(tensor).expect("there is such a tensor").data();
    let at = data.as_ptr().addr() - bytes.as_ptr().addr();
    let number = f32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"));
    bytes[at..at + 4].copy_from_slice(&(number + 0.5).to_le_bytes());
    bytes
}

#[test]
fn one_other_weight_is_found_in_recordings_and_in_reports() {
    let scratch = Scratch::new("record-weights");
    let other = scratch.file("other.safetensors", with_another_number("decoder.vehicle.head.bias"));
    let play = |name: &str, arguments: &[&str]| {
        let [file, report] = ["mcap", "json"].map(|kind| scratch.path(&format!("{name}.{kind}")));
        let scene = ["run", "--ticks", "110", "--agents", "12", "--speed", "max", "--quiet"];
        let write = ["--record", &file, "--record-topics", "all", "--report", &report];
        run_well(&[&scene[..], &write, arguments].concat());
        (file, report)
    };
    let (a, report_a) = play("a", &[]);
    let (b, report_b) = play("b", &["--weights", &other]);
    let different = run(&["diff", &a, &b]);
    assert_eq!(different.status.code(), Some(1), "{}", stderr(&different));
    let text = stdout(&different);
    assert!(text.contains("the runs differ in weights: "), "{text}");
    let first = text.lines().find(|line| line.starts_with("first difference: ")).expect("there is one");
    assert!(first.contains(", controls["), "the decoder is the first stage that knows it: {first}");
    let refused = run(&["diff", &a, &report_b]);
    assert_eq!(refused.status.code(), Some(2), "{}", stdout(&refused));

    let different = run(&["diff", &report_a, &report_b]);
    assert_eq!(different.status.code(), Some(1), "{}", stderr(&different));
    let text = stdout(&different);
    assert!(text.contains("the runs differ in weights: ") && text.contains("minFDE (K = 20), m"), "{text}");
    let [first_agent, ..] = &text
        .lines()
        .skip_while(|line| !line.contains("worst forecast of the worse run"))
        .skip(1)
        .collect::<Vec<_>>()[..]
    else {
        panic!("no agent: {text}")
    };
    assert!(first_agent.contains(" vehicle ") && first_agent.contains(": tick "), "{first_agent}");
    let json = run(&["diff", &report_a, &report_b, "--json"]);
    let json: serde_json::Value = serde_json::from_slice(&json.stdout).expect("JSON");
    assert_eq!(json["same_scene"], true);
    assert!(json["agents"][0]["b"]["worst"]["tick"].is_u64(), "{json}");
    let same = run_well(&["diff", &report_a, &report_a]);
    assert!(stdout(&same).contains("equal but for the clock"), "{}", stdout(&same));
}

#[test]
fn a_run_with_a_kill_is_recorded_and_the_next_tool_finds_it_by_itself() {
    let scratch = Scratch::new("record-kill");
    let file = scratch.path("kill.mcap");
    let forecasts = scratch.path("kill.jsonl");
    let scene = ["--ticks", "150", "--agents", "8", "--quiet", "--record", &file, "--forecasts", &forecasts];
    let started = Started::run(&scene);
    let root = started.wait_until_it_runs();
    let late = scratch.path("late.mcap");
    let name =
        root.file_name().and_then(|name| name.to_str()).expect("a run's directory has a name").to_owned();
    let recorded =
        run_well(&["record", &late, "--run", &name, "--topics", "forecasts,events", "--seconds", "2"]);
    assert!(stdout(&recorded).contains("MB/s"), "{}", stdout(&recorded));
    started.signal_stage("encoder", Signal::KILL);
    let output = started.output();
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stdout(&output).contains("kill.mcap: "), "the file is told: {}", stdout(&output));
    assert_nothing_left(&root);

    let (recording, all) = messages(&late);
    assert!(recording.is_complete() && !ticks(&all, "forecasts").is_empty());
    assert!(ticks(&all, "detections").is_empty());
    let (recording, all) = messages(&file);
    assert!(recording.is_complete());
    assert_eq!(ticks(&all, "detections").len(), 150);
    let died = all.iter().any(|message| {
        matches!(message, Message::Event(event) if matches!(&event.what, Happened::Died { stage, .. } if stage == "encoder"))
    });
    assert!(died);
    // The recording contains all results that depended on the clock, including the killed encoder's ticks.
    let replayed = run(&["replay", &file]);
    let text = stdout(&replayed);
    assert!(text.contains("equal to the byte: 150 ticks"), "{text}{}", stderr(&replayed));
    assert!(text.contains("forecasts without their controls"), "{text}");
    let refused = run(&["replay", &file, "--stage", "tracker"]);
    assert!(stderr(&refused).contains("topic \"forecasts\" was not recorded, or without a part"), "{text}");
    read_by_python(&file, &forecasts, &["detections 1", "forecasts 1"]);
}

/// The sampler is killed three times: while it writes a frame, after it has sent a frame but before it has
/// committed its learned state, and right after the first frame since that restart.
#[test]
fn a_killed_sampler_goes_on_with_what_it_had_learned_and_so_does_the_replay() {
    let scratch = Scratch::new("record-sampler");
    let file = scratch.path("sampler.mcap");
    let points = "sampler:mid-write@110,sampler:before-notify@140,sampler:after-send@141";
    let mut command = stgdat();
    command.env(ports::POINTS_VARIABLE, points).args(["run", "--ticks", "200", "--agents", "8"]);
    let started = Started::spawn(command.args(["--quiet", "--record", &file, "--record-topics", "all"]));
    let root = started.wait_until_it_runs();
    let output = started.output();
    assert!(output.status.success(), "{}", stderr(&output));
    let told = stderr(&output);
    let resumed: Vec<[u64; 3]> = told
        .lines()
        .filter_map(|line| {
            let numbers = line.split_once("restarted with")?.1;
            let numbers = numbers.split(|c: char| !c.is_ascii_digit()).filter_map(|n| n.parse().ok());
            numbers.collect::<Vec<_>>().try_into().ok()
        })
        .collect();
    let [[entries, matured, tick], .., [later_entries, later_matured, later_tick]] = resumed[..] else {
        panic!("it is not told: {told}")
    };
    assert!(entries > 50 && matured > 5 && (90..110).contains(&tick), "{told}");
    assert!(later_entries > entries && later_matured > 5 && later_tick >= 138, "{told}");
    assert_eq!(resumed.len(), 3, "{told}");
    assert_nothing_left(&root);

    let (_, all) = messages(&file);
    let mut began: Vec<(u32, u32)> = all
        .iter()
        .filter_map(|message| match message {
            Message::Frame(frame) if frame.topic().name == "forecasts" && frame.header().is_tick() => {
                Some((frame.header().incarnation, frame.header().resumed_ticks))
            }
            _ => None,
        })
        .collect();
    began.dedup();
    let expected: Vec<_> = resumed.iter().map(|[_, _, tick]| *tick as u32 + 1).collect();
    assert_eq!(began, [(0, 0), (1, expected[0]), (2, expected[1]), (3, expected[2])], "as of which tick");
    for arguments in [&["replay", &file][..], &["replay", &file, "--stage", "sampler"]] {
        let replayed = run(arguments);
        let text = stdout(&replayed);
        assert!(text.contains("equal to the byte: 200 ticks"), "{text}{}", stderr(&replayed));
    }
}

#[test]
fn a_recording_that_is_killed_is_readable_and_the_run_goes_on() {
    let scratch = Scratch::new("record-killed");
    let file = scratch.path("killed.mcap");
    let started = Started::run(&["--ticks", "120", "--agents", "6", "--quiet"]);
    let root = started.wait_until_it_runs();
    let record = ["record", &file, "--run", &root.display().to_string()];
    let recorder = Started::spawn(crate::started::stgdat().args(record));
    wait_for("nothing is recorded", || {
        let recording = Recording::open(Path::new(&file)).ok()?;
        let len = recording.messages().flatten().count();
        (len > 20).then_some(())
    });
    recorder.signal(Signal::KILL);
    drop(recorder.output());
    let (recording, all) = messages(&file);
    assert!(!recording.is_complete() && !all.is_empty());
    let refused = run(&["record", &file, "--run", &root.display().to_string()]);
    assert!(stderr(&refused).contains("not replaced"), "{}", stderr(&refused));
    let output = started.output();
    assert!(output.status.success(), "{}", stderr(&output));
    let shown = run(&["replay", &file]);
    assert!(stdout(&shown).contains("INCOMPLETE"), "{}", stdout(&shown));
}

#[test]
fn a_mark_names_the_recording_that_has_it_or_fails() {
    let scratch = Scratch::new("record-mark");
    let scene = ["--ticks", "250", "--agents", "3", "--quiet"];
    let [started, other] = [Started::run(&scene), Started::run(&scene)];
    let [root, _] = [started.wait_until_it_runs(), other.wait_until_it_runs()];
    let root = root.display().to_string();
    let refused = |arguments: &[&str], why: &str| {
        let output = run(arguments);
        assert!(!output.status.success() && stdout(&output).is_empty(), "{}", stdout(&output));
        assert!(stderr(&output).contains(why), "{}", stderr(&output));
    };
    refused(&["mark", "now"], "runs are running: name one with --run; running: stgdat_");
    refused(&["mark", "now", "--run", &root], "no recording with events is made of stgdat_");
    let [tracks, all] = ["tracks.mcap", "all.mcap"].map(|name| scratch.path(name));
    let recorders = [("tracks", &tracks), ("tracks,events", &all)].map(|(topics, file)| {
        let record = ["record", file, "--run", &root, "--topics", topics];
        let recorder = Started::spawn(crate::started::stgdat().args(record));
        wait_for("nothing is recorded", || {
            let recording = Recording::open(Path::new(file)).ok()?;
            recording.messages().flatten().next().map(drop)
        });
        recorder
    });
    let marked = stdout(&run_well(&["mark", "a cyclist", "--run", &root]));
    let place = marked.strip_prefix(&format!("marked {} at tick ", root.trim_start_matches("/tmp/")));
    let (tick, file) = place.and_then(|place| place.trim_end().split_once(" in ")).expect(&marked);
    assert_eq!(file, all, "the other recording has no events");
    for process in [started, other].into_iter().chain(recorders) {
        let output = process.output();
        assert!(output.status.success(), "{}", stderr(&output));
    }
    let (_, all) = messages(&all);
    let is_mark = |message: &Message| {
        let what = Happened::Mark { text: "a cyclist".to_owned() };
        matches!(message, Message::Event(event) if event.what == what)
    };
    let place = all.iter().position(is_mark).expect("the mark is in the file");
    let newest = ticks(&all[..place], "tracks").into_iter().max().expect("ticks before the mark");
    let tick: u64 = tick.parse().expect("a number");
    assert!(newest.abs_diff(tick) <= 2, "{newest} recorded before the mark at {tick}");
}

#[test]
fn a_flight_recorder_that_comes_late_says_what_it_does_not_know() {
    let scratch = Scratch::new("record-late");
    let file = scratch.path("late.mcap");
    let started = Started::run(&["--ticks", "120", "--agents", "6", "--quiet"]);
    let name = started.wait_until_it_runs().display().to_string();
    // The first ticks pass without the recording.
    let early = scratch.path("early.mcap");
    run_well(&["record", &early, "--run", &name, "--topics", "detections", "--seconds", "1.5"]);
    assert!(!ticks(&messages(&early).1, "detections").is_empty());
    let record = ["record", &file, "--run", &name, "--last", "1s", "--after", "1s", "--files", "1"];
    let descriptors = started.descriptors("tap");
    let recorder = Started::spawn(crate::started::stgdat().args(record));
    wait_for("the tap has no further tool", || (started.descriptors("tap") > descriptors).then_some(()));
    run_well(&["mark", "now", "--run", &name]);
    assert!(started.output().status.success());
    let output = recorder.output();
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stdout(&output).contains("the run had begun before"), "{}", stdout(&output));
    let replayed = run(&["replay", &scratch.path("late-1.mcap")]);
    let text = stdout(&replayed);
    assert!(text.contains("the tracks are taken from the record"), "{text}{}", stderr(&replayed));
    assert!(!text.contains("before the file were replayed"), "{text}");
    let ends = ["agrees from tick", "equal to the byte", "equal where both", "apart"];
    assert!(ends.iter().any(|told| text.contains(told)), "{text}");
}

#[test]
fn a_flight_recorder_writes_what_came_before_a_restart_and_a_mark() {
    let scratch = Scratch::new("record-flight");
    let file = scratch.path("flight.mcap");
    let ring = ["--last", "0.5s", "--after", "1s", "--files", "3"];
    let scene = ["--ticks", "200", "--agents", "8", "--quiet", "--record", &file];
    let started = Started::run(&[&scene[..], &ring].concat());
    // There are ticks before the file only if the event comes after the first ticks.
    let root = started.wait_until_it_forecasts();
    let name = root.display().to_string();
    started.signal_stage("encoder", Signal::KILL);
    let first = scratch.path("flight-1.mcap");
    // The first event is a degraded tick or the death. Its file ends after its time.
    wait_for("no file is finished", || {
        Recording::open(Path::new(&first)).ok().filter(Recording::is_complete).map(drop)
    });
    run_well(&["mark", "a cyclist", "--run", &name]);
    let output = started.output();
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(
        stderr(&output)
            .contains("keeping the last 0.5 s in memory, at most 512 MiB, and 128 MiB of what was before"),
        "{}",
        stderr(&output)
    );
    assert!(stdout(&output).contains("flight-1.mcap: "), "{}", stdout(&output));
    assert!(!Path::new(&file).exists(), "only numbered files");

    let kept = |path: &str| {
        let (recording, all) = messages(path);
        assert!(recording.is_complete());
        recording.verify().unwrap_or_else(|error| panic!("{error}"));
        let whys = all.iter().filter_map(|message| match message {
            Message::Event(event) => match &event.what {
                Happened::Kept { why } => Some((event.at_ns, why.clone())),
                _ => None,
            },
            _ => None,
        });
        let whys: Vec<(u64, String)> = whys.collect();
        (all, whys)
    };
    let marked = (1..=3).map(|number| scratch.path(&format!("flight-{number}.mcap")));
    let marked = marked.filter(|path| Path::new(path).exists()).map(|path| (kept(&path), path));
    let ((all, whys), path) = marked
        .into_iter()
        .find(|((_, whys), _)| whys.iter().any(|(_, why)| why == "mark: a cyclist"))
        .expect("the mark has a file");
    let (_, first_whys) = kept(&first);
    assert!(!first_whys.is_empty());
    let (at_ns, _) = whys.iter().find(|(_, why)| why == "mark: a cyclist").expect("it was found");
    let times: Vec<u64> = all.iter().map(Message::at_ns).collect();
    let (begin_ns, end_ns) = (times.iter().min().expect("messages"), times.iter().max().expect("messages"));
    assert!(at_ns - begin_ns <= 7_000_000_000, "a ring of 0.5 s, a file of six times 1 s at most");
    assert!(at_ns - begin_ns > 200_000_000 && end_ns >= at_ns, "what came before is there");
    // The stages' state comes from the ticks before the file, including the killed encoder's.
    let replayed = run(&["replay", &path]);
    let text = stdout(&replayed);
    assert!(text.contains(" ticks before the file were replayed first"), "{text}{}", stderr(&replayed));
    assert!(!text.contains("they differ from tick"), "{text}");
    assert!(text.contains("equal to the byte: "), "{text}");
    let taken = run(&[&["run"], &scene[..], &ring].concat());
    assert!(!taken.status.success() && stderr(&taken).contains("not replaced"), "{}", stderr(&taken));
}
