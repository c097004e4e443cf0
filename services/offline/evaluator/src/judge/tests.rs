use data::{GeneratedScene, SceneOptions};
use nn::Weights;

use super::*;
use crate::Cut;

/// A generated recording of so many frames, and its scenes.
fn footage(forecaster: &Forecaster, seed: u64, frames: usize) -> (Recording, Vec<Scene>) {
    let options =
        SceneOptions { agents: 24, seed, identities: true, miss_probability: 0.0, ..SceneOptions::default() };
    let recording = GeneratedScene::new(options).unwrap().recording(frames);
    let scenes = Cut::of(forecaster.config()).scenes(&recording);
    (recording, scenes)
}

/// What is recalled at each scene of a recording that ends after so many frames, another one having come before.
fn recalled(forecaster: &Forecaster, frames: usize) -> Vec<(i64, Vec<Recalls>)> {
    let (recording, scenes) = footage(forecaster, 3, frames);
    let baselines = Baselines::fit(std::iter::empty(), &Cut::of(forecaster.config()), 1);
    let judge =
        Judge { forecaster, baselines: &baselines, horizons: &[12], subsets: &[], of_type: None, threads: 2 };
    let table = ContextTable::new(forecaster, &recording, &scenes, MapInput::None, 2);
    let mut visited = judge.speaker().memory().unwrap();
    let (before, scenes_before) = footage(forecaster, 4, 400);
    judge.speaker().visit(&before, &scenes_before, MapInput::None, &mut visited);
    let mut memories = Memories { fresh: judge.speaker().memory(), visited: Some(&mut visited) };
    let recalls = judge.recalls(&scenes, &judge.speaker().spoken(&scenes, &table), &mut memories);
    scenes.iter().map(|scene| scene.stamp_ns).zip(recalls).collect()
}

#[test]
fn what_comes_later_is_not_recalled() {
    let forecaster = Forecaster::new(&Weights::onboard(), 1).unwrap();
    let (short, long) = (recalled(&forecaster, 500), recalled(&forecaster, 700));
    assert!(short.len() > 60 && long.len() > short.len());
    assert!(short.iter().zip(&long).all(|(short, long)| short == long));
    let told = |memory: usize| {
        let recalls =
            short.iter().flat_map(|(_, recalls)| recalls).filter_map(|recalls| recalls[memory].as_ref());
        recalls.filter(|recall| !recall.is_empty()).count()
    };
    let [fresh, visited] = [0, 1].map(told);
    assert!(fresh > 100, "{fresh} of the agents were told something");
    assert!(visited > fresh + 100, "{visited} where another recording came before, {fresh} without");
}
