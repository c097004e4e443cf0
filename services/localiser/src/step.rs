use model::ModelConfig;
use ports::{Answer, NoTopic, StageError, Step, Tick, drive};
use run::Run;
use scene::{ContextMap, PatchOptions};
use wire::{ContextMut, ContextTopic, Rejected, TracksTopic, context_rows};

use crate::{Localiser, LocaliserOptions, MapChoice, MapSource, STAGE};

/// Runs the localiser as a process: `tracks` in, `context` out.
///
/// # Errors
/// [`StageError`] if the map or the run's model, options or shared memory can't be used.
pub fn run(run: &Run) -> Result<(), StageError> {
    drive(run, &STAGE, |run| {
        let model = ModelConfig::of_run(&run.root).map_err(StageError::config)?;
        Ok(Localiser::new(settings(run, &model)?))
    })
}

/// The localiser's settings in a run with `model`. Loads the map file, if the run has one.
///
/// # Errors
/// [`StageError`] if the map or the run's options can't be used.
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

impl Step for Localiser {
    type Input = TracksTopic;
    type Second = NoTopic;
    type Output = ContextTopic;

    fn answer(
        &mut self,
        tick: &Tick<'_, TracksTopic>,
        out: &mut Answer<'_, ContextTopic>,
    ) -> Result<(), Rejected> {
        let shape = self.shape(tick.input.len());
        out.header.counts.patch_side = shape.patch_side as u32;
        let mut context = ContextMut::over(out.elements(context_rows(&shape))?, shape)?;
        self.step(tick.header, tick.input, &mut context)
    }
}
