//! The nodes that a node depends on: the ones to compute if only some agents are wanted.

use wire::{AGENTS_MAX, Edge};

/// A set of agents of one step, by their position in the frame.
pub type AgentSet = [bool; AGENTS_MAX];

/// The agents of `of` and all agents that send to one of them along `edges`. All edges belong to one step.
#[must_use]
pub fn with_senders(of: &AgentSet, edges: &[Edge]) -> AgentSet {
    let mut all = *of;
    for edge in edges.iter().filter(|edge| of[usize::from(edge.receiver)]) {
        all[usize::from(edge.sender)] = true;
    }
    all
}
