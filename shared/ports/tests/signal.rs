//! A signal ends a wait at once. The test is a separate program without a test harness: the signal must reach
//! the waiting thread, as in a stage, and not a thread of the harness.
#![expect(clippy::unwrap_used, reason = "a test ends at what it can't do")]

use std::time::{Duration, Instant};

use ports::{Node, Space};
use run::Run;
use rustix::process::getpid;
use wire::TracksTopic;

fn main() {
    let space = Space::create(None, 1 << 20).unwrap();
    let run =
        Run { id: space.id(), prefix: space.prefix().into(), root: space.root().into(), ..Run::default() };
    let node = Node::open(&run, "waiting").unwrap();
    let subscriber = node.subscriber::<TracksTopic>(2).unwrap();
    // Opening a topic is also an event.
    subscriber.sleep(Duration::ZERO).unwrap();
    let begin = Instant::now();
    // A separate process: in this process another thread could receive the signal.
    let mut killer = std::process::Command::new("sh")
        .args(["-c", &format!("sleep 0.2; kill -TERM {}", getpid().as_raw_nonzero())])
        .spawn()
        .unwrap();
    while !node.stop().requested() {
        subscriber.sleep(Duration::from_secs(60)).unwrap();
    }
    assert!(begin.elapsed() < Duration::from_secs(30), "the wait went on for {:?}", begin.elapsed());
    assert!(killer.wait().unwrap().success());
    println!("1 passed, 0 failed");
}
