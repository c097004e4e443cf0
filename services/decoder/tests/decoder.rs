//! The decoder against itself and its refusals; its numbers are held to the golden vectors with the layers.
#![expect(clippy::unwrap_used, reason = "a test ends at what it can't do")]

#[path = "support/frames.rs"]
mod frames;

use decoder::{Decoder, DecoderOptions};
use frames::{encodings, header, room};
use nn::Weights;
use wire::{AgentControls, AgentEncoding, Rejected};

fn decode(workers: usize, seed: u64, seq: u64, encodings: &[AgentEncoding]) -> Vec<AgentControls> {
    let mut decoder = Decoder::new(&Weights::onboard(), DecoderOptions { workers, seed }).unwrap();
    let mut out = room(encodings);
    decoder.step(&header(seq), encodings, &mut out).unwrap();
    out
}

#[test]
fn forecastable_agents_keep_their_order_and_their_probabilities_sum_to_one() {
    let encodings = encodings(23);
    let out = decode(1, 0, 0, &encodings);
    let expected: Vec<u64> = encodings.iter().filter(|a| a.forecastable != 0).map(|a| a.id).collect();
    assert_eq!(out.iter().map(|c| c.id).collect::<Vec<_>>(), expected);
    for controls in &out {
        controls.check().unwrap();
        let sum: f32 = controls.probability.iter().sum();
        assert!((sum - 1.0).abs() < 1e-5, "probabilities sum to {sum}");
        let diagonal = |c: &wire::ControlGaussian| c.cholesky[0] > 0.0 && c.cholesky[2] > 0.0;
        assert!(controls.modes[..controls.modes_len as usize].iter().flatten().all(diagonal));
    }
}

#[test]
fn neither_workers_nor_company_change_a_bit() {
    let encodings = encodings(70);
    let out = decode(1, 5, 9, &encodings);
    assert_eq!(out, decode(3, 5, 9, &encodings));
    for (i, agent) in encodings.iter().filter(|a| a.forecastable != 0).enumerate() {
        assert_eq!(out[i], decode(1, 5, 9, std::slice::from_ref(agent))[0], "agent {i} alone");
    }
}

#[test]
fn a_bad_frame_is_refused_and_leaves_the_output() {
    let mut decoder = Decoder::new(&Weights::onboard(), DecoderOptions { workers: 2, seed: 0 }).unwrap();
    let good = encodings(8);
    let mut out = room(&good);
    let before = out.clone();
    let mut bad = good.clone();
    bad[3].temporal[9] = f32::NAN;
    let rejected = decoder.step(&header(0), &bad, &mut out).unwrap_err();
    assert_eq!(rejected, Rejected::NotFinite { field: "temporal summary" });
    let mut bad = good.clone();
    bad[3].agent_type = 3;
    assert!(matches!(decoder.step(&header(0), &bad, &mut out), Err(Rejected::Impossible { .. })));
    let mut bad = good.clone();
    bad[0].present = 1 << 8;
    assert!(matches!(decoder.step(&header(0), &bad, &mut out), Err(Rejected::Impossible { .. })));
    assert!(matches!(decoder.step(&header(0), &good, &mut out[1..]), Err(Rejected::Length { .. })));
    assert_eq!(out, before);
    decoder.step(&header(0), &good, &mut out).unwrap();
    assert_ne!(out, before);
}
