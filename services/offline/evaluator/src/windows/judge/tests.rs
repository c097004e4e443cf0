use data::{GeneratedScene, SceneOptions};
use nn::Weights;

use super::*;
use crate::scenes::Cut;

/// A generated recording with this number of frames, and its scenes.
fn footage(forecaster: &Forecaster, seed: u64, frames: usize) -> (Recording, Vec<Scene>) {
    let options =
        SceneOptions { agents: 24, seed, identities: true, miss_probability: 0.0, ..SceneOptions::default() };
    let recording = GeneratedScene::new(options).unwrap().recording(frames);
    let scenes = Cut::of(forecaster.config()).scenes(&recording);
    (recording, scenes)
}

/// The forecasts of each scene of a recording with this number of frames, after a visit to another one.
fn variants(forecaster: &Forecaster, frames: usize) -> Vec<Vec<(usize, Variants)>> {
    let (recording, scenes) = footage(forecaster, 3, frames);
    let mut memory = forecaster.memory();
    let (before, scenes_before) = footage(forecaster, 4, 400);
    forecaster.visit(&before, &scenes_before, MapInput::None, 2, &mut memory);
    forecaster.variants(&recording, &scenes, MapInput::None, 2, Some(memory))
}

#[test]
fn retrieval_does_not_depend_on_the_future() {
    let forecaster = Forecaster::new(Weights::onboard(), 1).unwrap();
    let (short, long) = (variants(&forecaster, 500), variants(&forecaster, 700));
    assert!(short.len() > 60 && long.len() > short.len());
    for (short, long) in short.iter().zip(&long) {
        for (place, variants) in short {
            let same = long.iter().find(|(other, _)| other == place);
            assert_eq!(same.map(|(_, variants)| variants), Some(variants));
        }
    }
    let changed = |of: Method| {
        let all = short.iter().flatten();
        all.filter(|(_, variants)| variants[of.index()] != variants[Method::Network.index()]).count()
    };
    let [online, warm_started] = [Method::OnlineRetrieval, Method::WarmStartedRetrieval].map(changed);
    assert!(online > 100, "{online} forecasts changed by retrieval");
    assert!(warm_started > online + 100, "{warm_started} with a warm start, {online} without");
}
