//! The localiser as a process: `tracks` in, `context` out.

use model::ModelConfig;
use ports::{Stage, StageError};
use run::Run;
use scene::{ContextMap, PatchOptions};
use wire::{ContextMut, ContextTopic, TracksTopic, context_rows};

use crate::{Localiser, LocaliserOptions, MapChoice, MapSource, STAGE};

/// Runs the stage until the process is asked to end.
///
/// # Errors
/// [`StageError`] where the map or the run's model, options or shared memory can't be used.
pub fn run(run: &Run) -> Result<(), StageError> {
    let model = ModelConfig::of_run(&run.root).map_err(StageError::config)?;
    let mut localiser = Localiser::new(settings(run, &model)?);

    let mut stage = Stage::open(run, &STAGE)?;
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

/// The localiser's settings in a run with that model, its map opened.
///
/// # Errors
/// [`StageError`] where the map or the run's options can't be used.
pub fn settings(run: &Run, model: &ModelConfig) -> Result<LocaliserOptions, StageError> {
    let map = match STAGE.options(run)?.map {
        MapChoice::Online => MapSource::Online,
        MapChoice::None => MapSource::None,
        MapChoice::File(path) => MapSource::Fixed(ContextMap::load(&path).map_err(StageError::data)?),
    };
    let patch =
        PatchOptions { side: model.patch_size, cell_m: model.patch_cell_m, ahead_m: model.patch_ahead_m };
    Ok(LocaliserOptions { history_len: model.history_len, patch, map })
}
