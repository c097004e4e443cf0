//! Compares every tensor that the network computes with the independent reference in `tests/golden`.
//!
//! Tolerance: 1e-4 of the tensor's largest magnitude; 2e-3 of it if the decoder computes in bf16.

#![expect(clippy::unwrap_used, reason = "a test ends at what it can't read")]

use std::collections::BTreeMap;
use std::path::PathBuf;

use nn::kernels::product::{Gather, Panels, Product};
use nn::kernels::{self, Isa};
use nn::{
    BurnIn, ContextCnn, ContextMemory, Decoder, DecoderMemory, Draws, EncodingFunction, Gdat, GdatMemory,
    Graph, GraphTrace, MlpMemory, Precision, RAW_CONTROL, RelationMlp, StateMlp, Weights, control_gaussian,
};
use wire::{AgentType, Edge};

const FOLDERS: [&str; 4] = ["vehicle", "pedestrian", "plus", "literal"];
const TOLERANCE: f32 = 1e-4;
/// Tolerance for factors with 8 bits.
const TOLERANCE_BF16: f32 = 2e-3;

/// The reference's tensors and agents.
struct Reference {
    tensors: BTreeMap<String, (Vec<usize>, Vec<f32>)>,
    types: Vec<AgentType>,
    present: Vec<Vec<bool>>,
    weights: Weights,
}

impl Reference {
    fn open(folder: &str) -> Self {
        let dir: PathBuf = [env!("CARGO_MANIFEST_DIR"), "../../tests/golden", folder].iter().collect();
        let bytes = std::fs::read(dir.join("tensors.safetensors")).unwrap();
        let file = safetensors::SafeTensors::deserialize(&bytes).unwrap();
        let floats = |data: &[u8]| data.as_chunks().0.iter().map(|&b| f32::from_le_bytes(b)).collect();
        let tensors = file
            .iter()
            .map(|(name, view)| (name.to_owned(), (view.shape().to_vec(), floats(view.data()))))
            .collect();
        let scene: serde_json::Value =
            serde_json::from_slice(&std::fs::read(dir.join("scene.json")).unwrap()).unwrap();
        let types = scene["types"].as_array().unwrap();
        Self {
            tensors,
            types: types.iter().map(|name| name.as_str().unwrap().parse().unwrap()).collect(),
            present: serde_json::from_value(scene["present"].clone()).unwrap(),
            weights: Weights::open(&dir.join("weights.safetensors")).unwrap(),
        }
    }

    fn tensor(&self, name: &str) -> &[f32] {
        &self.tensors.get(name).unwrap_or_else(|| panic!("no tensor {name}")).1
    }

    fn agents_len(&self) -> usize {
        self.types.len()
    }

    /// Presence over the history or over the future, \[step, agent\].
    fn present(&self, part: &str) -> Vec<bool> {
        let history_len = self.weights.config().history_len;
        let (history, future) = self.present.split_at(history_len);
        if part == "history" { history.concat() } else { future.concat() }
    }

    /// Fails if a value differs from the reference's by more than the tolerance.
    fn assert_close(&self, name: &str, ours: &[f32]) {
        self.assert_within(TOLERANCE, name, ours);
    }

    fn assert_within(&self, tolerance: f32, name: &str, ours: &[f32]) {
        let theirs = self.tensor(name);
        assert_eq!(ours.len(), theirs.len(), "{name}");
        let largest = theirs.iter().fold(0.0_f32, |most, x| most.max(x.abs()));
        let worst = ours.iter().zip(theirs).fold(0.0_f32, |worst, (a, b)| worst.max((a - b).abs()));
        assert!(worst <= tolerance * largest, "{name}: {worst} off, largest magnitude {largest}");
    }

    /// The edges of a part's adjacency.
    fn edges(&self, part: &str) -> Vec<Edge> {
        let n = self.agents_len();
        let place = |i: usize| Edge {
            step: (i / (n * n)) as u16,
            receiver: (i / n % n) as u16,
            sender: (i % n) as u16,
            reserved: 0,
        };
        let adjacency = self.tensor(&format!("{part}.adjacency"));
        adjacency.iter().enumerate().filter(|(_, x)| **x > 0.0).map(|(i, _)| place(i)).collect()
    }

    /// Index of an edge in dense tensors \[step, i, j\].
    fn dense(&self, edge: &Edge) -> usize {
        let n = self.agents_len();
        (usize::from(edge.step) * n + usize::from(edge.receiver)) * n + usize::from(edge.sender)
    }
}

fn rows<const N: usize>(values: &[f32]) -> &[[f32; N]] {
    values.as_chunks().0
}

/// State and context embeddings of all agents and steps of a part; zeros for absent agents.
fn nodes(reference: &Reference, part: &str) -> Vec<[f32; 64]> {
    let present = reference.present(part);
    let states = rows::<6>(reference.tensor(&format!("{part}.state")));
    let state_mlp = StateMlp::new(&reference.weights).unwrap();
    let mut nodes = vec![[0.0; 64]; present.len()];
    let mut memory = MlpMemory::default();
    for (row, node) in nodes.iter_mut().enumerate().filter(|(row, _)| present[*row]) {
        let agent_type = reference.types[row % reference.agents_len()];
        state_mlp.embed(agent_type, &states[row..=row], &mut memory, &mut node[..32]);
    }
    if part == "history" {
        let cnn = ContextCnn::new(&reference.weights).unwrap();
        let mut contexts = vec![[0.0; 32]; present.len()];
        cnn.embed(reference.tensor("history.patches"), &mut ContextMemory::default(), &mut contexts);
        for (row, node) in nodes.iter_mut().enumerate().filter(|(row, _)| present[*row]) {
            node[32..].copy_from_slice(&contexts[row]);
        }
    }
    nodes
}

fn check_embeddings(reference: &Reference) {
    reference.assert_close("history.node", nodes(reference, "history").as_flattened());
    let ours = nodes(reference, "future");
    let theirs = rows::<64>(reference.tensor("future.node"));
    for (ours, theirs) in ours.iter().zip(theirs) {
        for (a, b) in ours[..32].iter().zip(&theirs[..32]) {
            assert!((a - b).abs() <= TOLERANCE, "future.node: {a} is not {b}");
        }
    }
    for part in ["history", "future"] {
        let n = reference.agents_len();
        let present = reference.present(part);
        let relations = rows::<6>(reference.tensor(&format!("{part}.relation")));
        let mut embedded = vec![[0.0; 16]; relations.len()];
        let relation_mlp = RelationMlp::new(&reference.weights).unwrap();
        relation_mlp.embed(relations, &mut MlpMemory::default(), &mut embedded);
        for (i, edge) in embedded.iter_mut().enumerate() {
            let (step, receiver, sender) = (i / (n * n), i / n % n, i % n);
            if !(present[step * n + receiver] && present[step * n + sender]) {
                *edge = [0.0; 16];
            }
        }
        reference.assert_close(&format!("{part}.edge"), embedded.as_flattened());
    }
}

/// Runs the attention of a part on the reference's inputs and compares all results.
fn check_attention(reference: &Reference, part: &str) -> Vec<[f32; 64]> {
    let name = |tensor: &str| format!("{part}.{tensor}");
    let (agents_len, present) = (reference.agents_len(), reference.present(part));
    let edges = reference.edges(part);
    let all_attributes = rows::<16>(reference.tensor(&name("edge")));
    let attributes: Vec<_> = edges.iter().map(|e| all_attributes[reference.dense(e)]).collect();
    let nodes = rows(reference.tensor(&name("node")));
    let graph = Graph { agents_len, present: &present, nodes, edges: &edges, attributes: &attributes };
    let gdat = Gdat::new(&reference.weights).unwrap();
    let mut trace = GraphTrace::default();
    let mut temporal = vec![[0.0; 64]; agents_len];
    gdat.summarise_traced(&graph, &mut GdatMemory::default(), &mut temporal, &mut trace);
    for (round, traced) in trace.rounds.iter().enumerate() {
        let name = |tensor: &str| format!("{part}.topo{round}.{tensor}");
        reference.assert_close(&name("node"), traced.nodes.as_flattened());
        let heads = reference.weights.config().topological_heads;
        let mut alpha = vec![0.0; reference.tensor(&name("alpha")).len()];
        for (edge, weights) in edges.iter().zip(traced.alpha.chunks_exact(heads)) {
            for (head, weight) in weights.iter().enumerate() {
                let step = usize::from(edge.step) * (heads - 1) + head;
                alpha[reference.dense(edge) + step * agents_len * agents_len] = *weight;
            }
        }
        reference.assert_close(&name("alpha"), &alpha);
        if !traced.attributes.is_empty() {
            let mut dense = vec![[0.0; 16]; all_attributes.len()];
            edges.iter().zip(&traced.attributes).for_each(|(e, a)| dense[reference.dense(e)] = *a);
            reference.assert_close(&name("edge"), dense.as_flattened());
        }
    }
    reference.assert_close(&name("beta"), &trace.beta);
    reference.assert_close(&name("temporal"), temporal.as_flattened());
    temporal
}

fn check_encoding(reference: &Reference, history: &[[f32; 64]], future: &[[f32; 64]]) {
    let join = |(h, f): (&[f32; 64], &[f32; 64])| {
        let mut joined = [0.0; 128];
        joined[..64].copy_from_slice(h);
        joined[64..].copy_from_slice(f);
        joined
    };
    let summaries: Vec<_> = history.iter().zip(future).map(join).collect();
    let mut means = vec![[0.0; 32]; summaries.len()];
    let encoding = EncodingFunction::new(&reference.weights).unwrap();
    encoding.means(&summaries, &mut MlpMemory::default(), &mut means);
    reference.assert_close("latent.mean", means.as_flattened());
}

fn check_decoder(reference: &Reference, temporal: &[[f32; 64]], precision: Precision) {
    let (agents_len, config) = (reference.agents_len(), reference.weights.config());
    let latents = rows::<32>(reference.tensor("latent.z"));
    let draw_count = latents.len() / agents_len;
    let horizon_len = config.horizon_len;
    let mut raw = vec![[0.0; RAW_CONTROL]; latents.len() * horizon_len];
    let states = rows::<6>(reference.tensor("history.state"));
    let present = reference.present("history");
    let decoder = Decoder::with_precision(&reference.weights, precision).unwrap();
    let mut memory = DecoderMemory::default();
    for agent in 0..agents_len {
        let of_agent = |row: &usize| row % agents_len == agent;
        let own: Vec<usize> = (0..states.len()).filter(of_agent).collect();
        let own_states: Vec<_> = own.iter().map(|&row| states[row]).collect();
        let own_present: Vec<_> = own.iter().map(|&row| present[row]).collect();
        let burn_in = BurnIn { agents_len: 1, states: &own_states, present: &own_present };
        let own_latents: Vec<_> = (0..draw_count).map(|draw| latents[draw * agents_len + agent]).collect();
        let mut hidden = [[0.0; 128]];
        let mut out = vec![[0.0; RAW_CONTROL]; draw_count * horizon_len];
        let typed = decoder.of(reference.types[agent]);
        typed.burn_in(&burn_in, &mut memory, &mut hidden);
        let summary = &temporal[agent..=agent];
        typed.forecast(&hidden, summary, Draws::Given(&own_latents), &mut memory, &mut out);
        for (draw, steps) in out.chunks_exact(horizon_len).enumerate() {
            raw[(draw * agents_len + agent) * horizon_len..][..horizon_len].copy_from_slice(steps);
        }
    }
    let tolerance = match precision {
        Precision::F32 => TOLERANCE,
        Precision::Bf16 => TOLERANCE_BF16,
    };
    reference.assert_within(tolerance, "decoder.raw", raw.as_flattened());
    let controls: Vec<_> = raw.iter().map(|row| control_gaussian(*row)).collect();
    let means: Vec<f32> = controls.iter().flat_map(|c| c.mean).collect();
    let factor = |c: &wire::ControlGaussian| [c.cholesky[0], 0.0, c.cholesky[1], c.cholesky[2]];
    let factors: Vec<f32> = controls.iter().flat_map(factor).collect();
    reference.assert_within(tolerance, "control.mean", &means);
    reference.assert_within(tolerance, "control.cholesky", &factors);
}

fn check(folder: &str) {
    let reference = Reference::open(folder);
    check_embeddings(&reference);
    let history = check_attention(&reference, "history");
    let future = check_attention(&reference, "future");
    check_encoding(&reference, &history, &future);
    check_decoder(&reference, &history, Precision::F32);
    match Precision::Bf16.check() {
        Ok(()) => check_decoder(&reference, &history, Precision::Bf16),
        Err(why) => testing::skip(why),
    }
}

/// Products of one to three panels with every number of rows up to slightly more than two of the largest
/// tiles; embeddings and forecasts.
fn outputs() -> Vec<f32> {
    let value = |i: usize| ((i * 37) % 101) as f32 * 0.02 - 1.0;
    let mut all = Vec::new();
    for row_count in 1..=27 {
        for out_len in [16, 32, 48] {
            let in_len = 5 + row_count;
            let panels = Panels::pack([out_len, 1, in_len], |out, _, i| value(out * 7 + i * 3), value);
            let input: Vec<f32> = (0..row_count * in_len).map(value).collect();
            let mut out = vec![0.0; row_count * out_len];
            let gather = Gather::Rows { stride: in_len };
            Product { input: &input, gather, panels: &panels, residual: None, relu: false, out: &mut out }
                .run();
            all.append(&mut out);
        }
    }
    let weights = Weights::onboard();
    let cnn = ContextCnn::new(&weights).unwrap();
    let patches: Vec<f32> = (0..7 * cnn.patch_len()).map(value).collect();
    let mut embedded = vec![[0.0; 32]; 7];
    cnn.embed(&patches, &mut ContextMemory::default(), &mut embedded);
    all.extend(embedded.as_flattened());
    let decoder = Decoder::new(&weights).unwrap();
    let (hidden, temporal) = (vec![[0.3; 128]; 5], vec![[-0.2; 64]; 5]);
    let latents: Vec<[f32; 32]> = (0..5 * 20).map(|i| [value(i); 32]).collect();
    let mut controls = vec![[0.0; RAW_CONTROL]; latents.len() * 12];
    let (decoder, memory) = (decoder.of(AgentType::Pedestrian), &mut DecoderMemory::default());
    decoder.forecast(&hidden, &temporal, Draws::Given(&latents), memory, &mut controls);
    all.extend(controls.as_flattened());
    all
}

/// One test for all sets: the set in use is a property of the process.
#[test]
fn the_reference_is_reproduced_on_every_instruction_set() {
    let fastest = kernels::active();
    let mut fused: Option<(Isa, Vec<f32>)> = None;
    for isa in Isa::ALL.into_iter().filter(|isa| isa.available()) {
        kernels::force(isa).unwrap();
        for folder in FOLDERS {
            println!("{folder} on {}", isa.name());
            check(folder);
        }
        let outputs = outputs();
        match &fused {
            // The portable multiply-add rounds twice.
            _ if isa == Isa::Portable => {}
            None => fused = Some((isa, outputs)),
            Some((first, of_first)) => {
                let same = of_first.iter().zip(&outputs).all(|(a, b)| a.to_bits() == b.to_bits());
                assert!(same && of_first.len() == outputs.len(), "{isa} has other bits than {first}");
            }
        }
    }
    kernels::force(fastest).unwrap();
}
