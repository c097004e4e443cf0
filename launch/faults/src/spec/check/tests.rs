use super::*;

fn spec(body: &str) -> Result<Spec, String> {
    let text = format!("shows = \"a test\"\n[run]\nticks = 100\n{body}");
    Spec::parse(Path::new("folder/07-test.toml"), &text).map_err(|error| error.to_string())
}

fn refused(body: &str, with: &str) {
    let error = spec(body).expect_err(body);
    assert!(error.starts_with("folder/07-test.toml:") && error.contains(with), "{body}: {error}");
}

#[test]
fn a_specification_is_read() {
    let read = spec(
        "recording = \"a.csv\"\nseed = 4\n[[fault]]\nkind = \"drop\"\ntopic = \"tracks\"\nticks = [20, 40]\n\
         probability = 0.5\n[[fault]]\nkind = \"kill\"\nstage = \"decoder\"\nat = [30, 60]\npoint = \"mid-write\"\n\
         [expect]\nhole_max = 3\ncounted = [{ stage = \"localiser\", cause = \"gap\", as_injected = \"drop\" }]",
    )
    .unwrap();
    assert_eq!((read.name.as_str(), &read.run.recording), ("07-test", &Some("folder/a.csv".into())));
    let topic = TopicFault {
        topic: "tracks".into(),
        effect: Effect::Drop {},
        ticks: [20, 40],
        probability: 0.5,
        seed: 4,
    };
    assert_eq!((&read.faults.topics[..], read.faults.count), (&[topic.clone()][..], 2));
    assert_eq!(read.seeded(9).unwrap().faults.topics, [TopicFault { seed: 9, ..topic }]);
    assert_eq!(read.faults.points, [(StageId::Decoder, Point::MidWrite, vec![30, 60])]);
    assert_eq!((&read.faults.targets[..], read.expect.hole_max), (&[StageId::Decoder][..], Some(3)));
}

#[test]
fn stages_that_the_pipeline_adds_are_known() {
    let folder = tempfile::tempdir().unwrap();
    let added = "\n[[stage]]\nname = \"monitor\"\ncommand = [\"sleep\", \"9\"]\nreads = [\"tracks\"]\n";
    std::fs::write(folder.path().join("p.toml"), format!("{}{added}", configuration::pipeline_file::SHIPPED))
        .unwrap();
    let read = |pipeline: &str, body: &str| {
        let text = format!("shows = \"a test\"\n[run]\nticks = 100\npipeline = \"{pipeline}\"\n{body}");
        Spec::parse(&folder.path().join("a.toml"), &text).map_err(|error| error.to_string())
    };
    let spec = read(
        "p.toml",
        "stages = { monitor = { restarts_max = 2 } }\n[[fault]]\nkind = \"kill\"\nstage = \"monitor\"\nat = 9\n\
         [[fault]]\nkind = \"kill\"\nstage = \"monitor\"\npoint = \"idle\"\nat = 9",
    );
    assert!(spec.unwrap_err().contains(":10: the monitor is killed at a point and by signals"));
    let spec = read(
        "p.toml",
        "[[fault]]\nkind = \"stop\"\nstage = \"monitor\"\nat = 9\nfor_ms = 5\n[expect]\n\
         outages = [{ stage = \"monitor\", count = 1 }]",
    );
    assert_eq!(spec.unwrap().faults.targets, [StageId::added(0).unwrap()]);
    let kill = "[[fault]]\nkind = \"kill\"\nat = 9\nstage = ";
    let error = read("p.toml", &format!("{kill}\"monitors\"")).unwrap_err();
    assert!(error.contains("a.toml:8: unknown stage \"monitors\""), "{error}");
    refused(&format!("{kill}\"monitor\""), ":7: unknown stage \"monitor\"");
    let error = read("q.toml", "").unwrap_err();
    assert!(error.contains("a.toml:4: `pipeline`: ") && error.contains("q.toml"), "{error}");
}

#[test]
fn topics_that_the_pipeline_declares_are_known() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.toml");
    let examples = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/examples/pipeline.toml");
    let head = format!("shows = \"a test\"\n[run]\nticks = 100\npipeline = \"{examples}\"\n");
    let read = |fault: &str| {
        let text = format!("{head}[[fault]]\n{fault}\nticks = [1, 2]\n");
        Spec::parse(&path, &text).map_err(|error| error.to_string())
    };
    let injected = |fault: &str| read(fault).unwrap().injected_topics().join(", ");
    assert_eq!(injected("kind = \"bit-flip\"\ntopic = \"approaches\""), "approaches");
    // The element type is a track, whose fields are known.
    assert_eq!(injected("kind = \"not-finite\"\ntopic = \"limited-tracks\""), "limited-tracks");
    for kind in ["not-finite", "huge"] {
        let error = read(&format!("kind = \"{kind}\"\ntopic = \"approaches\"")).unwrap_err();
        let told =
            format!("a.toml:7: \"{kind}\" on \"approaches\": the fields of \"approach.1\" are not known");
        assert!(error.contains(&told), "{error}");
    }
    let error = read("kind = \"drop\"\ntopic = \"approach\"").unwrap_err();
    assert!(error.contains("a.toml:7: unknown topic \"approach\""), "{error}");
    refused(
        "[[fault]]\nkind = \"drop\"\ntopic = \"approaches\"\nticks = [1, 2]",
        ":6: unknown topic \"approaches\"",
    );
}

#[test]
fn mistakes_name_the_line_the_value_and_what_is_expected() {
    refused(
        "[[fault]]\nkind = \"explode\"",
        ":5: unknown variant `explode`, expected one of `kill`, `random`",
    );
    refused(
        "[[fault]]\nkind = \"kill\"\nstage = \"decoder\"\nat = 100",
        ":7: `at` = 100 of a run of 100 ticks",
    );
    refused("[[fault]]\nkind = \"kill\"\nstage = \"enkoder\"\nat = 10", ":6: unknown stage \"enkoder\"");
    refused("[[fault]]\nkind = \"kill\"\nstage = \"decoder\"", ":4: when does it kill?");
    refused("[[fault]]\nkind = \"stop\"\nstage = \"decoder\"\nat = 10", ":4: missing field `for_ms`");
    refused(
        "[[fault]]\nkind = \"cpu\"\nat = 10\nfor_ms = 5\nbits = 2",
        ":8: unexpected keys in table: bits, available keys: at, for_ms, threads",
    );
    refused(
        "[[fault]]\nkind = \"kill\"\nstage = \"recorder\"\npoint = \"mid-write\"\nat = 9",
        ":7: the recorder has no point \"mid-write\"",
    );
    refused(
        "[[fault]]\nkind = \"random\"\nticks = [1, 9]\ncount = 101",
        ":7: `count` = 101 in a run of 100 ticks",
    );
    refused("[[fault]]\nkind = \"drop\"\ntopic = \"trucks\"\nticks = [1, 2]", ":6: unknown topic \"trucks\"");
    refused("[[fault]]\nkind = \"drop\"\ntopic = \"tracks\"\nticks = [3, 2]", ":7: `ticks` = [3, 2]");
    refused(
        "[[fault]]\nkind = \"replace\"\nstage = \"encoder\"\nat = 9\npoint = \"idle\"\ncommand = [\"a\"]",
        ":9: `command` and `point` exclude each other",
    );
    let drop = "[[fault]]\nkind = \"drop\"\ntopic = \"tracks\"\n";
    refused(&format!("{drop}ticks = [1, 2]\nbits = 2"), ":8: unexpected keys in table: bits");
    refused(&format!("{drop}ticks = \"1\""), ":7: invalid type: string");
    refused(drop, ":4: missing field `ticks`");
    refused(&format!("{drop}ticks = [1, 2]\nprobability = 0"), ":8: `probability` = 0");
    let frozen = "[[fault]]\nkind = \"frozen\"\ntopic = \"tracks\"\nticks = [1, 2]\nin = ";
    refused(&format!("{frozen}\"header\""), ":8: `in` of a \"frozen\"");
    refused("[[fault]]\nstage = \"decoder\"", ":4: a fault needs `kind`");
    refused("fault = 3", "unknown field `fault`");
    refused("[expect]\nhole = 3", ":5: unknown field `hole`");
    refused("[expect]\ngiven_up = [\"me\"]", "unknown stage \"me\"");
    refused(
        "[[fault]]\nkind = \"kill\"\nstage = \"decoder\"\nat = 9\n[[fault]]\nkind = \"kill\"\nstage = \"decoder\"\n\
         point = \"idle\"\nat = 20",
        ":8: the decoder is killed at a point and by signals",
    );
}

#[test]
fn random_faults_follow_from_the_seed() {
    let body = "[[fault]]\nkind = \"random\"\nticks = [20, 40]\ncount = 9\nstages = [\"decoder\", \"encoder\"]\n\
                [[fault]]\nkind = \"kill\"\nstage = \"launcher\"\nwithin_ms = [100, 900]";
    let times = |spec: &Spec| spec.faults.actions.iter().map(|action| action.at).collect::<Vec<_>>();
    let one = spec(body).unwrap();
    assert_eq!(times(&one), times(&spec(body).unwrap()));
    assert_ne!(times(&one), times(&one.seeded(2).unwrap()));
    assert_eq!(times(&one), times(&one.seeded(1).unwrap()));
    let (random, launcher) = one.faults.actions.split_at(9);
    assert!(random.iter().all(|action| matches!(action.at, Due::Tick(20..=40))));
    assert!(
        matches!(&launcher[0].at, Due::AfterStart(Target::Launcher, after) if (100..=900).contains(&after.as_millis()))
    );
    assert!(one.kills_launcher());
    let Faults { count: 2, targets, .. } = one.faults else { panic!("two faults") };
    assert!(targets.iter().all(|stage| matches!(*stage, StageId::Decoder | StageId::Encoder)));
}
