//! A reader such as a planner: prints the forecasts of a run, tick by tick. Start it while `stgdat run`
//! is running; if several runs are, `--run NAME` chooses one.
//!
//! Positions are in metres. They are printed in the frame of map and detections: the run's origin is added.
//! The time of step k of a forecast is the frame's stamp + (k + 1) Δt. A planner does the same: it waits,
//! takes the newest frame, reads it in shared memory, and drops it.

use std::process::ExitCode;
use std::time::Duration;

use ports::{Node, StageError, stage_main};
use run::Run;
use wire::{AGENT_TYPES, ForecastsTopic, Quality, flags};

fn run(run: &Run) -> Result<(), StageError> {
    let node = Node::open(run, "consumer")?;
    let forecasts = node.subscriber::<ForecastsTopic>(2)?;
    while !node.stop().requested() {
        // Sleeps until a frame arrives. The subscriber drops frames with an impossible header.
        forecasts.sleep(Duration::from_secs(2))?;
        while let Some(frame) = forecasts.receive()? {
            let header = frame.header();
            if header.has(flags::END) {
                return Ok(());
            }
            if !header.is_tick() {
                continue;
            }
            println!("tick {} at {:.2} s: {} agents", header.seq, header.stamp_ns as f64 / 1e9, frame.len());
            let last = (header.counts.horizon_len as usize).saturating_sub(1);
            for agent in frame.iter() {
                let name = AGENT_TYPES.get(agent.agent_type as usize).map_or("unknown", |t| t.name());
                let quality = Quality::ALL.get(agent.quality as usize).map_or("unknown", |q| q.name());
                let own_m = |world_m| run.origin().own_m(world_m);
                let ([x_m, y_m], [end_x_m, end_y_m]) =
                    (own_m([agent.x_m, agent.y_m]), own_m(agent.best[last]));
                let way = format!("at ({x_m:.1}, {y_m:.1}) goes to ({end_x_m:.1}, {end_y_m:.1})");
                println!("  {name} {} {way}, {} modes, {quality}", agent.id, agent.modes_len);
            }
        }
    }
    Ok(())
}

fn main() -> ExitCode {
    stage_main(run)
}
