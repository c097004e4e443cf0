//! Whose nodes a node depends on: what must be computed where not all agents are wanted.

use wire::{AGENTS_MAX, Edge};

/// A set of agents of one step, by their place in the frame.
pub type AgentSet = [bool; AGENTS_MAX];

/// The agents of `of` and those that send to one of them along `edges`, all of one step.
#[must_use]
pub fn with_senders(of: &AgentSet, edges: &[Edge]) -> AgentSet {
    let mut all = *of;
    for edge in edges.iter().filter(|edge| of[usize::from(edge.receiver)]) {
        all[usize::from(edge.sender)] = true;
    }
    all
}
