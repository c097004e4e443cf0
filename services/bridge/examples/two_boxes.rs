//! Measures a link: `two_boxes send ADDRESS AGENTS SECONDS` on one box and `two_boxes receive ADDRESS SECONDS` on
//! another one. `tests/interop/bridge_table.py` runs both on one machine, so that both have one clock.
//!
//! The sender stamps each frame with `CLOCK_MONOTONIC` before it is written. The receiver prints for each frame
//! its number, its latency by this stamp, its age as the bridge reports it, and its arrival, in µs.

use std::error::Error;
use std::io::Write as _;
use std::time::{Duration, Instant};

use bridge::auth::Key;
use bridge::frame::{Kind, TickHead, forecasts};
use bridge::receiver::{Body, Link, Receiver};
use bridge::sender::Sender;
use bytemuck::Zeroable as _;
use ports::monotonic_ns;
use wire::{Forecast, HORIZON_MAX, TICK_NS};

const MODES: usize = 3;
const TIMEOUT: Duration = Duration::from_secs(1);
const MAX_AGE: Duration = Duration::from_millis(500);
const WAIT: Duration = Duration::from_millis(100);

fn key() -> Key {
    Key::new(vec![0x5a; 32])
}

fn forecast(id: u64) -> Forecast {
    let mut forecast = Forecast { id, modes_len: 20, ..Forecast::zeroed() };
    forecast.probability.fill(0.05);
    for step in 0..HORIZON_MAX {
        forecast.best[step] = [step as f32, id as f32];
        forecast.modes.iter_mut().for_each(|mode| mode[step] = [step as f32, 0.0]);
    }
    forecast
}

fn send(address: &str, agents: u64, seconds: u64) -> Result<(), Box<dyn Error>> {
    let mut sender = Sender::listen(&address.parse()?, Kind::Forecasts, key(), TIMEOUT)?;
    let elements: Vec<Forecast> = (0..agents).map(forecast).collect();
    let begun = Instant::now();
    for seq in 0..seconds * 1_000_000_000 / TICK_NS {
        let due = Duration::from_nanos(seq * TICK_NS);
        std::thread::sleep(due.saturating_sub(begun.elapsed()));
        let stamp_ns = monotonic_ns();
        let head = TickHead {
            seq,
            stamp_ns: stamp_ns as i64,
            horizon_len: HORIZON_MAX as u8,
            ..TickHead::default()
        };
        sender.send(stamp_ns, |body| forecasts::write(body, &head, &elements, MODES));
    }
    std::thread::sleep(TIMEOUT);
    writeln!(std::io::stderr(), "sender: {}", sender.counts())?;
    Ok(())
}

fn receive(address: &str, seconds: u64) -> Result<(), Box<dyn Error>> {
    let link = Link {
        address: address.parse()?,
        kind: Kind::Forecasts,
        key: key(),
        timeout: TIMEOUT,
        max_age: MAX_AGE,
        clock_offset_ns: None,
    };
    let receiver = Receiver::start(link, 8)?;
    let begun = Instant::now();
    let mut output = std::io::stdout().lock();
    while begun.elapsed() < Duration::from_secs(seconds) {
        for received in receiver.take(WAIT) {
            let Body::Forecasts(found) = received.body else { continue };
            let latency_ns = received.arrived_ns as i64 - found.head.stamp_ns;
            let (latency_us, age_us, arrived_us) =
                (latency_ns / 1_000, received.age_ns / 1_000, received.arrived_ns / 1_000);
            writeln!(output, "{} {latency_us} {age_us} {arrived_us}", found.head.seq)?;
        }
    }
    writeln!(std::io::stderr(), "receiver: {}", receiver.counts())?;
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match &arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["send", address, agents, seconds] => send(address, agents.parse()?, seconds.parse()?),
        ["receive", address, seconds] => receive(address, seconds.parse()?),
        _ => Err("usage: send ADDRESS AGENTS SECONDS, or receive ADDRESS SECONDS".into()),
    }
}
