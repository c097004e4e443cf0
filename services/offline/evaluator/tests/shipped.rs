//! Given the same `tracks` payloads, the evaluator and the chain of `predict` make equal forecasts.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on should panic")]

use data::sets::{DataSet, Fold, Part};
use data::{GeneratedScene, Recording, SceneOptions};
use evaluator::{Candidate, Cut, Forecaster, MapInput, Method, Scene, TracksPayload};
use nn::Weights;
use onboard::{Graph, open_all};
use run::{Run, StageRun};
use scene::AgentType;
use testing::public_recording;
use wire::{ForecastsTopic, StageId, TracksTopic};

/// A run as `predict` sets it up.
fn run(sampler: &sampler::Options) -> Run {
    let localiser = localiser::Options { map: localiser::MapChoice::Online };
    Run {
        lockstep: true,
        seed: 1,
        stages: vec![
            StageRun::with_options(&sampler::STAGE, sampler).unwrap(),
            StageRun::with_options(&localiser::STAGE, &localiser).unwrap(),
        ],
        ..Run::default()
    }
}

/// The shipped chain's forecasts of the complete agents, scene by scene.
fn shipped(run: &Run, scenes: &[Scene], payloads: &[TracksPayload]) -> Vec<Vec<(usize, Candidate)>> {
    let weights = Weights::onboard();
    let mut nodes = open_all(run, &weights).unwrap();
    nodes.retain(|node| node.id() != StageId::Tracker);
    let mut stages = Graph::new(nodes);
    let of_scene = |(scene, payload): (&Scene, &TracksPayload)| {
        let TracksPayload { header, tracks, places, .. } = payload;
        stages.put::<TracksTopic>(header, tracks);
        stages.tick(|_| ());
        assert_eq!(stages.refusal(StageId::Sampler), None);
        let forecasts = stages
            .frame::<ForecastsTopic>()
            .elements
            .iter()
            .map(|payload| Candidate::published(payload, weights.config().horizon_len));
        let complete = scene.complete();
        places.iter().copied().zip(forecasts).filter(|(place, _)| complete.contains(place)).collect()
    };
    scenes.iter().zip(payloads).map(of_scene).collect()
}

/// Checks that both give the same forecasts, and returns the number of complete agents of a type.
fn same(recording: &Recording, of_type: AgentType) -> usize {
    let forecaster = Forecaster::new(Weights::onboard(), 1).unwrap();
    let scenes = Cut::of(forecaster.config()).scenes(recording);
    let scenes = &scenes[..scenes.len().min(150)];
    let payloads = forecaster.payloads(recording, scenes);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("memory");
    let mut memory = forecaster.memory();
    forecaster.visit(recording, scenes, MapInput::Online, 2, &mut memory);
    memory.save(&path, forecaster.weights().sha256()).unwrap();

    let variants = forecaster.variants(recording, scenes, MapInput::Online, 2, Some(memory));
    let check = |sampler: &sampler::Options, of: Method| {
        let shipped = shipped(&run(sampler), scenes, &payloads);
        assert_eq!(shipped.len(), variants.len());
        for (shipped, variants) in shipped.iter().zip(&variants) {
            let evaluated: Vec<_> =
                variants.iter().map(|(place, variants)| (*place, &variants[of.index()])).collect();
            let shipped: Vec<_> = shipped.iter().map(|(place, forecast)| (*place, forecast)).collect();
            assert_eq!(evaluated, shipped);
        }
    };
    // The default options of a run, and options with less.
    let as_it_is = sampler::Options::default();
    let with_retrieval = sampler::Options { evidence: false, ..as_it_is.clone() };
    check(&sampler::Options { retrieval: false, ..with_retrieval.clone() }, Method::Network);
    check(&with_retrieval, Method::OnlineRetrieval);
    let warm_started = sampler::Options { memory: Some(path), ..with_retrieval };
    check(&warm_started, Method::WarmStartedRetrieval);
    check(&as_it_is, Method::Evidence);

    let all = || scenes.iter().zip(&variants).flat_map(|(scene, of)| of.iter().map(move |of| (scene, of)));
    let differ = |a: Method, b: Method| all().any(|(_, (_, of))| of[a.index()] != of[b.index()]);
    assert!(differ(Method::OnlineRetrieval, Method::Network), "nothing was retrieved");
    assert!(differ(Method::Evidence, Method::OnlineRetrieval), "evidence changed nothing");
    all().filter(|(scene, (place, _))| scene.agents[*place].agent_type == of_type).count()
}

#[test]
fn generated_traffic_of_all_types_is_forecast_as_shipped() {
    let options = SceneOptions {
        agents: 24,
        seed: 3,
        identities: true,
        miss_probability: 0.0,
        ..SceneOptions::default()
    };
    let recording = GeneratedScene::new(options).unwrap().recording(500);
    for of_type in wire::AGENT_TYPES {
        assert!(same(&recording, of_type) > 0, "{of_type:?}");
    }
}

#[test]
fn recorded_agents_of_each_type_are_forecast_as_shipped() {
    let recordings = [
        ("eth_ucy", DataSet::EthUcyFold(Fold::Hotel), Part::Test, AgentType::Pedestrian),
        ("sdd", DataSet::SddRaw, Part::Train, AgentType::Cyclist),
        ("interaction", DataSet::Interaction, Part::Test, AgentType::Vehicle),
    ];
    for (folder, set, part, of_type) in recordings {
        if public_recording(folder).is_none() {
            continue;
        }
        let files = set.files(&testing::recordings_folder(), part).unwrap();
        let recordings = files.iter().map(|file| data::open(file, Some(set.format())).unwrap());
        let len = recordings.take(8).map(|recording| same(&recording, of_type)).find(|len| *len > 0);
        assert!(len.is_some(), "no {of_type:?} in {folder}");
    }
}
