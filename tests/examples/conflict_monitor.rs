//! A stage outside the tick's path. It reads the forecasts and writes the closest approach of each agent to
//! the ego vehicle to its own topic. No forecast waits for this stage. Lines in pipeline.toml:
//!
//! ```toml
//! [[topic]]
//! name = "approaches"
//! type_name = "approach.1"
//! element_bytes = 16
//!
//! [[stage]]
//! name = "conflict_monitor"
//! command = ["target/release/examples/conflict_monitor"]
//! reads = ["forecasts"]
//! writes = ["approaches"]
//! budget_ms = 5
//! ```

use std::process::ExitCode;

use bytemuck::{Pod, Zeroable};
use ports::{Answer, NoTopic, Step, Tick, drive, stage_main};
use run::{Declaration, NoOptions};
use wire::{AGENTS_MAX, Forecast, ForecastsTopic, Header, Rejected, Topic};

/// The stage's identity comes from pipeline.toml.
const STAGE: Declaration<NoOptions> = Declaration::added(&[ForecastsTopic::NAME], &[Approaches::NAME]);

/// An element of the topic: the agent's closest approach to the ego vehicle on its most probable trajectory.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct Approach {
    /// The agent's number.
    id: u64,
    /// The smallest distance.
    distance_m: f32,
    /// Time from the frame's stamp until then.
    in_s: f32,
}

/// The topic, with one element per agent of the forecasts.
#[derive(Debug)]
enum Approaches {}

impl Topic for Approaches {
    type Element = Approach;
    const NAME: &'static str = "approaches";
    const DOC: &'static str = "How near each agent comes to the ego vehicle.";
    // A new layout needs a new name, so that old readers do not connect.
    const TYPE_NAME: &'static str = "approach.1";
    const ELEMENTS_MAX: usize = AGENTS_MAX;
    const ELEMENTS_START: usize = AGENTS_MAX;
}

/// The stage. It keeps nothing from tick to tick.
struct ConflictMonitor;

impl Step for ConflictMonitor {
    type Input = ForecastsTopic;
    type Second = NoTopic;
    type Output = Approaches;

    fn answer(
        &mut self,
        tick: &Tick<'_, ForecastsTopic>,
        out: &mut Answer<'_, Approaches>,
    ) -> Result<(), Rejected> {
        let approaches = out.elements(tick.input.len())?;
        for (approach, forecast) in approaches.iter_mut().zip(tick.input) {
            *approach = nearest(tick.header, forecast);
        }
        Ok(())
    }
}

/// The nearest step of the most probable trajectory. The ego vehicle is assumed to stand.
fn nearest(header: &Header, forecast: &Forecast) -> Approach {
    let [ego_x_m, ego_y_m] = header.ego_m;
    let step_s = header.step_ns as f32 / 1e9;
    let now = ([forecast.x_m, forecast.y_m], 0.0);
    let steps = forecast.best.iter().take(header.counts.horizon_len as usize).copied();
    let ahead = steps.zip(1_u8..).map(|(at_m, step)| (at_m, f32::from(step) * step_s));
    let distances = std::iter::once(now)
        .chain(ahead)
        .map(|([x_m, y_m], in_s)| ((x_m - ego_x_m).hypot(y_m - ego_y_m), in_s));
    let (distance_m, in_s) = distances.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or_default();
    Approach { id: forecast.id, distance_m, in_s }
}

fn main() -> ExitCode {
    stage_main(|run| drive(run, &STAGE, |_| Ok(ConflictMonitor)))
}
