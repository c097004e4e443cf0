use data::{GeneratedScene, SceneOptions};
use nn::Weights;

use super::*;
use crate::Cut;

/// What is recalled at each scene of a recording that ends after so many frames.
fn recalled(forecaster: &Forecaster, frames: usize) -> Vec<(i64, Vec<Recall>)> {
    let options = SceneOptions {
        agents: 24,
        seed: 3,
        identities: true,
        miss_probability: 0.0,
        ..SceneOptions::default()
    };
    let recording = GeneratedScene::new(options).unwrap().recording(frames);
    let scenes = Cut::of(forecaster.config()).scenes(&recording);
    let baselines = Baselines::fit(std::iter::empty(), &Cut::of(forecaster.config()), 1);
    let judge =
        Judge { forecaster, baselines: &baselines, horizons: &[12], subsets: &[], of_type: None, threads: 2 };
    let table = ContextTable::new(forecaster, &recording, &scenes, MapInput::None, 2);
    let config = forecaster.config();
    let mut place = PlaceMemory::new(config.horizon_len, config.step_ns());
    let recalls = judge.recalls(&scenes, &table, &mut place);
    scenes.iter().map(|scene| scene.stamp_ns).zip(recalls).collect()
}

#[test]
fn what_comes_later_is_not_recalled() {
    let forecaster = Forecaster::new(&Weights::onboard(), 1).unwrap();
    let (short, long) = (recalled(&forecaster, 500), recalled(&forecaster, 700));
    assert!(short.len() > 60 && long.len() > short.len());
    assert!(short.iter().zip(&long).all(|(short, long)| short == long));
    let told = short.iter().flat_map(|(_, recalls)| recalls).filter(|recall| !recall.is_empty()).count();
    assert!(told > 100, "{told} of the agents were told something");
}
