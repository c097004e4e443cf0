use super::*;

fn run(root: &Path) -> Run {
    Run {
        id: 7,
        prefix: "stgdat_00000007_".into(),
        root: root.to_owned(),
        interval_ns: TICK_NS,
        lockstep: true,
        seed: 3,
        protected: vec!["tracks".into()],
        shed: false,
        weights: Some("w.safetensors".into()),
        origin_m: [458_000.0, 5_428_000.5],
        stages: vec![StageRun {
            stage: StageId::Sampler.number(),
            budget_ms: Some(8.0),
            built_in: true,
            options: "deadline_ms = 72.0\n".into(),
            name: String::new(),
            program: String::new(),
            places: [("deadline_ms".to_owned(), "a.toml:3".to_owned())].into(),
            reads: vec!["tracks".into(), "controls".into()],
            writes: vec!["forecasts".into()],
        }],
        spares: vec![SpareRun {
            stage: StageId::Sampler.number(),
            topics: vec!["tracks".into(), "forecasts".into()],
        }],
        topics: vec![TopicRun { name: "risks".into(), type_name: "risk.1".into(), element_size: 24 }],
        readers: [("forecasts".to_owned(), 2)].into(),
    }
}

#[test]
fn a_spare_takes_places_on_its_topics_and_on_that_of_heartbeats() {
    let run = run(Path::new("/tmp/x"));
    let opens = ["tracks", "heartbeats", "context"].map(|topic| run.spares[0].opens(topic));
    assert_eq!(opens, [true, true, false]);
}

fn in_temporary_file<T>(name: &str, check: impl FnOnce(&Path) -> T) -> T {
    let path = std::env::temp_dir().join(format!("stgdat_record_{name}_{}", std::process::id()));
    let result = check(&path);
    let _ = std::fs::remove_file(&path);
    result
}

#[test]
fn a_record_reads_back_as_written() {
    in_temporary_file("same", |path| {
        let written = run(Path::new("/tmp/stgdat_00000007"));
        written.write(path).unwrap();
        assert_eq!(Run::read(path).unwrap(), written);
    });
}

#[test]
fn deadlines_are_the_budgets_up_to_a_stage() {
    let stage = |stage: StageId, budget_ms| StageRun {
        stage: stage.number(),
        budget_ms,
        built_in: true,
        options: String::new(),
        name: String::new(),
        program: String::new(),
        places: BTreeMap::new(),
        reads: Vec::new(),
        writes: Vec::new(),
    };
    // Not in the order of the chain, because a pipeline file may have any order.
    let stages = vec![
        stage(StageId::Decoder, Some(20.0)),
        stage(StageId::Source, Some(1.0)),
        stage(StageId::Tracker, Some(6.0)),
        stage(StageId::Recorder, None),
    ];
    let run = Run { stages, ..Run::default() };
    assert_eq!(run.deadline_ns(StageId::Tracker), Some(7_000_000));
    assert_eq!(run.deadline_ns(StageId::Decoder), Some(27_000_000));
    assert_eq!(run.left_for_sampler_ns(), 53_000_000);
    assert_eq!(run.deadline_ns(StageId::Recorder), None);
    let faster = Run { interval_ns: TICK_NS / 2, ..run.clone() };
    assert_eq!(faster.deadline_ns(StageId::Decoder), Some(13_500_000));
    let slower = Run { interval_ns: TICK_NS * 2, ..run.clone() };
    assert_eq!(slower.deadline_ns(StageId::Decoder), Some(27_000_000));
    assert_eq!(Run { lockstep: true, ..run.clone() }.deadline_ns(StageId::Decoder), None);
    assert_eq!(Run { shed: false, ..run }.deadline_ns(StageId::Decoder), None);
}

#[test]
fn a_record_of_another_schema_is_refused() {
    in_temporary_file("schema", |path| {
        std::fs::write(path, format!("{MAGIC}99\nabc")).unwrap();
        let error = Run::read(path).unwrap_err().to_string();
        assert!(error.contains("unknown version, schema 99"), "{error}");
        std::fs::write(path, format!("{MAGIC}99 7.8.9 0\nabc")).unwrap();
        let error = Run::read(path).unwrap_err().to_string();
        assert!(error.contains("stgdat 7.8.9, schema 99") && error.contains("same sources"), "{error}");
    });
}

#[test]
fn foreign_truncated_and_overlong_files_are_refused() {
    in_temporary_file("damaged", |path| {
        std::fs::write(path, b"\x7fELF without a line").unwrap();
        assert!(matches!(Run::read(path), Err(RecordError::Foreign { .. })));
        run(Path::new("/tmp/x")).write(path).unwrap();
        let whole = std::fs::read(path).unwrap();
        let line_end = whole.iter().position(|&byte| byte == b'\n').unwrap();
        for len in [line_end + 1, whole.len() / 2, whole.len() - 1] {
            std::fs::write(path, &whole[..len]).unwrap();
            assert!(matches!(Run::read(path), Err(RecordError::Damaged { .. })), "cut to {len} bytes");
        }
        std::fs::write(path, [&whole[..], b"x"].concat()).unwrap();
        assert!(matches!(Run::read(path), Err(RecordError::Damaged { .. })));
    });
}

#[test]
fn a_whole_record_with_other_fields_is_of_another_build() {
    in_temporary_file("build", |path| {
        for body in [&[7, 3][..], &[0; 99], &[255; 60]] {
            let first = format!("{MAGIC}{SCHEMA} 0.0.9 {:016x}\n", crc64(&[body]));
            std::fs::write(path, [first.as_bytes(), body].concat()).unwrap();
            let error = Run::read(path).unwrap_err().to_string();
            assert!(error.contains("another build of stgdat 0.0.9"), "{error}");
        }
    });
}
