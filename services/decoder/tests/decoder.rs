//! Determinism of the decoder and rejection of bad frames. Golden vectors of the layers check its numbers.
#![expect(clippy::unwrap_used, reason = "a test ends at what it can't do")]

use std::sync::atomic::{AtomicU64, Ordering};

use crate::support::frames;
use bytemuck::Zeroable;
use decoder::{Decoder, DecoderOptions};
use frames::{encodings, header, room};
use nn::base::{Base, BaseFeatures};
use nn::{Precision, Weights};
use ports::Allowance;
use testing::Model;
use wire::{AgentControls, AgentEncoding, ControlGaussian, Rejected};

fn options(workers: usize, seed: u64) -> DecoderOptions {
    DecoderOptions { workers, seed, ..DecoderOptions::default() }
}

fn decode(workers: usize, seed: u64, seq: u64, encodings: &[AgentEncoding]) -> Vec<AgentControls> {
    decode_with(options(workers, seed), seq, encodings)
}

fn decode_with(options: DecoderOptions, seq: u64, encodings: &[AgentEncoding]) -> Vec<AgentControls> {
    let mut decoder = Decoder::new(&Weights::onboard(), options).unwrap();
    let mut out = room(encodings);
    frames::decode(&mut decoder, &header(seq), encodings, &mut out).unwrap();
    out
}

#[test]
fn controls_keep_the_agents_order_and_sum_to_one() {
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
fn workers_and_other_agents_change_no_bit() {
    let encodings = encodings(70);
    let out = decode(1, 5, 9, &encodings);
    for workers in [2, 4] {
        assert_eq!(out, decode(workers, 5, 9, &encodings), "{workers} workers");
    }
    for (i, agent) in encodings.iter().filter(|a| a.forecastable != 0).enumerate() {
        assert_eq!(out[i], decode(1, 5, 9, std::slice::from_ref(agent))[0], "agent {i} alone");
    }
}

/// Maximum and root mean square difference between the control means of all modes.
fn apart(a: &[AgentControls], b: &[AgentControls]) -> [f32; 2] {
    let means = |all: &[AgentControls]| -> Vec<f32> {
        all.iter()
            .flat_map(|controls| controls.modes.as_flattened())
            .flat_map(|control| control.mean)
            .collect()
    };
    let off: Vec<f32> = means(a).iter().zip(means(b)).map(|(a, b)| (a - b).abs()).collect();
    let squares: f32 = off.iter().map(|x| x * x).sum();
    [off.iter().fold(0.0, |most, x| x.max(most)), (squares / off.len() as f32).sqrt()]
}

#[test]
fn in_bf16_too_workers_and_other_agents_change_no_bit() {
    let encodings = encodings(70);
    let bf16 = |workers| DecoderOptions { precision: Precision::Bf16, ..options(workers, 5) };
    if let Err(why) = Precision::Bf16.check() {
        let refused = Decoder::new(&Weights::onboard(), bf16(1)).err().map(|error| error.to_string());
        assert_eq!(refused, Some(why.to_string()));
        testing::skip(why);
        return;
    }
    let out = decode_with(bf16(1), 9, &encodings);
    for workers in [2, 4] {
        assert_eq!(out, decode_with(bf16(workers), 9, &encodings), "{workers} workers");
    }
    for (i, agent) in encodings.iter().filter(|a| a.forecastable != 0).enumerate() {
        assert_eq!(out[i], decode_with(bf16(1), 9, std::slice::from_ref(agent))[0], "agent {i} alone");
    }
    let [most, rms] = apart(&out, &decode(1, 5, 9, &encodings));
    println!("{most} apart at most, {rms} at the root of the mean square");
    assert!(most > 0.0, "the precision has an effect");
    assert!(most < 0.05 && rms < 2e-3, "{most} and {rms} apart");
}

/// A clock that advances by one with each reading.
fn ticking() -> u64 {
    static NOW: AtomicU64 = AtomicU64::new(0);
    NOW.fetch_add(1, Ordering::Relaxed)
}

#[test]
fn whoever_is_served_until_the_deadline_has_the_same_bits() {
    let mut encodings = encodings(90);
    // The last agent has the first turn. An earlier stage has shed every eleventh agent.
    for (i, agent) in encodings.iter_mut().enumerate() {
        agent.turn = 90 - i as u32;
        agent.shed = u32::from(i % 11 == 0);
    }
    let whole: Vec<AgentEncoding> =
        encodings.iter().map(|agent| AgentEncoding { shed: 0, ..*agent }).collect();
    let expected = decode(1, 5, 9, &whole);
    let mut decoder = Decoder::new(&Weights::onboard(), options(1, 5)).unwrap();
    let all_count = Decoder::len(&encodings);
    let mut last_len = 0;
    for looks in [0, 5, 9, 13, 1_000] {
        let allowance = Allowance::Until { until_ns: ticking() + looks, clock: ticking };
        let served_count = decoder.serve(&header(9), &encodings, allowance).unwrap();
        assert!(served_count > last_len && served_count <= all_count, "{served_count} of {all_count}");
        last_len = served_count;
        let mut out = vec![AgentControls::zeroed(); served_count];
        decoder.write(&mut out);
        let served: Vec<u64> =
            (0..90).filter(|place| decoder.is_served(*place)).map(|place| encodings[place].id).collect();
        assert!(served.iter().all(|id| (id - 100) % 11 != 0), "{served:?}");
        assert!(
            out.iter().map(|controls| controls.id).eq(served.iter().copied()),
            "in the order of the frame"
        );
        for controls in &out {
            assert_eq!(Some(controls), expected.iter().find(|whole| whole.id == controls.id));
        }
        // Within a type, agents are served in the order of their turns.
        for agent_type in 0..3 {
            let wanted = encodings.iter().filter(|a| a.forecastable != 0 && a.shed == 0);
            let mut of_type: Vec<_> = wanted.filter(|a| a.agent_type == agent_type).collect();
            of_type.sort_by_key(|agent| agent.turn);
            assert!(of_type.iter().map(|agent| served.contains(&agent.id)).is_sorted_by(|a, b| a >= b));
        }
    }
    assert_eq!(last_len, all_count, "there was time for all");
}

#[test]
fn a_bad_frame_is_refused_and_leaves_the_output() {
    let mut decoder = Decoder::new(&Weights::onboard(), options(2, 0)).unwrap();
    let good = encodings(8);
    let mut out = room(&good);
    let before = out.clone();
    let mut bad = good.clone();
    bad[3].temporal[9] = f32::NAN;
    let rejected = frames::decode(&mut decoder, &header(0), &bad, &mut out).unwrap_err();
    assert_eq!(rejected, Rejected::NotFinite { field: "temporal summary" });
    let mut bad = good.clone();
    bad[3].agent_type = 3;
    assert!(matches!(
        frames::decode(&mut decoder, &header(0), &bad, &mut out),
        Err(Rejected::Impossible { .. })
    ));
    let mut bad = good.clone();
    bad[0].present = 1 << 8;
    assert!(matches!(
        frames::decode(&mut decoder, &header(0), &bad, &mut out),
        Err(Rejected::Impossible { .. })
    ));
    assert_eq!(out, before);
    frames::decode(&mut decoder, &header(0), &good, &mut out).unwrap();
    assert_ne!(out, before);
}

fn close(a: [f32; 2], b: [f32; 2]) {
    assert!((a[0] - b[0]).abs() < 1e-4 && (a[1] - b[1]).abs() < 1e-4, "{a:?} is not {b:?}");
}

/// The ridge regression and the anchor are added to the kept share of the network's mean. The best forecast
/// has no anchor.
#[test]
fn the_base_control_is_added_to_the_means() {
    let mut model = Model::with_all_options();
    model.config["base_latent"] = false.into();
    let based = model.weights();
    model.config["base"] = false.into();
    let plain = model.weights();
    let encodings = encodings(6);
    let controls = |weights: &Weights| {
        let mut decoder = Decoder::new(weights, options(1, 0)).unwrap();
        let mut out = room(&encodings);
        frames::decode(&mut decoder, &header(0), &encodings, &mut out).unwrap();
        out
    };
    let (with, without) = (controls(&based), controls(&plain));
    let forecastable = encodings.iter().filter(|agent| agent.forecastable != 0);
    for (agent, (with, without)) in forecastable.zip(with.iter().zip(&without)) {
        let base = Base::read(&based, agent.agent_type.try_into().unwrap()).unwrap();
        let features = BaseFeatures::new(&agent.state[..8], |_| true, based.config());
        let mut ridge = [[0.0; 2]; 12];
        base.ridge(&features, &mut ridge);
        assert!(ridge.as_flattened().iter().any(|x| *x != 0.0));
        assert_eq!((with.base, without.base), (ridge, [[0.0; 2]; 12]));
        let share = nn::base::kept_share(base.outside(&features));
        assert!((0.0..1.0).contains(&share), "the random histories lie outside of a random support: {share}");
        assert_eq!(with.out_of_distribution, base.outside(&features));
        for (step, (ridge, anchor)) in ridge.iter().zip(base.anchor(&features, 7)).enumerate() {
            let moved = |with: &ControlGaussian, without: &ControlGaussian| {
                [0, 1].map(|c| with.mean[c] - share * without.mean[c])
            };
            close(moved(&with.best[step], &without.best[step]), *ridge);
            close(
                moved(&with.modes[7][step], &without.modes[7][step]),
                [ridge[0] + anchor[0], ridge[1] + anchor[1]],
            );
        }
        assert_eq!(with.probability, without.probability);
        assert!(
            with.probability[..20].iter().any(|p| (p - 0.05).abs() > 1e-4),
            "the mode head has an effect"
        );
    }
}
