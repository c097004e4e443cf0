//! Properties of the layers for any weights and inputs.
#![expect(clippy::unwrap_used, reason = "a test ends at what it can't do")]

use nn::base::latent_scale;
use nn::{
    BurnIn, ContextCnn, ContextMemory, Decoder, DecoderMemory, Draws, Gdat, GdatMemory, Graph, GraphTrace,
    RAW_CONTROL, Weights,
};
use proptest::prelude::*;
use testing::{Model, value};
use wire::{AgentType, Edge};

/// A graph of random presence and neighbours.
#[derive(Clone, Debug)]
struct Scene {
    agents_len: usize,
    present: Vec<bool>,
    nodes: Vec<[f32; 64]>,
    edges: Vec<Edge>,
    attributes: Vec<[f32; 16]>,
}

impl Scene {
    fn graph(&self) -> Graph<'_> {
        Graph {
            agents_len: self.agents_len,
            present: &self.present,
            nodes: &self.nodes,
            edges: &self.edges,
            attributes: &self.attributes,
        }
    }

    /// The scene with agent i at index `order[i]`.
    fn permuted(&self, order: &[usize]) -> Self {
        let n = self.agents_len;
        let place = |row: usize| row / n * n + order[row % n];
        let mut permuted = self.clone();
        for row in 0..self.nodes.len() {
            permuted.present[place(row)] = self.present[row];
            permuted.nodes[place(row)] = self.nodes[row];
        }
        let agent = |agent: u16| order[usize::from(agent)] as u16;
        let renamed = |e: &Edge| Edge { receiver: agent(e.receiver), sender: agent(e.sender), ..*e };
        let mut edges: Vec<_> = self.edges.iter().map(renamed).zip(self.attributes.iter().copied()).collect();
        edges.sort_by_key(|(edge, _)| *edge);
        (permuted.edges, permuted.attributes) = edges.into_iter().unzip();
        permuted
    }
}

fn scenes() -> impl Strategy<Value = (Scene, Vec<usize>)> {
    (1_usize..7, 1_usize..5).prop_flat_map(|(agents_len, step_count)| {
        let node_count = agents_len * step_count;
        let presence = prop::collection::vec(prop::bool::weighted(0.8), node_count);
        let near = prop::collection::vec(any::<bool>(), node_count * agents_len);
        let numbers = prop::collection::vec(-1.0_f32..1.0, node_count * 64 + node_count * agents_len * 16);
        let order = Just((0..agents_len).collect::<Vec<_>>()).prop_shuffle();
        (presence, near, numbers, order).prop_map(move |(present, near, numbers, order)| {
            let (nodes, attributes) = numbers.split_at(node_count * 64);
            let mut edges = Vec::new();
            for (i, near) in near.iter().enumerate() {
                let (row, sender) = (i / agents_len, i % agents_len);
                let (step, receiver) = (row / agents_len, row % agents_len);
                let both = present[row] && present[step * agents_len + sender];
                if both && (*near || receiver == sender) {
                    let [step, receiver, sender] = [step, receiver, sender].map(|x| x as u16);
                    edges.push(Edge { step, receiver, sender, reserved: 0 });
                }
            }
            let attributes = attributes.as_chunks().0[..edges.len()].to_vec();
            let nodes = nodes.as_chunks().0.to_vec();
            (Scene { agents_len, present, nodes, edges, attributes }, order)
        })
    })
}

fn summarise(gdat: &Gdat, scene: &Scene) -> (Vec<[f32; 64]>, GraphTrace) {
    let (mut out, mut trace) = (vec![[0.0; 64]; scene.agents_len], GraphTrace::default());
    gdat.summarise_traced(&scene.graph(), &mut GdatMemory::default(), &mut out, &mut trace);
    (out, trace)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn attention_of_present_agents_sums_to_one((scene, _) in scenes()) {
        let weights = Weights::onboard();
        let heads = weights.config().topological_heads;
        let (out, trace) = summarise(&Gdat::new(&weights).unwrap(), &scene);
        for round in &trace.rounds {
            let mut start = 0;
            for received in scene.edges.chunk_by(|a, b| (a.step, a.receiver) == (b.step, b.receiver)) {
                for head in 0..heads {
                    let sum: f32 = (start..start + received.len()).map(|e| round.alpha[e * heads + head]).sum();
                    prop_assert!((sum - 1.0).abs() < 1e-5, "row sums to {sum}");
                }
                start += received.len();
            }
            for (row, present) in round.nodes.iter().zip(&scene.present) {
                prop_assert!(*present || row.iter().all(|x| *x == 0.0));
            }
        }
        for (agent, summary) in out.iter().enumerate() {
            let rows = || (agent..scene.present.len()).step_by(scene.agents_len);
            let expected = f32::from(u8::from(rows().any(|row| scene.present[row])));
            for head in 0..trace.temporal_heads {
                let sum: f32 = rows().map(|row| trace.beta[row * trace.temporal_heads + head]).sum();
                prop_assert!((sum - expected).abs() < 1e-5);
            }
            prop_assert!(expected == 1.0 || summary.iter().all(|x| *x == 0.0));
        }
    }

    #[test]
    fn equal_attention_is_a_mean((scene, _) in scenes()) {
        let mut model = Model::onboard();
        model.config["attention"] = "equal".into();
        model.tensors.retain(|(name, ..)| !name.ends_with("_raw") && !name.starts_with("gdat.temporal.score"));
        let weights = model.weights();
        let heads = weights.config().topological_heads;
        let (_, trace) = summarise(&Gdat::new(&weights).unwrap(), &scene);
        for round in &trace.rounds {
            let mut alpha = round.alpha.chunks_exact(heads);
            for received in scene.edges.chunk_by(|a, b| (a.step, a.receiver) == (b.step, b.receiver)) {
                let share = 1.0 / received.len() as f32;
                prop_assert!(alpha.by_ref().take(received.len()).flatten().all(|x| (x - share).abs() < 1e-6));
            }
        }
        for (row, beta) in trace.beta.chunks_exact(trace.temporal_heads).enumerate() {
            let steps = (row % scene.agents_len..scene.present.len()).step_by(scene.agents_len);
            let share = 1.0 / steps.filter(|&row| scene.present[row]).count().max(1) as f32;
            let expected = if scene.present[row] { share } else { 0.0 };
            prop_assert!(beta.iter().all(|x| (x - expected).abs() < 1e-6));
        }
    }

    #[test]
    fn summaries_follow_a_permutation_of_the_agents((scene, order) in scenes()) {
        let gdat = Gdat::new(&Weights::onboard()).unwrap();
        let (out, _) = summarise(&gdat, &scene);
        let (permuted, _) = summarise(&gdat, &scene.permuted(&order));
        let largest = out.as_flattened().iter().fold(1e-3_f32, |most, x| most.max(x.abs()));
        for (i, row) in out.iter().enumerate() {
            for (a, b) in row.iter().zip(&permuted[order[i]]) {
                prop_assert!((a - b).abs() <= 1e-5 * largest, "{a} and {b}");
            }
        }
    }

    #[test]
    fn scratch_memory_of_another_scene_changes_no_bit((scene, _) in scenes(), (other, _) in scenes()) {
        let gdat = Gdat::new(&Weights::onboard()).unwrap();
        let mut memory = GdatMemory::default();
        gdat.summarise(&other.graph(), &mut memory, &mut vec![[0.0; 64]; other.agents_len]);
        let mut out = vec![[0.0; 64]; scene.agents_len];
        gdat.summarise(&scene.graph(), &mut memory, &mut out);
        prop_assert_eq!(out, summarise(&gdat, &scene).0);
    }

    #[test]
    fn a_patch_is_embedded_alike_in_any_batch(len in 1_usize..60, at in 0_usize..60) {
        let cnn = ContextCnn::new(&Weights::onboard()).unwrap();
        let at = at % len;
        let patches: Vec<f32> = (0..len * cnn.patch_len()).map(|i| value(i + i / 768)).collect();
        let (mut all, mut memory) = (vec![[0.0; 32]; len], ContextMemory::default());
        cnn.embed(&patches, &mut memory, &mut all);
        let mut alone = [[0.0; 32]];
        let patch = &patches[at * cnn.patch_len()..][..cnn.patch_len()];
        cnn.embed(patch, &mut memory, &mut alone);
        prop_assert_eq!(all[at], alone[0]);
    }
}

/// Latent points, moved by their base controls, \[agent, draw\]: z + M (scale · control).
fn moved_by_base(
    weights: &Weights,
    agent_type: AgentType,
    points: &[f32],
    base: &[[f32; 2]],
) -> Vec<[f32; 32]> {
    let control_count = 2 * weights.config().horizon_len;
    let name = format!("decoder.{}.latent_base.weight", agent_type.name());
    let matrix = weights.tensor(&name, &[32, control_count]).unwrap();
    let scale = latent_scale(weights.config(), agent_type);
    let rows = points.as_chunks::<32>().0.iter().zip(base.as_flattened().chunks_exact(control_count));
    let moved = |(point, controls): (&[f32; 32], &[f32])| {
        std::array::from_fn(|i| {
            let terms = matrix[i * control_count..][..control_count].iter().zip(controls).enumerate();
            point[i] + terms.map(|(k, (m, control))| m * scale[k % 2] * control).sum::<f32>()
        })
    };
    rows.map(moved).collect()
}

#[test]
fn learned_points_are_decoded_as_if_they_were_given() {
    let weights = Model::with_all_options().weights();
    let decoder = Decoder::new(&weights).unwrap();
    let decoder = decoder.of(AgentType::Cyclist);
    let mut latents = weights.tensor("decoder.cyclist.latents", &[20, 32]).unwrap().to_vec();
    latents.extend(decoder.best_latent().unwrap());
    assert_eq!(decoder.point_count(), 21);
    let agents_len = 3;
    let horizon_len = weights.config().horizon_len;
    let base: Vec<[f32; 2]> =
        (0..agents_len * 21 * horizon_len).map(|i| [value(3 * i), 0.1 * value(i)]).collect();
    let given = moved_by_base(&weights, AgentType::Cyclist, &latents.repeat(agents_len), &base);
    let states: Vec<[f32; 6]> = (0..8 * agents_len).map(|i| [value(i); 6]).collect();
    let temporal: Vec<[f32; 64]> = (0..agents_len).map(|i| [value(i + 3); 64]).collect();
    let present = vec![true; states.len()];
    let mut memory = DecoderMemory::default();
    let mut hidden = vec![[0.0; 128]; agents_len];
    let agents = BurnIn { agents_len, states: &states, present: &present };
    decoder.burn_in(&agents, &mut memory, &mut hidden);
    let mut decode = |draws: Draws<'_>| {
        let mut out = vec![[0.0; RAW_CONTROL]; agents_len * 21 * horizon_len];
        decoder.forecast(&hidden, &temporal, draws, &mut memory, &mut out);
        out
    };
    let (by_points, by_latents) = (decode(Draws::Points(&base)), decode(Draws::Given(&given)));
    for (a, b) in by_points.as_flattened().iter().zip(by_latents.as_flattened()) {
        assert!((a - b).abs() < 1e-4, "{a} is not {b}");
    }
    let elsewhere: Vec<[f32; 2]> = base.iter().map(|[a, b]| [a + 0.1, *b]).collect();
    assert_ne!(by_points, decode(Draws::Points(&elsewhere)), "the points know of the base");
    let mut probabilities = vec![0.0; agents_len * 20];
    assert!(decoder.mode_probabilities(&hidden, &temporal, &mut memory, &mut probabilities));
    for row in probabilities.chunks_exact(20) {
        assert!((row.iter().sum::<f32>() - 1.0).abs() < 1e-5 && row.iter().all(|p| *p > 0.0));
    }
}
