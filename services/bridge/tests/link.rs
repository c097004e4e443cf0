//! A sender and its receivers over loopback and Unix sockets. No test has a time limit: each one waits until a
//! count or a frame is there.
#![expect(clippy::unwrap_used, reason = "a test ends at what it can't do")]

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use bridge::auth::Key;
use bridge::counts::Count;
use bridge::frame::detections::{self, Detections};
use bridge::frame::{Kind, TickHead};
use bridge::receiver::{Body, Link, Received, Receiver};
use bridge::sender::{GREETINGS_MAX, RECEIVERS_MAX, Sender, WINDOW};
use bridge::socket::Address;
use ports::monotonic_ns;
use wire::Detection;

/// Long enough for a busy machine, so that only a test that waits for the limit reaches it.
const LONG: Duration = Duration::from_secs(60);
const SHORT: Duration = Duration::from_millis(200);
const STEP: Duration = Duration::from_millis(5);

fn key() -> Key {
    Key::new(vec![7; 32])
}

fn sender(address: &str, timeout: Duration) -> Sender {
    Sender::listen(&address.parse().unwrap(), Kind::Detections, key(), timeout).unwrap()
}

fn link(sender: &Sender, key: Key, timeout: Duration) -> Link {
    let address = sender.address().clone();
    Link { address, kind: Kind::Detections, key, timeout, max_age: LONG, clock_offset_ns: None }
}

fn receiver(link: Link) -> Receiver {
    Receiver::start(link, 1_000).unwrap()
}

/// Sends a tick with 300 detections.
fn send(sender: &mut Sender, seq: u64) {
    let detections: Vec<Detection> =
        (0..300).map(|id| Detection { id, x_m: seq as f32, ..Detection::default() }).collect();
    let head = TickHead { seq, ..TickHead::default() };
    sender.send(monotonic_ns(), |body| detections::write(body, &head, &detections));
}

fn content(received: &Received) -> &Detections {
    match &received.body {
        Body::Detections(detections) => detections,
        Body::Forecasts(_) => panic!("{received:?}"),
    }
}

fn wait(what: &str, mut is_done: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !is_done() {
        assert!(begun.elapsed() < LONG, "{what}");
        std::thread::sleep(STEP);
    }
}

fn wait_count(what: &str, count: &Count, least: u64) {
    wait(what, || count.get() >= least);
}

/// Sends ticks from `seq` until the receiver has one of them; returns its number.
fn exchanged(sender: &mut Sender, receiver: &Receiver, mut seq: u64) -> u64 {
    let begun = Instant::now();
    loop {
        assert!(begun.elapsed() < LONG, "{}; {}", sender.counts(), receiver.counts());
        send(sender, seq);
        if let Some(received) = receiver.take(STEP).last() {
            let found = content(&received);
            assert_eq!(found.detections.len(), 300);
            assert_eq!(found.detections[299].x_m, found.head.seq as f32);
            return found.head.seq;
        }
        seq += 1;
    }
}

#[test]
fn frames_arrive_over_tcp_and_over_a_unix_socket() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("socket");
    for address in ["127.0.0.1:0", "[::1]:0", path.to_str().unwrap()] {
        let mut sender = sender(address, LONG);
        let receivers = [(); RECEIVERS_MAX].map(|()| receiver(link(&sender, key(), LONG)));
        for receiver in &receivers {
            exchanged(&mut sender, receiver, 1);
        }
        assert_eq!(sender.counts().connected.get(), RECEIVERS_MAX as u64, "{}", sender.counts());
        let one_more = receiver(link(&sender, key(), LONG));
        wait_count("full", &sender.counts().full, 1);
        assert_eq!(one_more.counts().connected.get(), 0);
    }
}

#[test]
fn another_key_is_refused_and_counted_at_both_ends() {
    let mut right = sender("127.0.0.1:0", LONG);
    for key in [Key::new(vec![8; 32]), Key::none()] {
        let before = right.counts().wrong_key.get();
        let wrong = receiver(link(&right, key, LONG));
        wait_count("wrong key", &right.counts().wrong_key, before + 2);
        assert_eq!((wrong.counts().connected.get(), wrong.counts().frames.get()), (0, 0));
    }
    let receiver = receiver(link(&right, key(), LONG));
    exchanged(&mut right, &receiver, 1);
    assert_eq!(right.counts().garbage.get(), 0);
}

/// A sender without the key that follows the protocol otherwise.
#[test]
fn a_sender_without_the_key_is_refused_and_counted() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = Address::Tcp(listener.local_addr().unwrap());
    let link = Link {
        address,
        kind: Kind::Detections,
        key: key(),
        timeout: LONG,
        max_age: LONG,
        clock_offset_ns: None,
    };
    let receiver = receiver(link);
    let (mut socket, _) = listener.accept().unwrap();
    let mut hello = b"STGB\x01\0\x02\0".to_vec();
    hello.extend_from_slice(&[5; 16]);
    socket.write_all(&hello).unwrap();
    socket.read_exact(&mut [0; 48]).unwrap();
    let mut frame = Vec::new();
    bridge::frame::begin(&mut frame, &bridge::frame::Envelope::new(Kind::Alive, 1), &[]);
    bridge::frame::seal(&mut frame, &Key::new(vec![9; 32]).session(&hello, &[]));
    socket.write_all(&frame).unwrap();
    wait_count("wrong key", &receiver.counts().wrong_key, 1);
    let (mut socket, _) = listener.accept().unwrap();
    socket.write_all(b"SSH-2.0-OpenSSH_9.6 and some more bytes\r\n").unwrap();
    wait_count("garbage", &receiver.counts().garbage, 1);
    assert_eq!((receiver.counts().connected.get(), receiver.counts().frames.get()), (0, 0));
}

#[test]
fn garbage_is_refused_and_counted_and_harms_nobody() {
    let mut sender = sender("127.0.0.1:0", LONG);
    let receiver = receiver(link(&sender, key(), LONG));
    let seq = exchanged(&mut sender, &receiver, 1);
    let Address::Tcp(address) = *sender.address() else { panic!("no TCP") };
    let version = b"STGB\x02\0\x02\0";
    let kind = b"STGB\x01\0\x01\0";
    let texts: [&[u8]; 4] = [b"GET / HTTP/1.1\r\nHost: a\r\n\r\n", &[0xff; 4096], version, kind];
    for (count, text) in texts.iter().enumerate() {
        let mut socket = TcpStream::connect(address).unwrap();
        let mut bytes = text.to_vec();
        bytes.resize(bytes.len().max(48), 0);
        socket.write_all(&bytes).unwrap();
        wait_count("garbage", &sender.counts().garbage, count as u64 + 1);
    }
    assert!(exchanged(&mut sender, &receiver, seq + 1) > seq);
    assert_eq!(receiver.counts().connected.get(), 1, "the same connection");
}

#[test]
fn connections_that_say_nothing_keep_no_place_from_a_receiver_with_the_key() {
    let mut sender = sender("127.0.0.1:0", LONG);
    let Address::Tcp(address) = *sender.address() else { panic!("no TCP") };
    let mut idle: Vec<TcpStream> =
        (0..3 * GREETINGS_MAX).map(|_| TcpStream::connect(address).unwrap()).collect();
    // The oldest ones yield, and the others are ended soon.
    wait("they yield", || sender.counts().full.get() >= GREETINGS_MAX as u64);
    let receiver = receiver(link(&sender, key(), LONG));
    exchanged(&mut sender, &receiver, 1);
    for socket in &mut idle {
        let _ = socket.read_to_end(&mut Vec::new());
    }
}

/// The bytes of a greeting with the right key, as a receiver in another language sends them.
fn greeted(sender: &Sender) -> TcpStream {
    let Address::Tcp(address) = *sender.address() else { panic!("no TCP") };
    let mut socket = TcpStream::connect(address).unwrap();
    let mut hello = [0; 24];
    socket.read_exact(&mut hello).unwrap();
    let mut mine = b"STGB\x01\0\x02\0".to_vec();
    mine.resize(32, 3);
    let code = key().receiver_code(&hello, &mine);
    socket.write_all(&[&mine[..], &code].concat()).unwrap();
    socket
}

/// A receiver that is stopped: the kernel takes its bytes, and nobody confirms them.
#[test]
fn a_receiver_that_confirms_nothing_is_dropped_and_counted() {
    let mut sender = sender("127.0.0.1:0", SHORT);
    let mut socket = greeted(&sender);
    wait("connected", || sender.receivers() == 1);
    for seq in 0..100 {
        send(&mut sender, seq);
    }
    wait_count("slow", &sender.counts().slow, 1);
    assert_eq!(sender.receivers(), 0);
    let mut bytes = Vec::new();
    // The connection may end with a reset.
    let _ = socket.read_to_end(&mut bytes);
    assert!(sender.counts().frames.get() < WINDOW as u64, "one place has the frame that greets");
    assert!(bytes.len() <= WINDOW * bridge::frame::FRAME_BYTES_MAX);
}

#[test]
fn a_confirmation_with_a_wrong_code_or_number_ends_the_connection() {
    let sender = sender("127.0.0.1:0", LONG);
    let mut socket = greeted(&sender);
    socket.write_all(&[1; 32]).unwrap();
    wait_count("wrong key", &sender.counts().wrong_key, 1);
}

#[test]
fn a_slow_receiver_gets_the_newest_frame_and_no_backlog() {
    let mut sender = sender("127.0.0.1:0", LONG);
    let receiver = Receiver::start(link(&sender, key(), LONG), 1).unwrap();
    let seq = exchanged(&mut sender, &receiver, 1);
    for seq in seq + 1..=seq + 1_000 {
        send(&mut sender, seq);
    }
    // The newest one is never skipped, and the queue holds one frame.
    let mut newest = 0;
    wait("the newest", || {
        newest = receiver.take(STEP).last().map_or(newest, |received| content(&received).head.seq);
        newest == seq + 1_000
    });
    let sent = sender.counts().frames.get() + sender.counts().skipped.get();
    assert!(sender.counts().skipped.get() > 0 && sent >= 1_000, "{}", sender.counts());
}

#[test]
fn a_lost_sender_comes_back_and_old_frames_do_not() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("socket");
    let path = path.to_str().unwrap();
    let mut first = sender(path, SHORT);
    let receiver = receiver(link(&first, key(), SHORT));
    let seq = exchanged(&mut first, &receiver, 1);
    drop(first);
    wait_count("lost", &receiver.counts().lost, 1);
    let mut second = sender(path, SHORT);
    // Before a receiver is there.
    send(&mut second, seq + 1);
    wait_count("again", &receiver.counts().connected, 2);
    let _ = receiver.take(SHORT).last();
    assert_eq!(exchanged(&mut second, &receiver, seq + 1_000) / (seq + 1_000), 1);
    // Without ticks the link stays up.
    std::thread::sleep(4 * SHORT);
    assert_eq!(receiver.counts().connected.get(), 2, "{}", receiver.counts());
}

#[test]
fn frames_beyond_the_greatest_age_are_not_delivered() {
    let mut sender = sender("127.0.0.1:0", LONG);
    let max_age = Duration::from_secs(3_600);
    let receiver = receiver(Link { max_age, ..link(&sender, key(), LONG) });
    exchanged(&mut sender, &receiver, 1);
    let head = TickHead::default();
    let released_ns = monotonic_ns();
    let old_ns = released_ns.checked_sub(3_700_000_000_000);
    // A machine that has just booted has no such time.
    let Some(old_ns) = old_ns else { return };
    sender.send(old_ns, |body| detections::write(body, &head, &[]));
    wait_count("old", &receiver.counts().old, 1);
    let later = exchanged(&mut sender, &receiver, 2_000);
    assert!(later >= 2_000);
}
