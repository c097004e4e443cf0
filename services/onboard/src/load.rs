use wire::{AgentEncoding, Edge, Features};

/// The size of the last tick, for callers that count its work.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Load {
    /// Number of agents.
    pub agents_len: usize,
    /// Number of agents present, summed over the history steps.
    pub node_count: usize,
    /// Number of edges of all history steps.
    pub edges_len: usize,
    /// Number of edges of the newest step.
    pub new_edge_count: usize,
    /// Number of agents that are forecast.
    pub forecast_count: usize,
    /// Number of states that the decoder's burn-in reads.
    pub burn_in_count: usize,
}

impl Load {
    pub(crate) fn of(features: &Features<'_>, encodings: &[AgentEncoding], history_len: u32) -> Self {
        let states = |encoding: &AgentEncoding| encoding.present.count_ones() as usize;
        let newest = |edge: &&Edge| u32::from(edge.step) + 1 == history_len;
        let forecast = || encodings.iter().filter(|encoding| encoding.forecastable != 0);
        Self {
            agents_len: encodings.len(),
            node_count: encodings.iter().map(states).sum(),
            edges_len: features.edges.len(),
            new_edge_count: features.edges.iter().filter(newest).count(),
            forecast_count: forecast().count(),
            burn_in_count: forecast().map(states).sum(),
        }
    }
}
