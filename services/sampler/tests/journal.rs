//! The state that outlives the sampler's process is the state of one tick, whenever the process was killed.

#![expect(clippy::unwrap_used, reason = "a broken fixture should fail at once")]

use bytemuck::{Zeroable, bytes_of, cast_slice_mut};
use evidence::NUMBERS_LEN;
use proptest::prelude::*;
use retrieval::{DisplacementKey, Key, Query, RetrievalMemory, Retrieved};
use sampler::journal::{Identity, Journal};
use sampler::{Sampler, SamplerOptions};
use wire::{AgentControls, ControlGaussian, Forecast, Header, HistoryState, Track};

const STEP_NS: u64 = 400_000_000;
const TICK_NS: i64 = 80_000_000;
const RUN: u64 = 7;

fn options() -> SamplerOptions {
    SamplerOptions { evidence: true, ..SamplerOptions::default() }
}

fn identity() -> Identity {
    Identity::of(RUN, &options()).unwrap()
}

/// Eight pedestrians who walk to the left of their forecasts, with new pedestrians every 8 s.
fn tick(sampler: &mut Sampler, seq: u64) -> Vec<Forecast> {
    let (round, t_s) = (seq / 100, (seq % 100) as f32 * 0.08);
    let mut tracks = vec![Track::zeroed(); 8];
    let mut controls = vec![AgentControls::zeroed(); 8];
    for (place, (track, controls)) in tracks.iter_mut().zip(&mut controls).enumerate() {
        let (id, y_m) = (round * 8 + place as u64, 3.0 * place as f32);
        let at = |t_s: f32| [1.2 * t_s, y_m + 0.05 * t_s * t_s];
        *track = Track { id, agent_type: 2, forecastable: 1, ..Track::zeroed() };
        [track.x_m, track.y_m] = at(t_s);
        (track.vx_mps, track.vy_mps) = (1.2, 0.1 * t_s);
        track.speed_mps = track.vx_mps.hypot(track.vy_mps);
        for (step, entry) in track.history.iter_mut().rev().enumerate() {
            let [x_m, y_m] = at(t_s - 0.4 * step as f32);
            *entry = HistoryState { x_m, y_m, vx_mps: 1.2, present: 1, ..HistoryState::zeroed() };
        }
        let control = ControlGaussian { mean: [0.0; 2], cholesky: [0.1, 0.0, 0.1] };
        *controls = AgentControls { id, agent_type: 2, modes_len: 20, ..AgentControls::zeroed() };
        (controls.probability, controls.modes, controls.best) =
            ([0.05; 20], [[control; 12]; 20], [control; 12]);
    }
    let mut header = Header::new(RUN, seq, seq as i64 * TICK_NS);
    header.step_ns = STEP_NS;
    let mut out = vec![Forecast::zeroed(); tracks.len()];
    sampler.step(&header, &tracks, Ok(&controls), &mut out).unwrap();
    out
}

/// Everything of a sampler that a commit must contain, except the evidence.
fn stored(memory: Option<&RetrievalMemory>) -> Vec<u8> {
    let Some(memory) = memory else { return Vec::new() };
    let state = memory.state();
    let entries = (state.oldest..state.next).map(|number| memory.entry(number).unwrap());
    bytes_of(&state).iter().copied().chain(entries.flat_map(|entry| bytes_of(&entry).to_vec())).collect()
}

fn new_journal() -> Journal<Vec<u64>> {
    let mut journal = Journal::over(Vec::new(), identity());
    journal.clear().unwrap();
    journal
}

#[test]
fn a_new_sampler_goes_on_with_what_the_one_before_had_learned() {
    let (mut sampler, mut journal) = (Sampler::new(options()), new_journal());
    assert!(journal.resume(None).unwrap().is_none(), "nothing is committed yet");
    for seq in 0..300 {
        tick(&mut sampler, seq);
        sampler.commit(seq + 1, &mut journal).unwrap();
    }
    let mut next = Sampler::new(options());
    next.resume(journal.resume(None).unwrap().unwrap()).unwrap();
    assert_eq!(next.resumed_ticks(), 300);
    assert_eq!(stored(next.memory()), stored(sampler.memory()));
    let matured = sampler.evidence().unwrap().matured_count();
    assert!(matured > 20.0 && next.evidence().unwrap().matured_count() == matured, "{matured}");

    // Both samplers forecast agents that they have not seen in the same way: all state that counts was kept.
    let [resumed, other, new] =
        [&mut next, &mut sampler, &mut Sampler::new(options())].map(|sampler| tick(sampler, 300));
    assert!(resumed == other, "the forecasts differ");
    assert!(resumed != new, "it had learned something");
    // The new sampler continues to commit.
    next.commit(301, &mut journal).unwrap();
    let mut last = Sampler::new(options());
    last.resume(journal.resume(None).unwrap().unwrap()).unwrap();
    assert_eq!((stored(last.memory()), last.resumed_ticks()), (stored(next.memory()), 301));
}

#[test]
fn the_state_before_the_newest_can_be_resumed_as_well() {
    let (mut sampler, mut journal) = (Sampler::new(options()), new_journal());
    let mut before = Vec::new();
    for seq in 0..150 {
        before = stored(sampler.memory());
        tick(&mut sampler, seq);
        sampler.commit(seq + 1, &mut journal).unwrap();
    }
    assert!(journal.resume(Some(120)).unwrap().is_none());
    let mut next = Sampler::new(options());
    next.resume(journal.resume(Some(149)).unwrap().unwrap()).unwrap();
    assert_eq!(stored(next.memory()), before);
    tick(&mut next, 149);
    next.commit(150, &mut journal).unwrap();
    let mut last = Sampler::new(options());
    last.resume(journal.resume(None).unwrap().unwrap()).unwrap();
    assert_eq!(stored(last.memory()), stored(next.memory()), "the newer record was written anew");
}

#[test]
fn what_belongs_to_others_or_is_damaged_is_refused() {
    let (mut sampler, mut journal) = (Sampler::new(options()), new_journal());
    (0..60).for_each(|seq| drop(tick(&mut sampler, seq)));
    sampler.commit(60, &mut journal).unwrap();
    let bytes = journal.into_storage();
    let why = |bytes: Vec<u64>, run_id, options: &SamplerOptions| {
        Journal::over(bytes, Identity::of(run_id, options).unwrap()).resume(None).err()
    };
    assert_eq!(why(bytes.clone(), RUN, &options()), None);
    assert_eq!(why(bytes.clone(), 8, &options()), Some("of another run"));
    let other = SamplerOptions { evidence: false, ..options() };
    assert_eq!(why(bytes.clone(), RUN, &other), Some("of a sampler with other options"));
    assert_eq!(why(bytes[..400].to_vec(), RUN, &options()), Some("of another version"));
    for (byte, expected) in [(0, "of another version"), (9, "damaged")] {
        let mut damaged = bytes.clone();
        cast_slice_mut::<u64, u8>(&mut damaged)[byte] ^= 1;
        assert_eq!(why(damaged, RUN, &options()), Some(expected));
    }
    assert!(
        Identity::of(RUN, &SamplerOptions { retrieval: false, evidence: false, ..options() }).is_none(),
        "nothing is learned"
    );
}

#[test]
fn a_slot_that_is_damaged_is_never_resumed() {
    let (mut sampler, mut journal) = (Sampler::new(options()), new_journal());
    for seq in 0..60 {
        tick(&mut sampler, seq);
        sampler.commit(seq + 1, &mut journal).unwrap();
    }
    let mut bytes = journal.into_storage();
    // The number of the first entry, at the start of the slots.
    let slots_at = bytes.len() - 8192 * 160 / 8;
    bytes[slots_at + 1] ^= 4;
    let resumed = Journal::over(bytes, identity()).resume(None);
    assert_eq!(resumed.err(), Some("number of the entries"));
}

#[test]
fn entries_go_round_once_there_are_too_many() {
    let options = SamplerOptions { evidence: false, ..options() };
    let mut journal = Journal::over(Vec::new(), Identity::of(RUN, &options).unwrap());
    journal.clear().unwrap();
    let mut memory = RetrievalMemory::new(12, STEP_NS);
    let steps = RetrievalMemory::ENTRIES_MAX as u64 / 128 + 20;
    for step in 0..steps {
        let stamp_ns = (step * STEP_NS) as i64;
        // Far from each other, so that a search finds nothing.
        let at = |agent: u64| [(agent * 100) as f32, (step * 20) as f32];
        memory.observe(stamp_ns, (0..128).map(|agent| (agent, at(agent))));
        for agent in 0..128 {
            let key = Key::Displacement(DisplacementKey { position_m: at(agent), velocity_mps: [0.0; 2] });
            let forecast_m = [at(agent); 12];
            let query = Query { stamp_ns, agent, key };
            memory.retrieve_and_store(&query, &forecast_m, &mut Retrieved::default());
        }
        journal.commit(step + 1, Some(&memory), None).unwrap();
    }
    assert!(memory.state().oldest > 0);
    let mut next = Sampler::new(options);
    next.resume(journal.resume(None).unwrap().unwrap()).unwrap();
    assert!(stored(next.memory()) == stored(Some(&memory)));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    /// A partly written commit, in any order of writes, leaves the state of this tick or of the previous one.
    #[test]
    fn a_commit_that_is_torn_leaves_one_of_two_states(
        ticks in 1..40_u64,
        written in proptest::collection::vec(any::<bool>(), 64),
        from in 0..1_000_usize,
        step in 1..700_usize,
    ) {
        let (mut sampler, mut journal) = (Sampler::new(options()), new_journal());
        for seq in 0..ticks {
            tick(&mut sampler, seq);
            sampler.commit(seq + 1, &mut journal).unwrap();
        }
        let states = [stored(sampler.memory()), { tick(&mut sampler, ticks); stored(sampler.memory()) }];
        let mut torn = journal.into_storage();
        let mut journal = Journal::over(torn.clone(), identity());
        journal.resume(None).unwrap().unwrap();
        sampler.commit(ticks + 1, &mut journal).unwrap();
        let after = journal.into_storage();
        let changed: Vec<usize> = (0..torn.len()).filter(|&word| torn[word] != after[word]).collect();
        prop_assert!(changed.len() > NUMBERS_LEN / 8);
        for (place, &word) in changed.iter().enumerate() {
            if written[((place + from) / step) % written.len()] {
                torn[word] = after[word];
            }
        }
        let mut next = Sampler::new(options());
        next.resume(Journal::over(torn, identity()).resume(None).unwrap().unwrap()).unwrap();
        let found = states.iter().position(|state| *state == stored(next.memory()));
        prop_assert_eq!(found.map(|found| found as u64 + ticks), Some(u64::from(next.resumed_ticks())));
    }
}
