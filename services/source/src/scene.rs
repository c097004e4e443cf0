use config::Scene;
use data::{GeneratedScene, Recording, SceneOptions};
use ports::StageError;

/// Length of a generated scene where nobody says how many ticks: 20 s.
const GENERATED_TICKS: u64 = 250;

/// Opens the recording, or generates the scene, that a run plays.
///
/// # Errors
/// [`StageError::Data`] with file, line, column and value; [`StageError::Config`] where the format has an unknown name.
pub fn recording(scene: &Scene, seed: u64, ticks: Option<u64>) -> Result<Recording, StageError> {
    match scene {
        Scene::Recording { path, format } => {
            let format = format.as_deref().map(str::parse).transpose().map_err(StageError::config)?;
            data::open(path, format).map_err(StageError::data)
        }
        Scene::Generated { agents_len } => {
            let options = SceneOptions { agents: *agents_len, seed, ..SceneOptions::default() };
            let scene = GeneratedScene::new(options).map_err(StageError::config)?;
            let ticks = usize::try_from(ticks.unwrap_or(GENERATED_TICKS)).map_err(StageError::config)?;
            Ok(scene.recording(ticks))
        }
    }
}
