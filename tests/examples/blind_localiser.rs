//! A stage in place of the project's: a localiser without a map,
//! `command = ["target/release/examples/blind_localiser"]` in its table of pipeline.toml.
//!
//! It shows what every stage does: declare its topics, open the ports, take a frame, write the next one
//! straight into shared memory, send it. `ports::Stage` does heartbeats, warm-up frames and the end.

use std::process::ExitCode;

use model::ModelConfig;
use ports::{Stage, StageError, stage_main};
use run::{Declaration, NoOptions, Run};
use wire::{ContextMut, ContextShape, ContextTopic, StageId, Topic, TracksTopic, context_rows};

/// The stage that it replaces, with the topics that it reads and writes.
const STAGE: Declaration<NoOptions> =
    Declaration::new(StageId::Localiser, &[TracksTopic::NAME], &[ContextTopic::NAME]);

fn run(run: &Run) -> Result<(), StageError> {
    let ModelConfig { history_len, patch_size: patch_side, .. } =
        ModelConfig::of_run(&run.root).map_err(StageError::config)?;
    let mut stage = Stage::open(run, &STAGE)?;
    let tracks = stage.subscribe::<TracksTopic>()?;
    let output = stage.publish::<ContextTopic>()?;

    while let Some(input) = stage.next(&tracks, &output)? {
        let mut passage = stage.begin(&input);
        let shape = ContextShape { agents_len: input.len(), history_len, patch_side };
        passage.header.counts.patch_side = patch_side as u32;
        let mut loan = output.loan(context_rows(&shape))?;
        let result = ContextMut::over(&mut loan, shape).map(|context| {
            context.tracks.copy_from_slice(&input);
            // Your map's patches go here. A loan may still hold an earlier frame.
            context.patches.fill(0.0);
        });
        stage.finish(passage, &output, result.map(|()| loan))?;
    }
    Ok(())
}

fn main() -> ExitCode {
    stage_main(run)
}
