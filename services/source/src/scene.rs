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
        let open = OpenOptions { format: options.format, fps, origin, topics: options.topics.clone() };
        return data::open_with(path, open).map_err(StageError::data);
    }
    let scene = GeneratedScene::new(generated_scene(options, seed)).map_err(StageError::config)?;
    let ticks = usize::try_from(options.ticks.unwrap_or(GENERATED_TICKS)).map_err(StageError::config)?;
    Ok(scene.recording(ticks))
}

/// The generated scene that is played if no recording is given.
#[must_use]
pub fn generated_scene(options: &Options, seed: u64) -> SceneOptions {
    let scene = SceneOptions { agents: options.agents, seed, ..SceneOptions::default() };
    options.noise_m.map_or(scene, |noise_m| scene.with_noise(noise_m))
}

#[cfg(test)]
mod tests {
    use data::{Frame, Recording};
    use wire::{Detection, Truth};

    use super::*;

    fn scene(noise_m: Option<f32>) -> Recording {
        let options = Options { noise_m, ticks: Some(500), ..Options::default() };
        recording(&options, WorldOrigin::default(), 3).expect("valid options")
    }

    /// The detections whose agent is known: the only agent of its type within 2 m.
    fn matched(frame: &Frame) -> impl Iterator<Item = (&Detection, &Truth)> {
        frame.detections.iter().filter_map(|detection| {
            let near = |truth: &&Truth| {
                truth.agent_type == detection.agent_type
                    && (truth.x_m - detection.x_m).hypot(truth.y_m - detection.y_m) < 2.0
            };
            let mut near = frame.truth.iter().filter(near);
            Some((detection, near.next()?)).filter(|_| near.next().is_none())
        })
    }

    /// Root mean square of the error on the x axis.
    fn noise_m(recording: &Recording, agent_type: u32) -> f64 {
        let pairs = recording.frames.iter().flat_map(matched);
        let errors_m = pairs.filter(|(d, _)| d.agent_type == agent_type).map(|(d, t)| d.x_m - t.x_m);
        let (sum, len) = errors_m.fold((0.0, 0.0), |(sum, len), m| (sum + f64::from(m).powi(2), len + 1.0));
        assert!(len > 500.0, "{len} detections");
        (sum / len).sqrt()
    }

    #[test]
    fn detections_have_the_noise_of_a_detector_unless_another_is_given() {
        for (given_m, expected_m) in [(None, [0.15, 0.12, 0.08]), (Some(0.3), [0.3; 3])] {
            let recording = scene(given_m);
            for (agent_type, expected_m) in (0..).zip(expected_m) {
                let found_m = noise_m(&recording, agent_type);
                // Clutter close to an agent adds a little.
                assert!((found_m / expected_m - 1.0).abs() < 0.25, "{given_m:?}, {agent_type}: {found_m}");
            }
        }
    }

    #[test]
    fn without_noise_detections_are_exact() {
        let recording = scene(Some(0.0));
        let exact = |(d, t): &(&Detection, &Truth)| (d.x_m, d.y_m) == (t.x_m, t.y_m);
        let [exact_len, all_len] = [true, false].map(|only_exact| {
            recording.frames.iter().flat_map(matched).filter(|pair| !only_exact || exact(pair)).count()
        });
        assert!(exact_len * 200 > all_len * 199, "{exact_len} of {all_len}: only clutter is not exact");
        assert!(recording.frames.iter().flat_map(|frame| &frame.detections).all(|d| d.sigma_m == 0.0));
    }

    #[test]
    fn noise_changes_neither_truth_nor_the_kind_of_detections() {
        let [exact, noisy, usual] = [Some(0.0), Some(0.1), None].map(scene);
        for other in [&noisy, &usual] {
            for (a, b) in exact.frames.iter().zip(&other.frames) {
                assert_eq!((&a.truth, a.detections.len()), (&b.truth, b.detections.len()));
                assert!(a.detections.iter().zip(&b.detections).all(|(a, b)| a.flags == b.flags));
            }
        }
    }

    #[test]
    fn a_scene_repeats_to_the_bit() {
        assert_eq!(scene(Some(0.1)).frames, scene(Some(0.1)).frames);
    }
}
