//! The reference for one hop between processes: 64 bytes forth and back through two pipes.

use std::io::{Read, Write};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use console::failure::Failure;

/// Measures the one-way latency in ms of `pings` messages at 12.5 Hz.
pub(super) fn hops_ms(pings: usize) -> Result<Vec<f64>, Failure> {
    let unavailable = |error: std::io::Error| Failure::unavailable_about("cat", error);
    let mut echo =
        Command::new("cat").stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().map_err(unavailable)?;
    let pipes = echo.stdin.take().zip(echo.stdout.take());
    let (mut there, mut back) = pipes.ok_or_else(|| Failure::unavailable("cat: no pipes"))?;
    let mut message = [7_u8; 64];
    let mut hops_ms = Vec::with_capacity(pings);
    for _ in 0..pings {
        std::thread::sleep(Duration::from_millis(80));
        let start = Instant::now();
        there.write_all(&message).and_then(|()| back.read_exact(&mut message)).map_err(unavailable)?;
        hops_ms.push(start.elapsed().as_secs_f64() * 1e3 / 2.0);
    }
    drop(there);
    echo.wait().map_err(unavailable)?;
    Ok(hops_ms)
}
