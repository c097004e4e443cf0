use run::{Conflict, Declaration, Declared, NoOptions, TopicRun};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wire::{
    ContextTopic, ControlsTopic, DetectionsTopic, EncodingsTopic, FeaturesTopic, ForecastsTopic, Topic,
    TracksTopic, TruthTopic,
};

use super::*;

const FULL: &str = include_str!("../../../pipeline.toml");

/// Options of the extractor and the decoder.
#[derive(Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
struct Shared {
    /// Threads.
    #[schemars(range(min = 1, max = 64))]
    workers: usize,
}

/// Options of the sampler.
#[derive(Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
struct OfSampler {
    /// Time to wait.
    #[schemars(range(max = 80.0), extend("exclusiveMinimum" = 0.0))]
    deadline_ms: f64,
    /// Whether.
    retrieval: Option<bool>,
    /// Where.
    memory: Option<String>,
    /// How.
    propagation: Propagation,
}

#[derive(Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Propagation {
    #[default]
    Linearised,
    MonteCarlo,
}

impl OfSampler {
    fn check(&self) -> Result<(), Conflict> {
        let unused = self.retrieval == Some(false) && self.memory.is_some();
        let (key, reason, because) = ("memory", "a memory for nothing", "`retrieval` is false");
        if unused { Err(Conflict { key, reason, because }) } else { Ok(()) }
    }
}

const SOURCE: Declaration<NoOptions> =
    Declaration::new(StageId::Source, &[], &[DetectionsTopic::NAME, TruthTopic::NAME]);
const TRACKER: Declaration<NoOptions> =
    Declaration::new(StageId::Tracker, &[DetectionsTopic::NAME, ForecastsTopic::NAME], &[TracksTopic::NAME]);
const LOCALISER: Declaration<NoOptions> =
    Declaration::new(StageId::Localiser, &[TracksTopic::NAME], &[ContextTopic::NAME]);
const EXTRACTOR: Declaration<Shared> =
    Declaration::new(StageId::Extractor, &[ContextTopic::NAME], &[FeaturesTopic::NAME]);
const ENCODER: Declaration<NoOptions> =
    Declaration::new(StageId::Encoder, &[FeaturesTopic::NAME], &[EncodingsTopic::NAME]);
const DECODER: Declaration<Shared> =
    Declaration::new(StageId::Decoder, &[EncodingsTopic::NAME], &[ControlsTopic::NAME]);
const SAMPLER: Declaration<OfSampler> =
    Declaration::new(StageId::Sampler, &[TracksTopic::NAME, ControlsTopic::NAME], &[ForecastsTopic::NAME])
        .with_rule(OfSampler::check);
const RECORDER: Declaration<NoOptions> =
    Declaration::new(StageId::Recorder, &[ForecastsTopic::NAME, TruthTopic::NAME], &[]);

/// Stages with the topics of the real stages and some options.
const STAGES: [&dyn Declared; 8] =
    [&SOURCE, &TRACKER, &LOCALISER, &EXTRACTOR, &ENCODER, &DECODER, &SAMPLER, &RECORDER];

fn parsed(text: &str) -> Pipeline {
    Pipeline::parse("pipeline.toml", text, &STAGES).unwrap()
}

fn stage(pipeline: &Pipeline, id: StageId) -> &Stage {
    pipeline.stages.iter().find(|stage| stage.id == id).unwrap()
}

fn error(text: &str) -> String {
    let error = Pipeline::parse("pipeline.toml", text, &STAGES).expect_err("the text is faulty");
    error.report(true, false)
}

/// The shipped file with one text replaced. The replaced text must exist.
fn with(from: &str, to: &str) -> String {
    assert!(FULL.contains(from), "the shipped pipeline.toml has no {from:?}");
    FULL.replacen(from, to, 1)
}

/// The shipped file with further lines of a stage.
fn of(stage: &str, lines: &str) -> String {
    let name = format!("name = \"{stage}\"\n");
    with(&name, &format!("{name}{lines}\n"))
}

#[test]
fn a_stage_has_the_topics_of_its_declaration_unless_the_file_lists_others() {
    let plain = parsed(FULL);
    let listed = parsed(&of("sampler", "reads = [\"tracks\", \"controls\"]\nwrites = [\"forecasts\"]"));
    assert_eq!(listed.edges(), plain.edges());
    let command = parsed(&of("localiser", "command = [\"./mine\"]"));
    assert_eq!(command.edges(), plain.edges());
    let lines = "command = [\"./mine\"]\nreads = [\"tracks\", \"detections\"]\nwrites = [\"context\"]";
    assert_eq!(parsed(&of("localiser", lines)).edges().len(), plain.edges().len() + 1);
}

#[test]
fn the_shipped_file_is_accepted() {
    let pipeline = parsed(FULL);
    assert_eq!(pipeline.stages.iter().map(|s| s.id).collect::<Vec<_>>(), StageId::ALL);
    let edges = pipeline.edges();
    assert!(edges.contains(&(StageId::Sampler, "forecasts", StageId::Tracker)));
    assert_eq!(edges.len(), 10);
    for (stage, declared) in pipeline.stages.iter().zip(STAGES) {
        assert!(stage.reads == declared.reads() && stage.writes == declared.writes(), "{stage:?}");
    }
    assert!(pipeline.warnings.is_empty());
    assert!(pipeline.stages.iter().all(|stage| stage.places.keys().eq(stage.options.keys())));
}

#[test]
fn processors_may_sleep_unless_the_file_has_them_awake() {
    assert!(!parsed(FULL).realtime.awake);
    assert!(parsed(&format!("awake = true\n{FULL}")).realtime.awake);
}

#[test]
fn places_for_readers_are_added_to_topics_that_exist() {
    assert!(parsed(FULL).readers.is_empty());
    let added = parsed(&format!("readers = {{ forecasts = 4, tracks = 1 }}\n{FULL}")).readers;
    assert_eq!(added, [("forecasts".to_owned(), 4), ("tracks".to_owned(), 1)].into());
    let refused = |readers: &str| error(&format!("readers = {readers}\n{FULL}"));
    assert!(refused("{ forecast = 4 }").contains("unknown topic \"forecast\""));
    for number in ["0", "65", "5000000000"] {
        let refused = refused(&format!("{{ forecasts = {number} }}"));
        assert!(refused.contains("expected 1 to 64") && refused.contains("pipeline.toml:1:"), "{refused}");
    }
    assert!(refused("{ forecasts = -1 }").contains("pipeline.toml:1:"));
    assert!(refused("4").contains("invalid type"));
}

#[test]
fn load_is_shed_unless_the_file_forbids_it_and_late_controls_are_warned_of() {
    assert!(parsed(FULL).shed);
    let never = format!("shed = false\n{FULL}");
    assert!(!parsed(&never).shed);
    let hasty = |text: &str| parsed(&text.replacen("deadline_ms = 72", "deadline_ms = 60", 1)).warnings;
    assert_eq!(hasty(&never), Vec::<String>::new(), "nothing is served until a deadline");
    let warnings = hasty(FULL);
    assert!(
        warnings.len() == 1 && warnings[0].contains("add up to 66 ms, its deadline_ms is 60"),
        "{warnings:?}"
    );
}

#[test]
fn one_line_swaps_a_stage() {
    let text = with("name = \"encoder\"", "name = \"encoder\"\ncommand = [\"./mine\", \"--fast\"]");
    let pipeline = parsed(&text);
    let encoder = stage(&pipeline, StageId::Encoder);
    assert_eq!(encoder.command.as_deref(), Some(&["./mine".to_owned(), "--fast".to_owned()][..]));
}

#[test]
fn unknown_key() {
    insta::assert_snapshot!(error(&with(
        "[[stage]]\nname = \"encoder\"",
        "[[stage]]\nurgency = 3\nname = \"encoder\""
    )));
}

#[test]
fn syntax() {
    insta::assert_snapshot!(error("[[stage]\nname = 3"));
}

#[test]
fn unknown_stage() {
    insta::assert_snapshot!(error(&with("\"encoder\"", "\"enkoder\"")));
}

#[test]
fn unknown_topic() {
    insta::assert_snapshot!(error(&of("encoder", "reads = [\"feature\"]")));
}

#[test]
fn duplicate_stage() {
    insta::assert_snapshot!(error(&format!(
        "{FULL}\n[[stage]]\nname = \"recorder\"\nreads = [\"forecasts\", \"truth\"]\n"
    )));
}

#[test]
fn two_producers() {
    let lines = "command = [\"./mine\"]\nreads = [\"features\"]\nwrites = [\"encodings\", \"tracks\"]";
    insta::assert_snapshot!(error(&of("encoder", lines)));
}

#[test]
fn missing_producer() {
    let start = FULL.find("[[stage]]\nname = \"encoder\"").unwrap();
    let end = FULL.find("[[stage]]\nname = \"decoder\"").unwrap();
    insta::assert_snapshot!(error(&format!("{}{}", &FULL[..start], &FULL[end..])));
}

#[test]
fn wrong_topics_of_a_built_in_stage() {
    insta::assert_snapshot!(error(&of(
        "encoder",
        "reads = [\"features\", \"tracks\"]\nwrites = [\"encodings\"]"
    )));
    insta::assert_snapshot!(error(&of("sampler", "reads = [\"controls\"]\nwrites = [\"forecasts\"]")));
}

#[test]
fn cycle() {
    let lines = "command = [\"./mine\"]\nreads = [\"tracks\", \"forecasts\"]\nwrites = [\"context\"]";
    insta::assert_snapshot!(error(&of("localiser", lines)));
}

#[test]
fn budgets_over_a_tick() {
    insta::assert_snapshot!(error(&with("\"encoder\"\nbudget_ms = ", "\"encoder\"\nbudget_ms = 7")));
    insta::assert_snapshot!(error(&with("\"encoder\"\nbudget_ms = ", "\"encoder\"\nbudget_ms = -")));
}

#[test]
fn options_of_another_stage_or_out_of_range() {
    insta::assert_snapshot!(error(&with("deadline_ms = 72", "deadline_ms = 95")));
    insta::assert_snapshot!(error(&with("deadline_ms = 72", "workers = 2")));
    insta::assert_snapshot!(error(&with("deadline_ms = 72", "propagation = \"guess\"")));
}

#[test]
fn options_are_passed_on_as_written() {
    let pipeline = parsed(&with("deadline_ms = 72", "deadline_ms = 72, retrieval = true, memory = \"a\""));
    let expected = "deadline_ms = 72\nretrieval = true\nmemory = \"a\"".parse().unwrap();
    assert_eq!(stage(&pipeline, StageId::Sampler).options, expected);
    assert!(stage(&pipeline, StageId::Encoder).options.is_empty());
}

#[test]
fn options_that_exclude_each_other() {
    insta::assert_snapshot!(error(&with("deadline_ms = 72", "retrieval = false, memory = \"a\"")));
}

#[test]
fn unknown_option() {
    insta::assert_snapshot!(error(&with("deadline_ms = 72", "deadline = 72")));
    insta::assert_snapshot!(error(&of("encoder", "options = { a = 1 }")));
}

#[test]
fn an_option_of_another_type() {
    insta::assert_snapshot!(error(&with("deadline_ms = 72", "deadline_ms = \"72\"")));
}

#[test]
fn the_options_of_a_command_are_not_checked() {
    let text =
        with("name = \"encoder\"", "name = \"encoder\"\ncommand = [\"./mine\"]\noptions = { gain = [1, 2] }");
    let pipeline = parsed(&text);
    assert_eq!(stage(&pipeline, StageId::Encoder).options, "gain = [1, 2]".parse().unwrap());
}

#[test]
fn processors_and_priority_of_a_stage() {
    let of = |keys: &str| of("encoder", keys);
    let set = parsed(&of("cpu = [3, 1]\npriority = 50"));
    let expected = Scheduling { cpus: vec![1, 3], priority: Some(50), ..Scheduling::default() };
    assert_eq!(stage(&set, StageId::Encoder).scheduling, expected);
    assert!(stage(&set, StageId::Decoder).scheduling.is_default());
    insta::assert_snapshot!(error(&of("cpu = []")));
    insta::assert_snapshot!(error(&of("cpu = [0, 1024]")));
    insta::assert_snapshot!(error(&of("cpu = [1, 1]")));
    assert!(stage(&parsed(&of("priority = 0")), StageId::Encoder).scheduling.is_default());
    insta::assert_snapshot!(error(&of("priority = 100")));
}

#[test]
fn no_recorder() {
    let start = FULL.find("[[stage]]\nname = \"recorder\"").unwrap();
    insta::assert_snapshot!(error(&FULL[..start]));
}

#[test]
fn empty_command() {
    insta::assert_snapshot!(error(&with("name = \"encoder\"", "name = \"encoder\"\ncommand = []")));
}

#[test]
fn a_topic_is_opened_under_another_name() {
    let renamed = |entry: &str| of("encoder", &format!("topics = {{ {entry} }}"));
    let pipeline = parsed(&renamed("encodings = \"encodings-raw\""));
    assert_eq!(stage(&pipeline, StageId::Encoder).topics["encodings"], "encodings-raw");
    assert!(stage(&pipeline, StageId::Decoder).topics.is_empty());
    insta::assert_snapshot!(error(&renamed("tracks = \"a\"")));
    insta::assert_snapshot!(error(&renamed("encodings = \"tracks\"")));
    insta::assert_snapshot!(error(&renamed("encodings = \"a b\"")));
}

/// The shipped file with a user's topic and stage. `topic` and `stage` are their last lines.
fn added(topic: &str, stage: &str) -> String {
    let topic = format!("[[topic]]\nname = \"risks\"\n{topic}\n");
    let stage = format!("[[stage]]\nname = \"monitor\"\ncommand = [\"./mine\"]\n{stage}\n");
    format!("{FULL}\n{topic}\n{stage}")
}

const RISKS: &str = "type_name = \"risk.1\"\nelement_bytes = 24";
const BESIDE: &str = "reads = [\"forecasts\"]\nwrites = [\"risks\"]\nbudget_ms = 40";

#[test]
fn a_stage_beside_the_way_has_a_budget_of_its_own() {
    let pipeline = parsed(&added(RISKS, BESIDE));
    let monitor = pipeline.stages.last().unwrap();
    assert_eq!((monitor.id.number(), monitor.name.as_str()), (65, "monitor"));
    let risks = TopicRun { name: "risks".into(), type_name: "risk.1".into(), element_size: 24 };
    assert_eq!(pipeline.topics, [risks]);
    assert!(pipeline.edges().contains(&(StageId::Sampler, "forecasts", monitor.id)));
    insta::assert_snapshot!(error(&added(RISKS, &BESIDE.replace("40", "81"))));
}

/// A stage between the tracker and the localiser.
fn in_the_way(budget_ms: u32) -> String {
    let text = added(
        "type_name = \"stgdat.tracks.2\"\nelement_bytes = 512",
        &format!("reads = [\"tracks\"]\nwrites = [\"risks\"]\nbudget_ms = {budget_ms}"),
    );
    text.replacen("name = \"localiser\"", "name = \"localiser\"\ntopics = { tracks = \"risks\" }", 1)
}

#[test]
fn a_stage_in_the_way_shares_the_tick() {
    let pipeline = parsed(&in_the_way(2));
    let own = pipeline.stages.last().unwrap().id;
    let edges = pipeline.edges();
    assert!(
        edges.contains(&(StageId::Tracker, "tracks", own))
            && edges.contains(&(own, "risks", StageId::Localiser))
    );
    assert!(!edges.contains(&(StageId::Tracker, "tracks", StageId::Localiser)));
    insta::assert_snapshot!(error(&in_the_way(30)));
}

#[test]
fn an_injector_before_a_declared_topic_changes_nothing_in_the_graph() {
    let plain = parsed(&in_the_way(2));
    let (writer, own) = plain.writer("risks").unwrap();
    assert_eq!((writer.name.as_str(), own), ("monitor", "risks"));
    let injected = |text: &str, name: &str| {
        text.replacen(
            "name = \"monitor\"",
            &format!("name = \"monitor\"\ntopics = {{ risks = \"{name}\" }}"),
            1,
        )
    };
    let pipeline = parsed(&injected(&in_the_way(2), "risks-injected"));
    assert_eq!(pipeline.edges(), plain.edges());

    // A pipeline stage that writes a declared topic in place of its own topic.
    let behind = |name: &str| {
        let text = in_the_way(2).replace("topics = { tracks = \"risks\" }\n", "");
        let text = text.replace(
            "reads = [\"tracks\"]\nwrites = [\"risks\"]",
            "reads = [\"risks\"]\nwrites = [\"tracks\"]",
        );
        text.replacen(
            "name = \"tracker\"",
            &format!("name = \"tracker\"\ntopics = {{ tracks = \"{name}\" }}"),
            1,
        )
    };
    let plain = parsed(&behind("risks"));
    let (writer, own) = plain.writer("risks").unwrap();
    assert_eq!((writer.name.as_str(), own), ("tracker", "tracks"));
    assert_eq!(parsed(&behind("risks-injected")).edges(), plain.edges());

    let taken = error(&added(RISKS, BESIDE).replace("\"risks\"", "\"risks-injected\""));
    assert!(taken.contains("\"risks-injected\" can't be the name of a topic"), "{taken}");
}

#[test]
fn declarations_of_topics_that_are_off() {
    let with_topic = |topic: &str| error(&added(topic, BESIDE));
    insta::assert_snapshot!(with_topic("type_name = \"risk.1\"\nelement_bytes = 0"));
    insta::assert_snapshot!(with_topic("type_name = \"risk.1\"\nelement_bytes = 65537"));
    insta::assert_snapshot!(with_topic("type_name = \"\"\nelement_bytes = 8"));
    insta::assert_snapshot!(with_topic("type_name = \"stgdat.tracks.2\"\nelement_bytes = 24"));
    insta::assert_snapshot!(error(&added(RISKS, BESIDE).replace("\"risks\"", "\"tracks\"")));
    insta::assert_snapshot!(error(&format!(
        "{}\n[[topic]]\nname = \"risks\"\n{RISKS}\n",
        added(RISKS, BESIDE)
    )));
    insta::assert_snapshot!(error(&added(RISKS, "reads = [\"forecasts\"]")));
    insta::assert_snapshot!(error(&in_the_way(2).replace("stgdat.tracks.2", "mine.2")));
}

#[test]
fn added_stages_that_are_off() {
    let second = "\n[[stage]]\nname = \"other\"\ncommand = [\"./other\"]\n";
    let two = |lines: &str| error(&format!("{}{second}{lines}\n", added(RISKS, BESIDE)));
    insta::assert_snapshot!(two("reads = [\"tracks\"]\nwrites = [\"risks\"]"));
    insta::assert_snapshot!(error(&added(RISKS, "reads = [\"risks\"]\nwrites = [\"risks\"]")));
    insta::assert_snapshot!(error(&added(RISKS, BESIDE).replace("\"monitor\"", "\"launcher\"")));
    insta::assert_snapshot!(error(&added(RISKS, BESIDE).replace("\"monitor\"", "\"a b\"")));
    let many = |len: usize| {
        let one =
            |n| format!("\n[[stage]]\nname = \"s{n}\"\ncommand = [\"./mine\"]\nreads = [\"forecasts\"]\n");
        format!("{FULL}{}", (0..len).map(one).collect::<String>())
    };
    assert_eq!(parsed(&many(16)).stages.len(), 24);
    insta::assert_snapshot!(error(&many(17)));
}

#[test]
fn a_tick_that_passes_more_stages_than_its_header_has_room_for_is_warned_of() {
    let mut text = FULL.to_owned();
    let mut before = "tracks".to_owned();
    for n in 0..6 {
        let (tracks, stage) = ("type_name = \"stgdat.tracks.2\"\nelement_bytes = 512", format!("s{n}"));
        text += &format!("\n[[topic]]\nname = \"t{n}\"\n{tracks}\n\n[[stage]]\nname = \"{stage}\"\n");
        text += &format!("command = [\"./mine\"]\nreads = [\"{before}\"]\nwrites = [\"t{n}\"]\n");
        before = format!("t{n}");
    }
    let text = text.replacen("name = \"localiser\"", "name = \"localiser\"\ntopics = { tracks = \"t5\" }", 1);
    assert_eq!(parsed(&text).warnings.len(), 1);
}

#[test]
fn a_topic_that_a_stage_waits_for_in_vain_is_warned_of() {
    let renamed = |stage: &str, topic: &str, name: &str| {
        let line = format!("name = \"{stage}\"\n");
        parsed(&with(&line, &format!("{line}topics = {{ {topic} = \"{name}\" }}\n"))).warnings
    };
    let warnings = renamed("localiser", "tracks", "limited");
    assert!(
        warnings.len() == 1
            && warnings[0].starts_with("the localiser waits for the topic \"limited\", which no"),
        "{warnings:?}"
    );
    let warnings = renamed("encoder", "encodings", "codes");
    assert!(
        warnings.len() == 1 && warnings[0].starts_with("the decoder waits for the topic \"encodings\""),
        "{warnings:?}"
    );
    assert!(renamed("encoder", "encodings", "encodings-injected").is_empty(), "an injector writes it");
}

#[test]
fn a_file_for_another_machine_is_refused_here() {
    let here = |from: &str, to: &str| {
        let text = with(from, to);
        let find = |program: &str| if program == "sh" { Ok(()) } else { Err("not found in PATH".to_owned()) };
        let checked = Pipeline::check_here("pipeline.toml", &text, &find, &|cpu| cpu < 2);
        checked.map_err(|error| {
            let mistake = error.mistake();
            (mistake.message.clone(), text[mistake.span.clone()].to_owned())
        })
    };
    let encoder = "name = \"encoder\"\n";
    let with_line = |line: &str| here(encoder, &format!("{encoder}{line}\n"));
    assert_eq!(with_line("command = [\"sh\", \"-c\", \"x\"]\ncpu = [0, 1]"), Ok(()));
    let (message, place) = with_line("command = [\"no-such\"]").unwrap_err();
    assert_eq!(message, "the encoder can't be started: no-such: not found in PATH");
    assert_eq!(place, "[\"no-such\"]");
    let (message, place) = with_line("cpu = [1, 7]").unwrap_err();
    assert_eq!((message.as_str(), place.as_str()), ("the encoder can't have processor 7", "7"));
}
