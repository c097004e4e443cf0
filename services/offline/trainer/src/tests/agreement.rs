//! Tests that the trainer's and the onboard layers compute the same from every shipped weights file.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use data::Format;
use kinematics::MotionModel;
use nn::base::BaseFeatures;
use nn::{BurnIn, Draws, Latents, ModelConfig, Weights};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use scene::{EdgeRule, PatchOptions, Vertex, relation_features, state_features};
use wire::{CONTEXT_EMBEDDING, NODE_ATTRIBUTES, STATE_FEATURES, TEMPORAL};

use crate::agent_view::{AgentView, SceneView};
use crate::base::BaseControl;
use crate::batch::{Batch, BatchOptions, scales};
use crate::net::context::Normalisation;
use crate::net::dense::softmax;
use crate::net::graph::encode;
use crate::net::gru::mode_logits;
use crate::net::layout::layout;
use crate::net::tensors::Tensors;
use crate::rollout::TypeForecast;
use crate::samples::{Ground, MapKind, Scene, Selection, cut};
use crate::spool::{Spool, Spooling};
use crate::tests::recordings::{Scenery, frame_rate};
use crate::view;

/// Maximum error, relative to an agent's largest value; for positions, relative to at least one metre.
const TOLERANCE: f32 = 1e-4;
/// Maximum number of an agent's neighbours, itself included.
const NEIGHBOURS_MAX: usize = 5;

/// The network's outputs for one agent.
#[derive(Debug, Default)]
struct Computed {
    /// ṽ.
    encoding: Vec<f32>,
    /// Probabilities of the modes, `[modes]`.
    probability: Vec<f32>,
    /// Output of the decoder's head for the steps of all modes, then of the single best forecast, `[(modes +
    /// 1) × horizon × 5]`.
    raw: Vec<f32>,
    /// Positions of all modes, then of the single best forecast, in the agent frame, m, `[(modes + 1) ×
    /// horizon × 2]`.
    positions: Vec<f32>,
}

#[test]
fn trainer_and_onboard_agree_on_every_shipped_file() {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/weights"));
    let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<_> =
        files.filter(|path| path.extension().is_some_and(|e| e == "safetensors")).collect();
    files.sort();
    assert!(files.iter().any(|path| path.ends_with("onboard.safetensors")), "{files:?}");
    for path in files {
        let bytes = std::fs::read(&path).unwrap();
        let weights =
            Weights::from_bytes(&bytes).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let config = weights.config();
        assert_eq!(config.latents, Latents::Points, "{}", path.display());
        let onboard = Onboard::new(&weights);
        let trained = Trained::new(&bytes, config);
        let (scenes, ground, spool) = recorded(config);
        let map = ground.view(&spool, 0, MapKind::Online);
        assert_eq!(map.is_some(), config.context);
        let mut compared = 0;
        for scene in &scenes {
            let view = view::plain(scene, map, usize::MAX);
            let (ours, theirs) = (trained.compute(&view), onboard.compute(&view));
            assert_eq!((ours.len(), theirs.len()), (scene.agents.len(), scene.agents.len()));
            for (ours, theirs) in ours.iter().zip(&theirs) {
                let same = |what: &str, ours: &[f32], theirs: &[f32], least: f32| {
                    check(&format!("{}: {what}", path.display()), ours, theirs, least);
                };
                same("encoding", &ours.encoding, &theirs.encoding, 0.0);
                same("probability", &ours.probability, &theirs.probability, 0.0);
                same("head", &ours.raw, &theirs.raw, 0.0);
                same("positions", &ours.positions, &theirs.positions, 1.0);
                compared += 1;
            }
        }
        assert!(compared > 50, "{}: {compared} agents", path.display());
    }
}

fn check(name: &str, ours: &[f32], theirs: &[f32], least: f32) {
    assert_eq!(ours.len(), theirs.len(), "{name}: length");
    let largest = theirs.iter().fold(least, |most, value| most.max(value.abs()));
    let worst = ours.iter().zip(theirs).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(largest.is_finite() && largest > 0.0, "{name}: {largest}");
    assert!(worst <= TOLERANCE * largest, "{name}: off by {worst} of {largest}");
}

/// Scenes of agents of all types, each with a target, and the patches of their ground.
fn recorded(config: &ModelConfig) -> (Vec<Scene>, Ground, Spool) {
    let folder = tempfile::tempdir().unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let path = Scenery::random(frame_rate(Format::Csv), &mut random).write(Format::Csv, folder.path());
    let recording = data::open(&path, Some(Format::Csv)).unwrap();
    let selection = Selection::of_tests(folder.path(), &[]);
    let mut spooling = Spooling::create(folder.path()).unwrap();
    let (scenes, ground) = cut(&recording, selection, config, &mut spooling).unwrap();
    let mut scenes: Vec<Scene> = scenes.collect();
    scenes
        .iter_mut()
        .flat_map(|scene| &mut scene.agents)
        .for_each(|agent| Arc::make_mut(agent).counts = true);
    let types: BTreeMap<_, _> =
        scenes.iter().flat_map(|scene| &scene.agents).map(|agent| (agent.agent_type, ())).collect();
    assert_eq!(types.len(), wire::AGENT_TYPES.len());
    (scenes, ground, spooling.finish().unwrap())
}

/// The trainer's layers.
struct Trained<'a> {
    config: &'a ModelConfig,
    tensors: Tensors,
    base: BaseControl,
}

impl<'a> Trained<'a> {
    fn new(bytes: &[u8], config: &'a ModelConfig) -> Self {
        let tensors = Tensors::from_safetensors(bytes, &layout(config)).unwrap();
        let base = if config.base {
            BaseControl::load(&tensors, config).unwrap()
        } else {
            BaseControl::zero(config)
        };
        Self { config, tensors, base }
    }

    fn compute(&self, scene: &SceneView<'_>) -> Vec<Computed> {
        let Self { config, tensors, base } = self;
        let options = BatchOptions { config, base, neighbours_max: NEIGHBOURS_MAX, with_future: false };
        let batch = Batch::new(std::slice::from_ref(scene), options).unwrap();
        let encoded = encode(tensors, config, &batch.graph, Normalisation::Running, false);
        let mut computed: Vec<Computed> = scene.agents.iter().map(|_| Computed::default()).collect();
        for of_type in 0..wire::AGENT_TYPES.len() {
            let Some(forecast) = TypeForecast::new(tensors, config, &batch, &encoded, of_type) else {
                continue;
            };
            let draw_count = config.modes + 1;
            let modes: Vec<usize> = forecast.agents.clone().flat_map(|_| 0..draw_count).collect();
            let rollout = forecast.by_points(&modes, false);
            let (encoding, hidden) = (&forecast.encoding, &forecast.burn_in.hidden);
            let (logits, _) = mode_logits(tensors, &forecast.name(), encoding, hidden);
            for (row, agent) in forecast.agents.clone().enumerate() {
                let rows = row * draw_count..(row + 1) * draw_count;
                computed[batch.origin[agent].1] = Computed {
                    encoding: encoding.row(row).to_vec(),
                    probability: softmax(logits.row(row)),
                    raw: rows.clone().flat_map(|row| rollout.unroll.raw.row(row)).copied().collect(),
                    positions: rows.flat_map(|row| rollout.positions.row(row)).copied().collect(),
                };
            }
        }
        computed
    }
}

/// The onboard layers and equations.
struct Onboard<'a> {
    config: &'a ModelConfig,
    state: nn::StateMlp,
    relation: nn::RelationMlp,
    context: Option<nn::ContextCnn>,
    gdat: nn::Gdat,
    decoder: nn::Decoder,
}

impl<'a> Onboard<'a> {
    fn new(weights: &'a Weights) -> Self {
        let config = weights.config();
        Self {
            config,
            state: nn::StateMlp::new(weights).unwrap(),
            relation: nn::RelationMlp::new(weights).unwrap(),
            context: config.context.then(|| nn::ContextCnn::new(weights).unwrap()),
            gdat: nn::Gdat::new(weights).unwrap(),
            decoder: nn::Decoder::new(weights).unwrap(),
        }
    }

    fn compute(&self, scene: &SceneView<'_>) -> Vec<Computed> {
        let encodings = self.encode(scene);
        scene.agents.iter().zip(encodings).map(|(agent, encoding)| self.forecast(agent, encoding)).collect()
    }

    fn states(&self, agent: &AgentView) -> Vec<[f32; STATE_FEATURES]> {
        let state = |state: &Option<scene::State>| {
            state.map_or([0.0; STATE_FEATURES], |state| {
                state_features(&agent.frame, &state, scales(self.config))
            })
        };
        agent.history.iter().map(state).collect()
    }

    /// Node attributes of an agent at every step.
    fn nodes(&self, scene: &SceneView<'_>, agent: &AgentView) -> Vec<[f32; NODE_ATTRIBUTES]> {
        let Self { config, .. } = self;
        let len = config.state_embedding_len();
        let states = self.states(agent);
        let mut embedded = vec![0.0; states.len() * len];
        self.state.embed(agent.agent.agent_type, &states, &mut nn::MlpMemory::default(), &mut embedded);
        let options = PatchOptions {
            side: config.patch_size,
            cell_m: config.patch_cell_m,
            ahead_m: config.patch_ahead_m,
        };
        let mut nodes = vec![[0.0; NODE_ATTRIBUTES]; states.len()];
        for (step, node) in nodes.iter_mut().enumerate() {
            node[..len].copy_from_slice(&embedded[step * len..][..len]);
            if let (Some(cnn), Some(map)) = (&self.context, scene.map) {
                let mut patch = Vec::new();
                match agent.agent.patches[step] {
                    Some(number) => map.extend(number, options, &mut patch).unwrap(),
                    None => patch.resize(options.len(), 0.0),
                }
                let mut embedding = [[0.0; CONTEXT_EMBEDDING]];
                cnn.embed(&patch, &mut nn::ContextMemory::default(), &mut embedding);
                node[len..].copy_from_slice(&embedding[0]);
            }
        }
        nodes
    }

    fn encode(&self, scene: &SceneView<'_>) -> Vec<[f32; TEMPORAL]> {
        let Self { config, .. } = self;
        let rule = EdgeRule {
            radius_m: config.edge_radius_m,
            pedestrian_radius_m: config.pedestrian_edge_radius_m.unwrap_or(config.edge_radius_m),
            neighbours_max: NEIGHBOURS_MAX,
        };
        let nodes_of: Vec<_> = scene.agents.iter().map(|agent| self.nodes(scene, agent)).collect();
        let (mut present, mut nodes) = (Vec::new(), Vec::new());
        let (mut edges, mut relations) = (Vec::new(), Vec::new());
        for step in 0..config.history_len {
            let vertex = |view: &AgentView| {
                let position_m = view.history[step]?.position_m;
                Some(Vertex { position_m, agent_type: view.agent.agent_type })
            };
            let vertices: Vec<Option<Vertex>> = scene.agents.iter().map(vertex).collect();
            present.extend(vertices.iter().map(Option::is_some));
            nodes.extend(nodes_of.iter().map(|nodes| nodes[step]));
            let first = edges.len();
            rule.append(step as u16, &vertices, &mut edges);
            relations.extend(edges[first..].iter().map(|edge| {
                let [receiver, sender] = [edge.receiver, edge.sender]
                    .map(|agent| scene.agents[usize::from(agent)].history[step].unwrap());
                relation_features(&receiver, &sender, scales(config))
            }));
        }
        let mut attributes = vec![[0.0; wire::EDGE_ATTRIBUTES]; edges.len()];
        self.relation.embed(&relations, &mut nn::MlpMemory::default(), &mut attributes);
        let agents_len = scene.agents.len();
        let graph = nn::Graph {
            agents_len,
            present: &present,
            nodes: &nodes,
            edges: &edges,
            attributes: &attributes,
        };
        let mut encodings = vec![[0.0; TEMPORAL]; agents_len];
        self.gdat.summarise(&graph, &mut nn::GdatMemory::default(), &mut encodings);
        encodings
    }

    fn forecast(&self, view: &AgentView, encoding: [f32; TEMPORAL]) -> Computed {
        let Self { config, .. } = self;
        let network = self.decoder.of(view.agent.agent_type);
        let states = self.states(view);
        let present: Vec<bool> = view.history.iter().map(Option::is_some).collect();
        let mut memory = nn::DecoderMemory::default();
        let mut hidden = [[0.0; 128]];
        let burn_in = BurnIn { agents_len: 1, states: &states, present: &present };
        network.burn_in(&burn_in, &mut memory, &mut hidden);
        let mut base = vec![[0.0; 2]; (config.modes + 1) * config.horizon_len];
        let mut share = 1.0;
        if let Some(of_type) = network.base() {
            let features = BaseFeatures::new(&states, |step| present[step], config);
            of_type.controls(&features, &mut base);
            share = nn::base::kept_share(of_type.outside(&features));
        }
        let mut raw = vec![[0.0; nn::RAW_CONTROL]; base.len()];
        network.forecast(&hidden, &[encoding], Draws::Points(&base), &mut memory, &mut raw);
        for [first, second, ..] in &mut raw {
            (*first, *second) = (share * *first, share * *second);
        }
        let mut probability = vec![0.0; config.modes];
        assert!(network.mode_probabilities(&hidden, &[encoding], &mut memory, &mut probability));
        let controls = raw.iter().zip(base).map(|(raw, base)| {
            let [first, second] = nn::control_gaussian(*raw).mean;
            [first + base[0], second + base[1]]
        });
        let controls: Vec<_> = controls.collect();
        let modes = controls.chunks_exact(config.horizon_len);
        let positions = modes.flat_map(|controls| self.positions(view, controls)).flatten().collect();
        Computed { encoding: encoding.to_vec(), probability, raw: raw.concat(), positions }
    }

    /// Positions in the agent frame, m, under `controls`.
    fn positions(&self, view: &AgentView, controls: &[[f32; 2]]) -> Vec<[f32; 2]> {
        let Self { config, .. } = self;
        let now = view.history.last().copied().flatten().unwrap();
        let (frame, agent, dt_s) = (&view.frame, &view.agent, config.dt_s as f32);
        let start = scene::motion_start(&now, &view.history, agent.length_m, dt_s);
        let kind = nn::motion_kind(config, agent.agent_type);
        let motion = MotionModel::new(kind, &start, &nn::motion_options(config), dt_s);
        let mut positions = vec![[0.0; 2]; controls.len()];
        motion.positions(controls.iter().copied(), &mut positions);
        let inside = |p: &[f32; 2]| frame.rotate_into([0, 1].map(|axis| p[axis] - frame.origin_m[axis]));
        positions.iter().map(inside).collect()
    }
}
