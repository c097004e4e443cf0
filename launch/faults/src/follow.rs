//! The follower: an additional reader of `forecasts` and `heartbeats` that prints the history as lines.

use std::io::Write as _;
use std::path::Path;
use std::time::Duration;

use crate::checker::{Line, Output};
use ports::{Node, Peers};
use run::{Exit, Run};
use wire::{ForecastsTopic, HeartbeatsTopic, StageId, Topic};

use console::failure::Failure;

/// Longest sleep. Heartbeats do not wake the follower.
const SLEEP: Duration = Duration::from_millis(20);

/// Follows a run until the process is asked to end or the run's folder is gone.
pub fn follow(record: &Path) -> Result<Exit, Failure> {
    let run = Run::read(record).map_err(Failure::config)?;
    let node = Node::open(&run, "follower")?;
    let forecasts = node.subscriber::<ForecastsTopic>(ForecastsTopic::DEPTH_MAX)?;
    let mut peers = Peers::new(node.subscriber(HeartbeatsTopic::DEPTH_MAX)?, &run);
    let mut newest = std::collections::BTreeMap::new();
    while !node.stop().requested() && run.root.exists() {
        forecasts.sleep(SLEEP)?;
        while let Some(frame) = forecasts.receive()? {
            if frame.header().is_tick() {
                print(&Line::Forecasts(Output::of(frame.header(), frame.received_ns(), &frame)))?;
            }
        }
        for heartbeat in peers.listen()? {
            let Some(stage) = StageId::from_number(heartbeat.stage) else { continue };
            let (tick, incarnation) = (heartbeat.seq, heartbeat.incarnation);
            if heartbeat.frames_len > 0
                && newest.insert(stage, (tick, incarnation)) != Some((tick, incarnation))
            {
                print(&Line::Reached { stage: stage.name().to_owned(), tick, incarnation })?;
            }
        }
    }
    // The launcher removes the run's files. Ports dropped after that would look for them.
    std::mem::forget((forecasts, peers, node));
    Ok(Exit::Done)
}

/// Writes a line to standard output immediately.
pub fn print(line: &Line) -> Result<(), Failure> {
    let mut output = std::io::stdout().lock();
    let text = serde_json::to_string(line).map_err(Failure::data)?;
    writeln!(output, "{text}")
        .and_then(|()| output.flush())
        .map_err(|error| Failure::output(Path::new("-"), error))
}
