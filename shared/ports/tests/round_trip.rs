//! Frames between the two ends of a topic, in one process and across two.

#![expect(clippy::unwrap_used, reason = "a test that cannot open its ports has failed")]

use std::io::{BufRead as _, BufReader, Write as _};
use std::os::unix::net::UnixListener;
use std::path::Path;
use std::time::{Duration, Instant};

use ports::{
    Answer, Awaited, GO, INCARNATION_VARIABLE, NoTopic, Node, STANDBY_VARIABLE, Space, Stage, StageError,
    Step, Tick, clean_dead_nodes, drive, leftovers, monotonic_ns,
};
use run::{Declaration, NoOptions, Run};
use wire::{
    ContextTopic, FeaturesTopic, Forecast, ForecastsTopic, Header, HeartbeatsTopic, Protection, RefusalCause,
    Refusals, Rejected, StageId, Topic, Track, TracksTopic, flags,
};

use crate::{READER, run};

/// A stage that answers tracks with forecasts.
const ECHO: Declaration<NoOptions> =
    Declaration::new(StageId::Sampler, &[TracksTopic::NAME], &[ForecastsTopic::NAME]);
/// The opposite end: sends tracks and reads forecasts.
const CALLER: Declaration<NoOptions> =
    Declaration::new(StageId::Tracker, &[ForecastsTopic::NAME], &[TracksTopic::NAME]);

fn header(run: &Run, seq: u64, len: usize) -> Header {
    let mut header = Header::new(run.id, seq, seq as i64 * 80_000_000);
    header.counts.agents_len = len as u32;
    header
}

fn track(id: u64) -> Track {
    Track { id, x_m: id as f32, ..bytemuck::Zeroable::zeroed() }
}

#[test]
fn a_frame_is_read_where_it_was_written() {
    let (_space, run) = run();
    let node = Node::open(&run, "both").unwrap();
    let subscriber = node.subscriber::<TracksTopic>(2).unwrap();
    let publisher = node.publisher::<TracksTopic>().unwrap();
    let mut loan = publisher.loan(3).unwrap();
    for (i, element) in loan.iter_mut().enumerate() {
        *element = track(i as u64 + 10);
    }
    publisher.send(loan, header(&run, 0, 3)).unwrap();
    let frame = subscriber.receive().unwrap().expect("the frame is in the queue");
    assert_eq!(frame.header(), &header(&run, 0, 3));
    assert_eq!(frame[..], [track(10), track(11), track(12)]);
    assert_eq!(frame.as_ptr().addr() % 64, 0, "payloads start at a cache line");
    assert!(subscriber.receive().unwrap().is_none());
}

#[test]
fn a_half_made_service_of_a_process_that_died_early_is_removed() {
    use std::os::unix::fs::PermissionsExt as _;
    let (space, run) = run();
    let services = space.root().join("services");
    std::fs::create_dir_all(&services).unwrap();
    // Until its description is complete, a service's owner may write it. No node lists this service.
    let [half_made, whole] = [("half", 0o600), ("whole", 0o400)].map(|(name, mode)| {
        let path = services.join(format!("{name}.service"));
        let file = std::fs::File::create(&path).unwrap();
        file.set_permissions(std::fs::Permissions::from_mode(mode)).unwrap();
        path
    });
    assert_eq!(clean_dead_nodes(&run, |_, _| ()).unwrap(), (0, 0));
    assert!(!half_made.exists() && whole.exists());
}

#[test]
fn headers_report_their_sender_and_protect_anew() {
    let (_space, run) = run();
    let node = Node::open(&run, "tool").unwrap();
    let (tracks, forecasts) =
        (node.subscriber::<TracksTopic>(2).unwrap(), node.subscriber::<ForecastsTopic>(2).unwrap());
    let mut stage = Stage::open(&run, &ECHO).unwrap();
    let (output, input) =
        (stage.publish::<ForecastsTopic>().unwrap(), stage.subscribe::<TracksTopic>().unwrap());
    let tool = node.publisher::<TracksTopic>().unwrap();
    let protection = Protection { crc: 1, counter: 2, ..Protection::default() };
    tool.send_copy(&[], Header { protection, sender: 5, incarnation: 9, ..header(&run, 0, 0) }).unwrap();
    let of_the_tool = tracks.receive().unwrap().unwrap();
    assert_eq!(of_the_tool.header(), &header(&run, 0, 0), "a tool is no stage");
    let passage = stage.begin(&input.receive().unwrap().unwrap());
    stage.pass_empty(passage, &output).unwrap();
    let of_the_stage = forecasts.receive().unwrap().unwrap();
    let Header { sender, incarnation, protection, hops, .. } = *of_the_stage.header();
    assert_eq!((sender, incarnation), (hops[0].stage, hops[0].incarnation));
    assert_eq!(sender, StageId::Sampler.number());
    assert!(!protection.is_absent() && protection.counter == 0, "forecasts are protected by default");
}

#[test]
fn frames_without_a_check_value_are_refused_where_the_run_asks_for_one() {
    let (_space, run) = run();
    let careless = Run { protected: Vec::new(), ..run.clone() };
    let sender = Node::open(&careless, "careless").unwrap().publisher::<ForecastsTopic>().unwrap();
    let mut stage = Stage::open(&run, &CALLER).unwrap();
    let (reader, _output) =
        (stage.subscribe::<ForecastsTopic>().unwrap(), stage.publish::<TracksTopic>().unwrap());
    for seq in 0..2 {
        sender.send_copy(&[], header(&run, seq, 0)).unwrap();
    }
    assert!(reader.receive().unwrap().is_none());
    let heartbeat = stage.heartbeat();
    let refusals = Refusals { sender: 0, cause: RefusalCause::Unprotected as u16, frames_len: 2 };
    assert_eq!((heartbeat.rejected_len, heartbeat.refusals[0]), (2, refusals));
}

/// The topic as defined by a program of another version.
#[derive(Debug)]
enum OtherTracks {}

impl Topic for OtherTracks {
    type Element = Track;
    const NAME: &'static str = TracksTopic::NAME;
    const DOC: &'static str = TracksTopic::DOC;
    const TYPE_NAME: &'static str = "stgdat.tracks.v2";
    const ELEMENTS_MAX: usize = TracksTopic::ELEMENTS_MAX;
    const ELEMENTS_START: usize = TracksTopic::ELEMENTS_START;
    const SUBSCRIBERS_MAX: usize = TracksTopic::SUBSCRIBERS_MAX;
    const DEPTH_MAX: usize = TracksTopic::DEPTH_MAX;
}

#[test]
fn ports_of_another_version_do_not_connect() {
    let (_space, run) = run();
    let node = Node::open(&run, "old").unwrap();
    let _other = node.publisher::<OtherTracks>().unwrap();
    let refused = Node::open(&run, "new").unwrap().subscriber::<TracksTopic>(2).unwrap_err().to_string();
    assert!(refused.starts_with("frames of topic \"tracks\": "), "{refused}");
    assert!(refused.contains("IncompatibleTypes"), "{refused}");
}

#[test]
fn payloads_grow_beyond_the_first_size_and_may_be_empty() {
    let (_space, run) = run();
    let node = Node::open(&run, "both").unwrap();
    let subscriber = node.subscriber::<FeaturesTopic>(2).unwrap();
    let publisher = node.publisher::<FeaturesTopic>().unwrap();
    for (seq, edges_len) in [0, 100, 30_000, 7].into_iter().enumerate() {
        let mut head = header(&run, seq as u64, 0);
        head.counts.edges_len = edges_len;
        let rows = FeaturesTopic::elements_len(&head.counts);
        let mut loan = publisher.loan(rows).unwrap();
        for (i, row) in loan.iter_mut().enumerate() {
            row.values = [i as f32; 16];
        }
        publisher.send(loan, head).unwrap();
        let frame = subscriber.receive().unwrap().unwrap();
        assert_eq!(frame.len(), rows);
        assert!(frame.iter().enumerate().all(|(i, row)| row.values == [i as f32; 16]), "{edges_len} edges");
    }
    assert!(publisher.loan(FeaturesTopic::ELEMENTS_MAX + 1).is_err());
}

#[test]
fn the_oldest_frames_are_dropped_and_counted() {
    let (_space, run) = run();
    let mut reader = Stage::open(&run, &READER).unwrap();
    let tracks = reader.subscribe::<TracksTopic>().unwrap();
    let node = Node::open(&run, "tool").unwrap();
    let publisher = node.publisher::<TracksTopic>().unwrap();
    let heartbeats = node.subscriber::<HeartbeatsTopic>(2).unwrap();
    let warm_up = Header { flags: flags::WARM_UP, ..header(&run, 0, 0) };
    publisher.send_copy(&[], warm_up).unwrap();
    assert!(tracks.receive().unwrap().is_some_and(|frame| !frame.header().is_tick()));
    for seq in 0..5 {
        publisher.send_copy(&[track(seq)], header(&run, seq, 1)).unwrap();
    }
    let seqs: Vec<u64> = std::iter::from_fn(|| tracks.receive().unwrap()).map(|f| f.header().seq).collect();
    assert_eq!(seqs, [3, 4]);
    reader.beat().unwrap();
    let beat = heartbeats.newest().unwrap().unwrap();
    assert_eq!((beat[0].dropped_len, beat[0].rejected_len, beat[0].linked), (3, 0, 1));
}

#[test]
fn frames_of_another_run_schema_or_length_are_counted() {
    let (_space, run) = run();
    let mut reader = Stage::open(&run, &READER).unwrap();
    let tracks = reader.subscribe::<TracksTopic>().unwrap();
    let node = Node::open(&run, "tool").unwrap();
    let publisher = node.publisher::<TracksTopic>().unwrap();
    let heartbeats = node.subscriber::<HeartbeatsTopic>(2).unwrap();
    let good = header(&run, 0, 1);
    let wrong = [
        Header { run_id: run.id + 1, ..good },
        Header { schema: 77, ..good },
        header(&run, 0, 2),
        Header { ego_heading_rad: f32::NAN, ..good },
        Header { hops_len: 99, ..good },
    ];
    for head in wrong {
        publisher.send_copy(&[track(1)], head).unwrap();
        assert!(tracks.receive().unwrap().is_none(), "{head:?}");
    }
    publisher.send_copy(&[track(1)], good).unwrap();
    assert!(tracks.receive().unwrap().is_some());
    reader.beat().unwrap();
    assert_eq!(heartbeats.newest().unwrap().unwrap()[0].rejected_len, 5);
}

#[test]
fn waiting_for_a_tick_drops_older_and_keeps_newer_ones() {
    let (_space, run) = run();
    let reader: Declaration<NoOptions> = Declaration::new(StageId::Sampler, &[ForecastsTopic::NAME], &[]);
    let mut stage = Stage::open(&run, &reader).unwrap();
    let forecasts = stage.subscribe_deep::<ForecastsTopic>(8).unwrap();
    let node = Node::open(&run, "tool").unwrap();
    let publisher = node.publisher::<ForecastsTopic>().unwrap();
    for seq in [3, 4, 6, 7] {
        let void = if seq == 7 { flags::VOID } else { 0 };
        publisher.send_copy(&[], Header { flags: void, ..header(&run, seq, 0) }).unwrap();
    }
    let soon = || Some(monotonic_ns() + 1_000_000);
    assert!(
        matches!(stage.wait_for(&forecasts, 4, soon()).unwrap(), Awaited::Frame(f) if f.header().seq == 4)
    );
    assert!(matches!(stage.wait_for(&forecasts, 5, soon()).unwrap(), Awaited::Late));
    assert!(
        matches!(stage.wait_for(&forecasts, 6, soon()).unwrap(), Awaited::Frame(f) if f.header().seq == 6)
    );
    assert!(matches!(stage.wait_for(&forecasts, 7, soon()).unwrap(), Awaited::Void(_)));
    assert!(matches!(stage.wait_for(&forecasts, 8, soon()).unwrap(), Awaited::Late));
}

/// A stage in a separate process. It answers each track with a forecast that has twice its id and is
/// otherwise zero.
fn echo(run: &Run) -> Result<(), StageError> {
    drive(run, &ECHO, |_| Ok(Echo))
}

struct Echo;

impl Step for Echo {
    type Input = TracksTopic;
    type Second = NoTopic;
    type Output = ForecastsTopic;

    fn answer(
        &mut self,
        tick: &Tick<'_, TracksTopic>,
        out: &mut Answer<'_, ForecastsTopic>,
    ) -> Result<(), Rejected> {
        let id = tick.input[0].id;
        if id == 13 {
            return Err(Rejected::NotFinite { field: "thirteen" });
        }
        out.header.counts.agents_len = 1;
        out.elements(1)?[0] = Forecast { id: id * 2, ..bytemuck::Zeroable::zeroed() };
        Ok(())
    }
}

/// Not a test: the process that the next test starts.
#[test]
fn echo_process() {
    let Some(record) = std::env::var_os("STGDAT_TEST_ECHO") else { return };
    echo(&Run::read(Path::new(&record)).unwrap()).unwrap();
}

#[test]
fn a_stage_in_another_process_links_answers_and_ends() {
    let (space, run) = run();
    let record = space.root().join("run");
    run.write(&record).unwrap();
    let child = start_echo(&record, None);
    let mut here = Stage::open(&run, &CALLER).unwrap();
    let tracks = here.publish::<TracksTopic>().unwrap();
    let forecasts = here.subscribe::<ForecastsTopic>().unwrap();
    let limit_ns = monotonic_ns() + 20_000_000_000;

    let warm_up = Header { flags: flags::WARM_UP, ..header(&run, 0, 0) };
    loop {
        assert!(monotonic_ns() < limit_ns, "the other process does not link");
        let passage = here.release(warm_up);
        here.pass_empty(passage, &tracks).unwrap();
        here.sleep_on(&forecasts, monotonic_ns() + 20_000_000).unwrap();
        if forecasts.receive().unwrap().is_some_and(|frame| frame.header().has(flags::WARM_UP)) {
            break;
        }
    }
    for (seq, id) in [5, 13, 6].into_iter().enumerate() {
        let passage = here.release(header(&run, seq as u64, 1));
        let mut loan = tracks.loan(1).unwrap();
        loan[0] = track(id);
        here.finish(passage, &tracks, Ok(loan)).unwrap();
        match here.wait_for(&forecasts, seq as u64, Some(limit_ns)).unwrap() {
            Awaited::Frame(frame) => {
                assert_eq!(frame[0].id, id * 2);
                let stages: Vec<u32> = frame.header().hops().iter().map(|hop| hop.stage).collect();
                assert_eq!(stages, [StageId::Tracker.number(), StageId::Sampler.number()]);
                let hop = frame.header().hop(StageId::Sampler).unwrap();
                assert!(hop.received_ns <= hop.started_ns && hop.finished_ns <= hop.sent_ns);
                assert!(
                    frame.header().hops[0].sent_ns <= hop.received_ns && hop.sent_ns <= frame.received_ns()
                );
            }
            Awaited::Void(frame) => assert_eq!((id, frame.len()), (13, 0)),
            other => panic!("no answer to {id}: {other:?}"),
        }
    }
    end(child);
}

/// Starts the echo as a process; with a socket, as a replacement for another.
fn start_echo(record: &Path, standby: Option<&Path>) -> std::process::Child {
    std::process::Command::new(std::env::current_exe().expect("a test has a file"))
        .args(["--exact", "round_trip::echo_process", "--nocapture"])
        .env("STGDAT_TEST_ECHO", record)
        .envs(standby.map(|socket| (STANDBY_VARIABLE, socket)))
        .env(INCARNATION_VARIABLE, if standby.is_some() { "1" } else { "0" })
        .spawn()
        .expect("a test can start itself")
}

/// Asks the echo to end.
fn end(mut echo: std::process::Child) {
    let pid = rustix::process::Pid::from_child(&echo);
    rustix::process::kill_process(pid, rustix::process::Signal::TERM).unwrap();
    assert!(echo.wait().unwrap().success(), "a stage that is asked to end returns from its loop");
}

#[test]
fn a_process_takes_over_after_the_newest_tick_that_was_answered() {
    let (space, run) = run();
    let record = space.root().join("run");
    run.write(&record).unwrap();
    let mut here = Stage::open(&run, &CALLER).unwrap();
    let tracks = here.publish::<TracksTopic>().unwrap();
    let forecasts = here.subscribe::<ForecastsTopic>().unwrap();
    let limit_ns = monotonic_ns() + 20_000_000_000;
    let ask = |stage: &mut Stage, seq: u64| {
        let passage = stage.release(header(&run, seq, 1));
        let loan = tracks.copy(&[track(seq + 5)]).unwrap();
        stage.finish(passage, &tracks, Ok(loan)).unwrap();
    };
    let answer = |stage: &mut Stage| loop {
        assert!(monotonic_ns() < limit_ns, "no answer");
        stage.sleep_on(&forecasts, monotonic_ns() + 20_000_000).unwrap();
        let frame = forecasts.receive().unwrap();
        if let Some(frame) = frame {
            let hop = frame.header().hop(StageId::Sampler).expect("the echo has stamped it");
            return (frame.header().seq, hop.incarnation);
        }
    };

    let old = start_echo(&record, None);
    // The old process receives frames once it is running: the first tick that it answers.
    let first = (0..).find(|&seq| {
        assert!(monotonic_ns() < limit_ns, "no answer");
        ask(&mut here, seq);
        here.sleep_on(&forecasts, monotonic_ns() + 20_000_000).unwrap();
        forecasts.receive().unwrap().is_some()
    });
    let first = first.expect("it answers");
    let socket = space.root().join("control");
    let listener = UnixListener::bind(&socket).unwrap();
    let new = start_echo(&record, Some(&socket));
    let (mut turn, _) = listener.accept().unwrap();
    let mut ready = String::new();
    BufReader::new(&turn).read_line(&mut ready).unwrap();
    assert_eq!(ready, "ready sampler 1\n");
    for seq in first + 1..first + 4 {
        ask(&mut here, seq);
        while answer(&mut here) != (seq, 0) {}
    }
    end(old);
    // A tick that arrives while no stage is running is answered by the new one, and no tick is answered
    // twice.
    ask(&mut here, first + 4);
    writeln!(turn, "{GO}").unwrap();
    assert_eq!(answer(&mut here), (first + 4, 1));
    ask(&mut here, first + 5);
    assert_eq!(answer(&mut here), (first + 5, 1));
    end(new);
}

#[test]
fn a_dropped_space_leaves_nothing_and_a_live_one_is_kept() {
    let (space, run) = run();
    let stage = Stage::open(&run, &READER).unwrap();
    assert!(space.shared_bytes() > 0);
    assert!(leftovers().unwrap().iter().all(|leftover| !run.root.ends_with(&leftover.name)));
    let (prefix, root) = (format!("stgdat_{:08x}", space.id() as u32), run.root.clone());
    drop(stage);
    drop(space);
    assert!(!root.exists());
    let left: Vec<_> = std::fs::read_dir("/dev/shm")
        .unwrap()
        .filter_map(|entry| entry.unwrap().file_name().into_string().ok())
        .filter(|name| name.starts_with(&prefix))
        .collect();
    assert!(left.is_empty(), "{left:?}");
}

#[test]
fn too_little_shared_memory_is_an_error_before_any_file() {
    let error = Space::create(None, u64::MAX).expect_err("no machine has that much");
    assert!(error.to_string().contains("MiB free"), "{error}");
}

#[test]
#[should_panic(expected = "the localiser declares no input \"features\"")]
fn a_stage_reads_only_what_it_declares() {
    let (_space, run) = run();
    let _ = Stage::open(&run, &READER).unwrap().subscribe::<FeaturesTopic>();
}

#[test]
#[should_panic(expected = "the sampler declares no output \"context\"")]
fn a_stage_writes_only_what_it_declares() {
    let (_space, run) = run();
    let _ = Stage::open(&run, &ECHO).unwrap().publish::<ContextTopic>();
}

#[test]
#[should_panic(expected = "the sampler declares Some(\"forecasts\") and has not opened it")]
fn a_stage_opens_all_that_it_declares_before_it_waits() {
    let (_space, run) = run();
    let mut stage = Stage::open(&run, &ECHO).unwrap();
    let tracks = stage.subscribe::<TracksTopic>().unwrap();
    let _ = stage.take(&tracks);
}

#[test]
fn a_wait_ends_at_its_timeout_or_with_a_frame() {
    let (_space, run) = run();
    let node = Node::open(&run, "both").unwrap();
    let subscriber = node.subscriber::<TracksTopic>(2).unwrap();
    let publisher = node.publisher::<TracksTopic>().unwrap();
    // Opening a topic is also an event.
    subscriber.sleep(Duration::ZERO).unwrap();
    let slept = |timeout: Duration| {
        let begin = Instant::now();
        subscriber.sleep(timeout).unwrap();
        begin.elapsed()
    };
    assert!(slept(Duration::from_millis(30)) >= Duration::from_millis(30), "nothing comes");
    for seq in 0..3 {
        publisher.send_copy(&[track(seq)], header(&run, seq, 1)).unwrap();
    }
    assert!(slept(Duration::from_secs(60)) < Duration::from_secs(30), "frames are there");
    assert!(slept(Duration::from_millis(30)) >= Duration::from_millis(30), "their events are gone");
    assert!(subscriber.receive().unwrap().is_some());
}
