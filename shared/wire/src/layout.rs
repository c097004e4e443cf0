//! The two topics whose frames contain tensors of varying size, as sections of one slice of 64-byte rows.

use crate::declare::record;
use crate::{AgentFeatures, Counts, EDGE_ATTRIBUTES, PATCH_CHANNELS, Rejected, Track, finite};

record! {
    /// 64 bytes, one cache line: the unit of `context` and `features` payloads, whose sections are cast from
    /// it.
    pub struct Row: 64 bytes, aligned 64 {
        /// The bytes, as single-precision numbers.
        0 => values: [f32; 16],
    }
}

/// Agents, steps and patch side of a `context` frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ContextShape {
    /// Agents.
    pub agents_len: usize,
    /// Steps of the history window.
    pub history_len: usize,
    /// Side of the patches, in cells.
    pub patch_side: usize,
}

/// Agents and edges of a `features` frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FeatureShape {
    /// Agents.
    pub agents_len: usize,
    /// Edges of all steps.
    pub edges_len: usize,
}

const TRACK_ROWS: usize = size_of::<Track>() / size_of::<Row>();
const FEATURE_ROWS: usize = size_of::<AgentFeatures>() / size_of::<Row>();
const _: () = assert!(size_of::<Track>().is_multiple_of(64) && size_of::<AgentFeatures>().is_multiple_of(64));

impl ContextShape {
    /// The shape in a header.
    #[must_use]
    pub const fn of(counts: &Counts) -> Self {
        Self {
            agents_len: counts.agents_len as usize,
            history_len: counts.history_len as usize,
            patch_side: counts.patch_side as usize,
        }
    }

    /// Count of the numbers in one patch.
    pub const fn patch_len(&self) -> usize {
        PATCH_CHANNELS * self.patch_side * self.patch_side
    }

    const fn patch_count(&self) -> usize {
        self.agents_len * self.history_len * self.patch_len()
    }
}

impl FeatureShape {
    /// The shape in a header.
    #[must_use]
    pub const fn of(counts: &Counts) -> Self {
        Self { agents_len: counts.agents_len as usize, edges_len: counts.edges_len as usize }
    }

    const fn edge_rows(&self) -> usize {
        (self.edges_len * size_of::<Edge>()).div_ceil(size_of::<Row>())
    }
}

/// Number of rows in a `context` payload.
#[must_use]
pub const fn context_rows(shape: &ContextShape) -> usize {
    shape.agents_len * TRACK_ROWS + (shape.patch_count() * 4).div_ceil(size_of::<Row>())
}

/// Number of rows in a `features` payload.
#[must_use]
pub const fn feature_rows(shape: &FeatureShape) -> usize {
    shape.agents_len * FEATURE_ROWS + shape.edge_rows() + shape.edges_len
}

fn expect(found: usize, expected: usize) -> Result<(), Rejected> {
    if found == expected { Ok(()) } else { Err(Rejected::Length { found, expected }) }
}

/// A `context` payload: the tracks, and each track's patch at every history step.
#[derive(Clone, Copy, Debug)]
pub struct Context<'a> {
    /// The agents, at most [`crate::AGENTS_MAX`].
    pub tracks: &'a [Track],
    /// Patches as \[agent, step, channel, row, column\]; zeros if the agent is absent.
    pub patches: &'a [f32],
    /// The sizes.
    pub shape: ContextShape,
}

/// A `context` payload to be written.
#[derive(Debug)]
pub struct ContextMut<'a> {
    /// The agents.
    pub tracks: &'a mut [Track],
    /// Patches as \[agent, step, channel, row, column\].
    pub patches: &'a mut [f32],
    /// The sizes.
    pub shape: ContextShape,
}

impl<'a> Context<'a> {
    /// The sections of a payload.
    ///
    /// # Errors
    /// [`Rejected::Length`] if the payload's length does not match the shape.
    pub fn read(rows: &'a [Row], shape: ContextShape) -> Result<Self, Rejected> {
        expect(rows.len(), context_rows(&shape))?;
        let (tracks, patches) = rows.split_at(shape.agents_len * TRACK_ROWS);
        let patches: &[f32] = bytemuck::cast_slice(patches);
        Ok(Self { tracks: bytemuck::cast_slice(tracks), patches: &patches[..shape.patch_count()], shape })
    }

    /// The patch of an agent at a history step, \[channel, row, column\].
    #[must_use]
    pub fn patch(&self, agent: usize, step: usize) -> &'a [f32] {
        let len = self.shape.patch_len();
        let start = (agent * self.shape.history_len + step) * len;
        &self.patches[start..start + len]
    }
}

impl<'a> ContextMut<'a> {
    /// The sections of a payload to be written.
    ///
    /// # Errors
    /// [`Rejected::Length`] if the payload's length does not match the shape.
    pub fn over(rows: &'a mut [Row], shape: ContextShape) -> Result<Self, Rejected> {
        expect(rows.len(), context_rows(&shape))?;
        let (tracks, patches) = rows.split_at_mut(shape.agents_len * TRACK_ROWS);
        let patches: &mut [f32] = bytemuck::cast_slice_mut(patches);
        let patches = &mut patches[..shape.patch_count()];
        Ok(Self { tracks: bytemuck::cast_slice_mut(tracks), patches, shape })
    }

    /// The patch of an agent at a history step, \[channel, row, column\].
    pub fn patch_mut(&mut self, agent: usize, step: usize) -> &mut [f32] {
        let len = self.shape.patch_len();
        let start = (agent * self.shape.history_len + step) * len;
        &mut self.patches[start..start + len]
    }
}

record! {
    /// The ends of a directed edge e_ij at a history step: i receives, j sends.
    #[derive(Eq, PartialOrd, Ord)]
    pub struct Edge: 8 bytes {
        /// History step.
        0 => step: u16,
        /// Agent i.
        2 => receiver: u16,
        /// Agent j; i itself for the self edge.
        4 => sender: u16,
        /// Zero.
        6 => reserved: u16,
    }
}

/// A `features` payload: agents, edges sorted by (step, receiver, sender), and an attribute for each edge.
#[derive(Clone, Copy, Debug)]
pub struct Features<'a> {
    /// The agents.
    pub agents: &'a [AgentFeatures],
    /// The edges of all steps.
    pub edges: &'a [Edge],
    /// Edge attributes, in the order of `edges`.
    pub attributes: &'a [[f32; EDGE_ATTRIBUTES]],
}

/// A `features` payload to be written.
#[derive(Debug)]
pub struct FeaturesMut<'a> {
    /// The agents.
    pub agents: &'a mut [AgentFeatures],
    /// The edges of all steps.
    pub edges: &'a mut [Edge],
    /// Edge attributes, in the order of `edges`.
    pub attributes: &'a mut [[f32; EDGE_ATTRIBUTES]],
}

impl<'a> Features<'a> {
    /// The sections of a payload.
    ///
    /// # Errors
    /// * [`Rejected::Length`] if the payload's length does not match the shape;
    /// * [`Rejected::Impossible`] if an edge names a missing agent or step;
    /// * [`Rejected::OutOfOrder`] if the edges are not sorted or contain a duplicate.
    pub fn read(rows: &'a [Row], shape: FeatureShape, history_len: usize) -> Result<Self, Rejected> {
        expect(rows.len(), feature_rows(&shape))?;
        let (agents, rest) = rows.split_at(shape.agents_len * FEATURE_ROWS);
        let (edges, attributes) = rest.split_at(shape.edge_rows());
        let edges: &[Edge] = &bytemuck::cast_slice(edges)[..shape.edges_len];
        let attributes = bytemuck::cast_slice(attributes);
        let read = Self { agents: bytemuck::cast_slice(agents), edges, attributes };
        read.check_edges(history_len)?;
        Ok(read)
    }

    fn check_edges(&self, history_len: usize) -> Result<(), Rejected> {
        let mut last = None;
        for (at, edge) in self.edges.iter().enumerate() {
            let agents = [edge.receiver, edge.sender];
            if let Some(agent) = agents.into_iter().find(|&agent| usize::from(agent) >= self.agents.len()) {
                return Err(Rejected::Impossible { field: "edge's agent", value: f64::from(agent) });
            }
            if usize::from(edge.step) >= history_len {
                return Err(Rejected::Impossible { field: "edge's step", value: f64::from(edge.step) });
            }
            if last.is_some_and(|last| last >= *edge) {
                return Err(Rejected::OutOfOrder { field: "edges", at });
            }
            last = Some(*edge);
        }
        Ok(())
    }

    /// Refuses agents and edges that are impossible in a model with this history. Each edge needs an
    /// attribute, and joins agents that have a state at its step.
    ///
    /// # Errors
    /// [`Rejected`] names the field.
    pub fn check(&self, history_len: usize) -> Result<(), Rejected> {
        self.agents.iter().try_for_each(|agent| agent.check(history_len))?;
        finite("edge attributes", self.attributes.as_flattened())?;
        expect(self.attributes.len(), self.edges.len())?;
        self.check_edges(history_len)?;
        let is_present =
            |edge: &Edge, agent: u16| self.agents[usize::from(agent)].is_present(edge.step.into());
        let joins_present = |edge: &&Edge| is_present(edge, edge.receiver) && is_present(edge, edge.sender);
        match self.edges.iter().find(|edge| !joins_present(edge)) {
            Some(edge) => {
                Err(Rejected::Impossible { field: "edge of an absent agent", value: f64::from(edge.step) })
            }
            None => Ok(()),
        }
    }
}

impl<'a> FeaturesMut<'a> {
    /// The sections of a payload to be written.
    ///
    /// # Errors
    /// [`Rejected::Length`] if the payload's length does not match the shape.
    pub fn over(rows: &'a mut [Row], shape: FeatureShape) -> Result<Self, Rejected> {
        expect(rows.len(), feature_rows(&shape))?;
        let (agents, rest) = rows.split_at_mut(shape.agents_len * FEATURE_ROWS);
        let (edges, attributes) = rest.split_at_mut(shape.edge_rows());
        let edges: &mut [Edge] = bytemuck::cast_slice_mut(edges);
        Ok(Self {
            agents: bytemuck::cast_slice_mut(agents),
            edges: &mut edges[..shape.edges_len],
            attributes: bytemuck::cast_slice_mut(attributes),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sections_do_not_overlap_and_cover_the_payload() {
        let shape = FeatureShape { agents_len: 3, edges_len: 13 };
        let mut rows = vec![Row::default(); feature_rows(&shape)];
        let out = FeaturesMut::over(&mut rows, shape).unwrap();
        out.agents[2].node[7][63] = 1.0;
        for (i, edge) in out.edges.iter_mut().enumerate() {
            *edge = Edge {
                step: (i / 9) as u16,
                receiver: (i / 3 % 3) as u16,
                sender: (i % 3) as u16,
                reserved: 0,
            };
        }
        out.attributes[12][15] = 2.0;
        let read = Features::read(&rows, shape, 8).unwrap();
        assert_eq!(read.agents[2].node[7][63], 1.0);
        assert_eq!(read.edges[12], Edge { step: 1, receiver: 1, sender: 0, reserved: 0 });
        assert_eq!(read.attributes[12][15], 2.0);
        assert_eq!(read.attributes[0], [0.0; 16]);
    }

    #[test]
    fn unsorted_or_dangling_edges_and_wrong_lengths_are_refused() {
        let shape = FeatureShape { agents_len: 2, edges_len: 2 };
        let mut rows = vec![Row::default(); feature_rows(&shape)];
        assert!(matches!(Features::read(&rows, shape, 8), Err(Rejected::OutOfOrder { .. })), "equal edges");
        FeaturesMut::over(&mut rows, shape).unwrap().edges[1].sender = 2;
        assert!(matches!(Features::read(&rows, shape, 8), Err(Rejected::Impossible { .. })), "no agent 2");
        FeaturesMut::over(&mut rows, shape).unwrap().edges[1].sender = 1;
        assert!(Features::read(&rows, shape, 8).is_ok());
        rows.pop();
        assert!(matches!(Features::read(&rows, shape, 8), Err(Rejected::Length { .. })));
    }

    #[test]
    fn patches_are_addressed_by_agent_and_step() {
        let shape = ContextShape { agents_len: 2, history_len: 4, patch_side: 16 };
        let mut rows = vec![Row::default(); context_rows(&shape)];
        let mut out = ContextMut::over(&mut rows, shape).unwrap();
        out.patch_mut(1, 3)[767] = 5.0;
        out.tracks[1].id = 9;
        let read = Context::read(&rows, shape).unwrap();
        assert_eq!((read.patch(1, 3)[767], read.tracks[1].id), (5.0, 9));
    }
}
