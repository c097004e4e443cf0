//! The localiser as a process: `tracks` in, `context` out.

use config::{MapChoice, Run};
use ports::{Stage, StageError};
use scene::{ContextMap, PatchOptions};
use wire::{ContextMut, ContextTopic, StageId, TracksTopic, context_rows};

use crate::{Localiser, LocaliserOptions, MapSource};

/// Runs the stage until the process is asked to end.
///
/// # Errors
/// [`StageError`] where the map or the run's shared memory can't be used.
pub fn run(run: &Run) -> Result<(), StageError> {
    let mut localiser = Localiser::new(options(run)?);

    let mut stage = Stage::open(run, StageId::Localiser)?;
    let tracks = stage.subscribe::<TracksTopic>()?;
    let output = stage.publish::<ContextTopic>()?;

    while let Some(input) = stage.next(&tracks, &output)? {
        let mut passage = stage.begin(&input);
        let shape = localiser.shape(input.len());
        passage.header.counts.patch_side = shape.patch_side as u32;
        let mut loan = output.loan(context_rows(&shape))?;
        let result = ContextMut::over(&mut loan, shape)
            .and_then(|mut context| localiser.step(input.header(), &input, &mut context));
        stage.finish(passage, &output, result.map(|()| loan))?;
    }
    Ok(())
}

/// The run's settings of the localiser, its map opened.
///
/// # Errors
/// [`StageError::Data`] where the map can't be used.
pub fn options(run: &Run) -> Result<LocaliserOptions, StageError> {
    let map = match &run.map {
        MapChoice::Online => MapSource::Online,
        MapChoice::None => MapSource::None,
        MapChoice::File(path) => MapSource::Fixed(ContextMap::load(path).map_err(StageError::data)?),
    };
    let patch = PatchOptions {
        side: run.model.patch_size,
        cell_m: run.model.patch_cell_m,
        ahead_m: run.model.patch_ahead_m,
    };
    Ok(LocaliserOptions { history_len: run.model.history_len, patch, map })
}
