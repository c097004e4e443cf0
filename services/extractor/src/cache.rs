//! Caches the context embeddings of tracks and the relation embeddings of pairs of tracks by stamp.

use wire::{AgentFeatures, CONTEXT_EMBEDDING, EDGE_ATTRIBUTES, Edge, NODE_ATTRIBUTES};

/// Number of cached stamps. The longest window, 2.8 s at 12.5 Hz, needs 36; the rest allows for uneven ticks.
const STAMPS: usize = 64;
/// Marks a pair without a relation.
const NONE: u16 = u16::MAX;

/// Embeddings of the newest stamps; a new stamp replaces the oldest.
pub(crate) struct StampCache {
    stamps: Vec<Stamp>,
    /// Rows of the current frame's agents in the stamp that was looked up last.
    rows: Vec<Option<usize>>,
    /// Relations for which each stamp has memory.
    relations_room: usize,
    /// Scratch: the agents, ordered by track.
    order: Vec<usize>,
}

/// The embeddings of one stamp.
#[derive(Default)]
struct Stamp {
    stamp_ns: i64,
    /// Tracks, ascending.
    tracks: Vec<u64>,
    /// Context embeddings in the order of `tracks`.
    contexts: Vec<[f32; CONTEXT_EMBEDDING]>,
    /// \[receiver, sender\] in the order of `tracks`: index in `relations`, or [`NONE`].
    pairs: Vec<u16>,
    relations: Vec<[f32; EDGE_ATTRIBUTES]>,
}

/// The embeddings of one stamp, addressed by the agents of the current frame.
pub(crate) struct Kept<'a> {
    stamp: &'a Stamp,
    rows: &'a [Option<usize>],
}

impl Default for StampCache {
    fn default() -> Self {
        Self {
            stamps: Vec::with_capacity(STAMPS),
            rows: Vec::with_capacity(wire::AGENTS_MAX),
            relations_room: 0,
            order: Vec::with_capacity(wire::AGENTS_MAX),
        }
    }
}

impl Kept<'_> {
    /// The context embedding of an agent of the current frame.
    pub(crate) fn context(&self, agent: usize) -> Option<&[f32; CONTEXT_EMBEDDING]> {
        Some(&self.stamp.contexts[self.rows[agent]?])
    }

    /// The relation embedding of an edge of the current frame.
    pub(crate) fn relation(&self, edge: &Edge) -> Option<&[f32; EDGE_ATTRIBUTES]> {
        let [receiver, sender] = [edge.receiver, edge.sender].map(|agent| self.rows[usize::from(agent)]);
        let place = self.stamp.pairs[receiver? * self.stamp.tracks.len() + sender?];
        (place != NONE).then(|| &self.stamp.relations[usize::from(place)])
    }
}

impl StampCache {
    /// Drops all entries.
    pub(crate) fn clear(&mut self) {
        self.stamps.clear();
    }

    /// The entries of a stamp for the agents of the current frame; `None` if the stamp is not cached.
    pub(crate) fn at(&mut self, stamp_ns: i64, agents: &[AgentFeatures]) -> Option<Kept<'_>> {
        let stamp = self.stamps.iter().find(|stamp| stamp.stamp_ns == stamp_ns)?;
        self.rows.clear();
        self.rows.extend(agents.iter().map(|agent| stamp.tracks.binary_search(&agent.id).ok()));
        Some(Kept { stamp, rows: &self.rows })
    }

    /// Stores the embeddings of one step of the current frame, for the agents that have been computed. They
    /// replace earlier entries of the same stamp.
    pub(crate) fn keep(
        &mut self,
        stamp_ns: i64,
        step: usize,
        agents: &[AgentFeatures],
        is_computed: impl Fn(usize) -> bool,
        edges: &[Edge],
        relations: &[[f32; EDGE_ATTRIBUTES]],
    ) {
        self.order.clear();
        self.order.extend((0..agents.len()).filter(|&i| is_computed(i)));
        self.order.sort_unstable_by_key(|&i| agents[i].id);
        self.rows.clear();
        self.rows.resize(agents.len(), None);
        for (row, &agent) in self.order.iter().enumerate() {
            self.rows[agent] = Some(row);
        }
        self.make_room(relations.len());
        let track_count = self.order.len();
        let place = self.place(stamp_ns);
        let Stamp { tracks, contexts, pairs, relations: kept, .. } = &mut self.stamps[place];
        let in_order = self.order.iter().map(|&agent| &agents[agent]);
        tracks.clear();
        tracks.extend(in_order.clone().map(|agent| agent.id));
        contexts.clear();
        contexts.extend(in_order.map(|agent| {
            let context = agent.node[step].last_chunk::<CONTEXT_EMBEDDING>();
            const { assert!(CONTEXT_EMBEDDING <= NODE_ATTRIBUTES) };
            *context.expect("a node holds a context embedding")
        }));
        pairs.clear();
        pairs.resize(track_count * track_count, NONE);
        kept.clear();
        for (edge, relation) in edges.iter().zip(relations) {
            let [receiver, sender] = [edge.receiver, edge.sender].map(|agent| self.rows[usize::from(agent)]);
            if let (Some(receiver), Some(sender)) = (receiver, sender) {
                pairs[receiver * track_count + sender] = kept.len() as u16;
                kept.push(*relation);
            }
        }
    }

    /// The place for a stamp: its existing place, a free place, or the place of the oldest stamp.
    fn place(&mut self, stamp_ns: i64) -> usize {
        if let Some(place) = self.stamps.iter().position(|stamp| stamp.stamp_ns == stamp_ns) {
            return place;
        }
        if self.stamps.len() < STAMPS {
            self.stamps.push(Stamp::with_room(self.relations_room));
        }
        let free = self.stamps.iter().position(|stamp| stamp.tracks.is_empty());
        let oldest = || (0..STAMPS).min_by_key(|&i| self.stamps[i].stamp_ns).unwrap_or(0);
        let place = free.unwrap_or_else(oldest);
        self.stamps[place].stamp_ns = stamp_ns;
        place
    }

    /// Reserves memory for `len` relations in each stamp. A scene that is as full as an earlier one then
    /// allocates nothing.
    fn make_room(&mut self, len: usize) {
        if len > self.relations_room {
            self.relations_room = len.next_power_of_two();
            for stamp in &mut self.stamps {
                stamp.relations.reserve(self.relations_room - stamp.relations.len());
            }
        }
    }
}

impl Stamp {
    fn with_room(relations: usize) -> Self {
        Self {
            tracks: Vec::with_capacity(wire::AGENTS_MAX),
            contexts: Vec::with_capacity(wire::AGENTS_MAX),
            pairs: Vec::with_capacity(wire::AGENTS_MAX * wire::AGENTS_MAX),
            relations: Vec::with_capacity(relations),
            ..Self::default()
        }
    }
}
