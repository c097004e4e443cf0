//! Determinism of the encoder and rejection of bad frames. Golden vectors of the layers check its numbers.

use crate::support::frames;
use encoder::{Encoder, EncoderOptions};
use frames::Frame;
use nn::Weights;
use wire::{Edge, Rejected};

const ONE: EncoderOptions = EncoderOptions { workers: 1 };

#[test]
fn the_number_of_workers_changes_no_bit() {
    let mut encoders =
        [1, 2, 4].map(|workers| Encoder::new(&Weights::onboard(), EncoderOptions { workers }).unwrap());
    for agents in [5, 1, 17, 0, 9] {
        let frame = Frame::new(agents);
        let outs = encoders.each_mut().map(|encoder| {
            let mut out = frame.out();
            encoder.step(&frame.header, &frame.features(), usize::MAX, &mut out).unwrap();
            out
        });
        assert_eq!(outs[0], outs[1]);
        assert_eq!(outs[0], outs[2]);
    }
}

#[test]
fn every_agent_is_summarised() {
    let frame = Frame::new(5);
    let mut encoder = Encoder::new(&Weights::onboard(), ONE).unwrap();
    let mut out = frame.out();
    encoder.step(&frame.header, &frame.features(), usize::MAX, &mut out).unwrap();
    for (agent, encoding) in frame.agents.iter().zip(&out) {
        assert_eq!((encoding.id, encoding.present), (agent.id, agent.present));
        assert!(encoding.temporal.iter().any(|x| *x != 0.0));
    }
}

#[test]
fn the_order_of_the_agents_changes_rounding_alone() {
    let (frame, mut turned) = (Frame::new(6), Frame::new(6));
    turned.agents.reverse();
    turned.attributes.chunks_exact_mut(6 * 6).for_each(<[_]>::reverse);
    let mut encoder = Encoder::new(&Weights::onboard(), ONE).unwrap();
    let (mut out, mut turned_out) = (frame.out(), frame.out());
    encoder.step(&frame.header, &frame.features(), usize::MAX, &mut out).unwrap();
    encoder.step(&turned.header, &turned.features(), usize::MAX, &mut turned_out).unwrap();
    for (a, b) in out.iter().zip(turned_out.iter().rev()) {
        assert_eq!(a.id, b.id);
        let largest = a.temporal.iter().fold(0.0_f32, |most, x| most.max(x.abs()));
        for (a, b) in a.temporal.iter().zip(&b.temporal) {
            assert!((a - b).abs() <= 1e-5 * largest, "{a} and {b}");
        }
    }
}

/// A row of agents. Each agent has edges only to itself and its direct neighbours.
fn row(len: usize) -> Frame {
    let mut frame = Frame::new(len);
    let near = |edge: &Edge| edge.receiver.abs_diff(edge.sender) <= 1;
    let kept: Vec<bool> = frame.edges.iter().map(near).collect();
    let mut keep = kept.iter();
    frame.attributes.retain(|_| *keep.next().unwrap_or(&false));
    frame.edges.retain(near);
    for (i, agent) in frame.agents.iter_mut().enumerate() {
        (agent.forecastable, agent.turn) = (1, (len - i) as u32);
    }
    frame
}

#[test]
fn whoever_is_served_has_the_same_bits() {
    let whole = row(30);
    let mut partial = row(30);
    partial.agents.iter_mut().step_by(4).for_each(|agent| agent.shed = 1);
    for workers in [1, 3] {
        let mut encoder = Encoder::new(&Weights::onboard(), EncoderOptions { workers }).unwrap();
        let mut expected = whole.out();
        assert_eq!(encoder.step(&whole.header, &whole.features(), 99, &mut expected), Ok(30));
        assert!(expected.iter().all(|agent| agent.shed == 0));
        for served_max in [0, 1, 5, 21, 22, 99] {
            let mut out = partial.out();
            let served_count =
                encoder.step(&partial.header, &partial.features(), served_max, &mut out).unwrap();
            assert_eq!(served_count, served_max.min(22));
            let served = out.iter().zip(&expected).filter(|(own, _)| own.shed == 0);
            assert!(served.clone().all(|(own, whole)| own == whole), "at most {served_max}");
            // The last agent has the first turn.
            let turns: Vec<u64> = served.map(|(own, _)| own.id).collect();
            let wanted = (0..30).rev().filter(|id| id % 4 != 0).take(served_count);
            assert!(wanted.eq(turns.into_iter().rev()), "at most {served_max}");
        }
    }
}

/// Leaves out the same nodes and edges as the extractor: those on which no served agent depends in any round.
#[test]
fn nobody_served_depends_on_what_may_be_left_out() {
    let whole = row(12);
    let mut partial = row(12);
    partial.agents.iter_mut().for_each(|agent| agent.shed = u32::from(agent.id != 3));
    // With two rounds, agent 3 depends on receivers 2 to 4 and senders 1 to 5.
    let needed = |edge: &Edge| (2..=4).contains(&edge.receiver);
    let kept: Vec<bool> = partial.edges.iter().map(needed).collect();
    let mut keep = kept.iter();
    partial.attributes.retain(|_| *keep.next().unwrap_or(&false));
    partial.edges.retain(needed);
    partial
        .agents
        .iter_mut()
        .filter(|agent| !(1..=5).contains(&agent.id))
        .for_each(|a| a.node = [[0.0; 64]; 8]);
    let mut encoder = Encoder::new(&Weights::onboard(), ONE).unwrap();
    let (mut expected, mut out) = (whole.out(), partial.out());
    encoder.step(&whole.header, &whole.features(), usize::MAX, &mut expected).unwrap();
    encoder.step(&partial.header, &partial.features(), usize::MAX, &mut out).unwrap();
    assert_eq!(out[3], expected[3]);
    assert_ne!(out[3].temporal, [0.0; 64]);
}

#[test]
fn a_bad_frame_is_refused_and_leaves_the_output() {
    let mut encoder = Encoder::new(&Weights::onboard(), ONE).unwrap();
    let good = Frame::new(4);
    let mut out = good.out();
    let mut refuse = |edit: &dyn Fn(&mut Frame)| {
        let mut frame = Frame::new(4);
        edit(&mut frame);
        let rejected = encoder.step(&frame.header, &frame.features(), usize::MAX, &mut out).unwrap_err();
        assert_eq!(out, good.out());
        rejected
    };
    let nan = refuse(&|frame| frame.agents[1].node[2][3] = f32::NAN);
    assert_eq!(nan, Rejected::NotFinite { field: "node attributes" });
    let nan = refuse(&|frame| frame.attributes[3][3] = f32::INFINITY);
    assert_eq!(nan, Rejected::NotFinite { field: "edge attributes" });
    let absent = refuse(&|frame| frame.agents[0].present = 0b1111_1110);
    assert!(matches!(absent, Rejected::Impossible { field: "edge of an absent agent", .. }));
    let dangling = refuse(&|frame| frame.edges[0].sender = 9);
    assert!(matches!(dangling, Rejected::Impossible { .. }));
    let unsorted = refuse(&|frame| frame.edges.swap(0, 1));
    assert!(matches!(unsorted, Rejected::OutOfOrder { field: "edges", .. }));
    let late = Edge { step: 8, ..Edge::default() };
    let late = refuse(&|frame| *frame.edges.last_mut().unwrap() = late);
    assert!(matches!(late, Rejected::Impossible { .. }));
    let history = refuse(&|frame| frame.header.counts.history_len = 4);
    assert!(matches!(history, Rejected::Mismatch { field: "history_len", found: 4, expected: 8 }));
}
