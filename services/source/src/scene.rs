use data::{FrameRate, GeneratedScene, OpenOptions, Recording, SceneOptions};
use ports::StageError;
use wire::WorldOrigin;

use crate::Options;

/// Default length of a generated scene, in ticks: 20 s.
const GENERATED_TICKS: u64 = 250;

/// Opens the recording of a run, or generates its scene from `seed`. `origin` is the origin of the world
/// frame, in the recording's own frame.
///
/// # Errors
/// [`StageError::Data`] with file, line, column and value if the recording can't be read.
/// [`StageError::Config`] if the options are invalid or the scene can't be generated.
pub fn recording(options: &Options, origin: WorldOrigin, seed: u64) -> Result<Recording, StageError> {
    if let Some(path) = &options.recording {
        let fps = options.fps.map(FrameRate::new).transpose().map_err(StageError::config)?;
        let open = OpenOptions { format: options.format, fps, origin };
        return data::open_with(path, open).map_err(StageError::data);
    }
    let scene = SceneOptions { agents: options.agents, seed, ..SceneOptions::default() };
    let scene = GeneratedScene::new(scene).map_err(StageError::config)?;
    let ticks = usize::try_from(options.ticks.unwrap_or(GENERATED_TICKS)).map_err(StageError::config)?;
    Ok(scene.recording(ticks))
}
