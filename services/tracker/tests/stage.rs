//! The stage with its ports: out-of-sequence and repeated frames reach the tracker, and every tick is passed
//! on.

use std::time::{Duration, Instant};

use ports::{Frame, Node, Publisher, Space, Subscriber};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use run::Run;
use rustix::process::{Signal, getpid, kill_process};
use wire::{
    AgentType, Detection, DetectionsTopic, Forecast, ForecastsTopic, Header, HeartbeatsTopic, Quality,
    StageId, Steering, Topic, TracksTopic, flags,
};

use crate::support::forecaster::{HORIZON_LEN, forecast, forecasts_header};
use crate::support::harness::{ALL_TYPES, Harness, TICK_NS, detected_at, noise, with_heading};

const FRAMES: u32 = 40;
/// Longest wait for an answer, far above the usual time.
const LIMIT: Duration = Duration::from_secs(30);
/// Number of the last warm-up frame; the frames before it have the number 0.
const LAST_WARM_UP: u64 = 1;

/// The other ends of the stage's ports.
struct Ends {
    run: Run,
    detections: Publisher<DetectionsTopic>,
    forecasts: Publisher<ForecastsTopic>,
    tracks: Subscriber<TracksTopic>,
    heartbeats: Subscriber<HeartbeatsTopic>,
}

impl Ends {
    fn open(space: &Space) -> Self {
        let id = u64::from(std::process::id());
        let run = Run { id, prefix: space.prefix().into(), root: space.root().into(), ..Run::default() };
        let node = Node::open(&run, "test").expect("a node");
        Self {
            detections: node.publisher().expect("a publisher"),
            forecasts: node.publisher().expect("a publisher"),
            tracks: node.subscriber(TracksTopic::DEPTH_MAX).expect("a subscriber"),
            heartbeats: node.subscriber(HeartbeatsTopic::DEPTH_MAX).expect("a subscriber"),
            run,
        }
    }

    /// Sends forecasts of constant velocity for these tracks. A VOID frame without tracks stays VOID.
    fn forecast(&self, tracks: &Frame<TracksTopic>) {
        let straight = [(1.0, [[0.0; 2]; HORIZON_LEN])];
        let forecasts: Vec<Forecast> =
            tracks.iter().map(|track| forecast(track, Steering::Bicycle, &straight)).collect();
        let Header { step_ns, mut counts, .. } = forecasts_header(0, forecasts.len());
        counts.modes_len = straight.len() as u32;
        let header = Header { step_ns, counts, ..*tracks.header() };
        self.forecasts.send_copy(&forecasts, header).expect("the transport works");
    }

    /// Sends a frame and returns the stage's tracks.
    fn give(&self, header: Header, frame: &[Detection]) -> Frame<TracksTopic> {
        let mut header = Header { observed_types: ALL_TYPES, ..header };
        header.counts.agents_len = frame.len() as u32;
        let begin = Instant::now();
        self.detections.send_copy(frame, header).expect("the transport works");
        loop {
            if let Some(tracks) = self.tracks.receive().expect("the transport works")
                && (tracks.header().flags | flags::VOID, tracks.header().seq)
                    == (header.flags | flags::VOID, header.seq)
            {
                return tracks;
            }
            assert!(begin.elapsed() < LIMIT, "no answer to tick {}", header.seq);
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Sends warm-up frames until the stage answers.
    fn link(&self) {
        let begin = Instant::now();
        let header = Header { flags: flags::WARM_UP, ..Header::new(self.run.id, 0, 0) };
        while self.tracks.receive().expect("the transport works").is_none() {
            self.detections.send_copy(&[], header).expect("the transport works");
            assert!(begin.elapsed() < LIMIT, "the stage does not link");
            std::thread::sleep(Duration::from_millis(10));
        }
        // The remaining ones must not push a tick out of the queue: waits for the last one.
        self.detections.send_copy(&[], Header { seq: LAST_WARM_UP, ..header }).expect("the transport works");
        let receive = || self.tracks.receive().expect("the transport works");
        while receive().is_none_or(|frame| frame.header().seq != LAST_WARM_UP) {
            assert!(begin.elapsed() < LIMIT, "the last warm-up frame does not arrive");
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Number of frames that the stage reports as refused, once it is above 0.
    fn rejected_len(&self) -> u64 {
        let begin = Instant::now();
        while begin.elapsed() < LIMIT {
            std::thread::sleep(Duration::from_millis(10));
            let newest = self.heartbeats.newest().expect("the transport works");
            let beat =
                newest.and_then(|beats| beats.iter().find(|b| b.stage == StageId::Tracker.number()).copied());
            if let Some(beat) = beat.filter(|beat| beat.rejected_len > 0) {
                return beat.rejected_len;
            }
        }
        panic!("nothing was refused");
    }
}

/// Stops the stage, even if the test fails.
struct Stop;

impl Drop for Stop {
    fn drop(&mut self) {
        let _ = kill_process(getpid(), Signal::TERM);
    }
}

/// One moving vehicle.
fn drive(rng: &mut ChaCha8Rng) -> Vec<[Detection; 1]> {
    let frame = |k| {
        let (dx, dy) = (noise(rng, 0.1), noise(rng, 0.1));
        [with_heading(detected_at(AgentType::Vehicle, 1, 0.4 * f64::from(k) + dx, dy), 0.0)]
    };
    (0..FRAMES).map(frame).collect()
}

#[test]
fn out_of_sequence_frames_pass_on_void_and_forecasts_hold() {
    let space = Space::create(None, 1 << 20).expect("shared memory has room");
    let ends = Ends::open(&space);
    let run = ends.run.clone();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let frames = drive(&mut rng);
    let header = |seq: usize, k: usize| Header::new(run.id, seq as u64, k as i64 * TICK_NS);

    let weights = nn::Weights::onboard();
    weights.config().write(&run.root).expect("the run's directory is there");
    let settings = tracker::settings(&run, weights.config()).expect("defaults");
    let mut straight = Harness::new(settings, 0);
    straight.stamp_ns = -TICK_NS;
    for frame in &frames[..20] {
        straight.step(frame);
    }
    let expected = straight.published()[0];

    std::thread::scope(|scope| {
        let stage = scope.spawn(|| tracker::run(&run));
        let stop = Stop;
        ends.link();
        let order = [0, 1, 2, 3, 4, 7, 6, 5, 8, 9, 10, 12, 13, 11, 14, 15, 16, 16, 17, 18, 19];
        let mut newest = None;
        for (seq, &k) in order.iter().enumerate() {
            let tracks = ends.give(header(seq, k), &frames[k]);
            let is_void = newest >= Some(k);
            assert_eq!(tracks.header().has(flags::VOID), is_void, "frame {k}");
            assert_eq!(tracks.len(), usize::from(!is_void && k >= 2), "frame {k}");
            newest = newest.max(Some(k));
            if let Some(track) = tracks.first().filter(|_| k == 19) {
                let of = |track: &wire::Track| (track.id, track.x_m, track.vx_mps, track.covariance);
                assert_eq!(of(track), of(&expected));
            }
        }
        assert_eq!(ends.rejected_len(), 1, "the repeated frame alone");

        // The second of every two frames comes first. Half of the ticks have no forecasts, so the previous
        // ones hold.
        let mut learned_count = 0;
        for k in (20..frames.len()).map(|k| k ^ 1) {
            let tracks = ends.give(header(order.len() + k, k), &frames[k]);
            assert_eq!(tracks.header().has(flags::VOID), k % 2 == 0, "frame {k}");
            learned_count += tracks.iter().filter(|track| track.prior == Quality::Learned as u32).count();
            ends.forecast(&tracks);
        }
        assert!(learned_count >= 4, "{learned_count} of 10 ticks");
        drop(stop);
        assert!(stage.join().expect("no panic").is_ok());
    });
}
