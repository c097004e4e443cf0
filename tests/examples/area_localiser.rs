//! A localiser that knows a round drivable area. It replaces the shipped one with
//! `command = ["target/release/examples/area_localiser"]` in the localiser's table of pipeline.toml.
//!
//! A stage is a `Step`: it computes its output of a tick from its input. `drive` opens the ports, waits for
//! frames, sends heartbeats, passes on frames that are not ticks, and ends on request.

use std::process::ExitCode;

use model::ModelConfig;
use ports::{Answer, NoTopic, StageError, Step, Tick, drive, stage_main};
use run::{Conflict, Declaration, Run};
use serde::Deserialize;
use wire::{
    ContextMut, ContextShape, ContextTopic, HistoryState, Rejected, StageId, Topic, TracksTopic, context_rows,
};

/// The stage that this program replaces, the topics that it reads and writes, and the rule for its options.
const STAGE: Declaration<Options> =
    Declaration::new(StageId::Localiser, &[TracksTopic::NAME], &[ContextTopic::NAME])
        .with_rule(Options::check);

/// `options = { radius_m = 50 }` in its table of pipeline.toml, or `--set localiser.radius_m=50`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Options {
    /// Radius of the drivable area about the origin of the world frame.
    radius_m: f32,
}

impl Default for Options {
    fn default() -> Self {
        Self { radius_m: 50.0 }
    }
}

impl Options {
    fn check(&self) -> Result<(), Conflict> {
        if self.radius_m > 0.0 {
            return Ok(());
        }
        Err(Conflict {
            key: "radius_m",
            reason: "`radius_m` is not positive",
            because: "an area has a radius",
        })
    }
}

/// The stage with the data that it needs in each tick.
struct AreaLocaliser {
    model: ModelConfig,
    options: Options,
    drawn: Drawn,
}

impl Step for AreaLocaliser {
    type Input = TracksTopic;
    type Second = NoTopic;
    type Output = ContextTopic;

    fn answer(
        &mut self,
        tick: &Tick<'_, TracksTopic>,
        out: &mut Answer<'_, ContextTopic>,
    ) -> Result<(), Rejected> {
        let Self { model, options, drawn } = self;
        let shape = ContextShape {
            agents_len: tick.input.len(),
            history_len: model.history_len,
            patch_side: model.patch_size,
        };
        out.header.counts.patch_side = shape.patch_side as u32;
        let mut context = ContextMut::over(out.elements(context_rows(&shape))?, shape)?;
        context.tracks.copy_from_slice(tick.input);
        // The memory may contain an earlier frame.
        context.patches.fill(0.0);
        for (agent, track) in tick.input.iter().enumerate() {
            let history = track.history[..shape.history_len].iter().enumerate();
            for (step, state) in history.filter(|(_, state)| state.present != 0) {
                let patch = context.patch_mut(agent, step);
                write_density(state, options, model, patch);
                drawn.add(track.id, &patch[..model.patch_size * model.patch_size]);
            }
        }
        Ok(())
    }

    fn end(&mut self, _: &Run) -> Result<(), StageError> {
        // The launcher prints this with the stage's name in front.
        self.drawn.print(self.options.radius_m, self.model.patch_size);
        Ok(())
    }
}

fn open(run: &Run) -> Result<AreaLocaliser, StageError> {
    let model = ModelConfig::of_run(&run.root).map_err(StageError::config)?;
    Ok(AreaLocaliser { model, options: STAGE.options(run)?, drawn: Drawn::default() })
}

/// Counts and an example of the drawn patches.
#[derive(Default)]
struct Drawn {
    patches: u64,
    cells: u64,
    /// Number of cells in the area.
    inside: u64,
    /// The newest patch that the edge of the area crosses, and its agent.
    edge: Option<(u64, Vec<f32>)>,
}

impl Drawn {
    fn add(&mut self, agent: u64, patch: &[f32]) {
        let inside = patch.iter().filter(|density| **density > 0.0).count();
        self.patches += 1;
        self.cells += patch.len() as u64;
        self.inside += inside as u64;
        if (1..patch.len()).contains(&inside) {
            let (newest, cells) = self.edge.get_or_insert_with(|| (agent, patch.to_vec()));
            *newest = agent;
            cells.copy_from_slice(patch);
        }
    }

    fn print(&self, radius_m: f32, side: usize) {
        let Self { patches, cells, inside, edge } = self;
        eprintln!("drew {patches} patches: {inside} of {cells} cells lie within {radius_m} m of the origin");
        let Some((agent, cells)) = edge else { return };
        eprintln!("the newest patch at the edge, of agent {agent}, which looks up:");
        for row in cells.chunks(side) {
            let marks = row.iter().map(|density| if *density > 0.0 { "##" } else { "··" });
            eprintln!("{}", marks.collect::<String>());
        }
    }
}

/// Writes channel 0 of a patch, \[channel, row, column\]: 1 in the area, 0 elsewhere. Row 0 is farthest ahead
/// of the agent, and column 0 is leftmost. Channels 1 and 2, the velocities, stay 0.
fn write_density(state: &HistoryState, options: &Options, model: &ModelConfig, patch: &mut [f32]) {
    let side = model.patch_size;
    let half = (side as f32 - 1.0) / 2.0;
    let (sin, cos) = state.heading_rad.sin_cos();
    for (cell, density) in patch[..side * side].iter_mut().enumerate() {
        let ahead_m = (half - (cell / side) as f32) * model.patch_cell_m + model.patch_ahead_m;
        let left_m = (half - (cell % side) as f32) * model.patch_cell_m;
        let (x_m, y_m) = (state.x_m + cos * ahead_m - sin * left_m, state.y_m + sin * ahead_m + cos * left_m);
        *density = f32::from(u8::from(x_m.hypot(y_m) <= options.radius_m));
    }
}

fn main() -> ExitCode {
    stage_main(|run| drive(run, &STAGE, open))
}
