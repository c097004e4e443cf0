//! Context frames as the localiser sends them. The agents drive in circles.
#![expect(clippy::unwrap_used, reason = "a test ends at what it can't do")]

use bytemuck::Zeroable;
use extractor::{Extractor, ExtractorOptions};
use nn::Weights;
use wire::{
    Context, ContextMut, ContextShape, FeatureShape, Features, FeaturesMut, Header, HistoryState, Rejected,
    Row, Track, context_rows, feature_rows,
};

/// Ticks of 80 ms.
pub const TICK_NS: i64 = 80_000_000;

/// The state of an agent at a time. Each agent drives in its own circle, with its own phase.
fn state(id: u64, stamp_ns: i64) -> HistoryState {
    let (turn, radius_m) = (stamp_ns as f32 * 1e-9 * 0.3 + id as f32, 6.0);
    HistoryState {
        x_m: (id % 8) as f32 * 7.0 + radius_m * turn.cos(),
        y_m: (id / 8) as f32 * 7.0 + radius_m * turn.sin(),
        vx_mps: -0.3 * radius_m * turn.sin(),
        vy_mps: 0.3 * radius_m * turn.cos(),
        heading_rad: turn + std::f32::consts::FRAC_PI_2,
        present: 1,
    }
}

/// An extractor with the context frames of a scene.
pub struct Scene {
    pub extractor: Extractor,
    pub shape: ContextShape,
    pub step_ns: u64,
    context: Vec<Row>,
    features: Vec<Row>,
}

impl Scene {
    pub fn new(agents_len: usize, workers: usize) -> Self {
        let weights = Weights::onboard();
        let config = weights.config();
        let shape =
            ContextShape { agents_len, history_len: config.history_len, patch_side: config.patch_size };
        Self {
            extractor: Extractor::new(&weights, ExtractorOptions { workers }).unwrap(),
            shape,
            step_ns: config.step_ns(),
            context: vec![Row::zeroed(); context_rows(&shape)],
            features: Vec::with_capacity(feature_rows(&FeatureShape {
                agents_len,
                edges_len: wire::EDGES_MAX,
            })),
        }
    }

    /// The header of a tick.
    pub fn header(&self, tick: u64) -> Header {
        let mut header = Header::new(1, tick, tick as i64 * TICK_NS + 10_000_000_000);
        header.step_ns = self.step_ns;
        header.counts.agents_len = self.shape.agents_len as u32;
        header.counts.history_len = self.shape.history_len as u32;
        header.counts.patch_side = self.shape.patch_side as u32;
        header
    }

    /// The localiser's frame of a tick; `edit` may change it.
    pub fn localise(&mut self, header: &Header, edit: impl FnOnce(&mut ContextMut<'_>)) {
        let (shape, step_ns) = (self.shape, self.step_ns as i64);
        let mut context = ContextMut::over(&mut self.context, shape).unwrap();
        for agent in 0..shape.agents_len {
            let id = agent as u64 * 7 % 64;
            let mut track = Track { id, agent_type: (agent % 3) as u32, forecastable: 1, ..Track::zeroed() };
            for step in 0..shape.history_len {
                let stamp_ns = header.stamp_ns - (shape.history_len - 1 - step) as i64 * step_ns;
                track.history[step] = state(id, stamp_ns);
                for (i, cell) in context.patch_mut(agent, step).iter_mut().enumerate() {
                    let phase = (id as f32 + i as f32 * 0.37 + (stamp_ns / TICK_NS) as f32 * 0.11).sin();
                    *cell = phase * phase;
                }
            }
            let last = track.history[shape.history_len - 1];
            (track.x_m, track.y_m) = (last.x_m, last.y_m);
            context.tracks[agent] = track;
        }
        edit(&mut context);
    }

    /// Extracts the current frame.
    pub fn extract(&mut self, header: &Header) -> Result<Features<'_>, Rejected> {
        self.extract_of(header, None)
    }

    /// Extracts the current frame with at most `served_max` agents.
    pub fn extract_most(&mut self, header: &Header, served_max: usize) -> Result<Features<'_>, Rejected> {
        self.extract_of(header, Some(served_max))
    }

    fn extract_of(&mut self, header: &Header, served_max: Option<usize>) -> Result<Features<'_>, Rejected> {
        let context = Context::read(&self.context, self.shape).unwrap();
        let shape = self.extractor.prepare(header, &context, served_max)?;
        self.features.clear();
        self.features.resize(feature_rows(&shape), Row::zeroed());
        self.extractor.write(&mut FeaturesMut::over(&mut self.features, shape).unwrap());
        Features::read(&self.features, shape, self.shape.history_len)
    }

    /// Localises and extracts a tick.
    pub fn tick(&mut self, tick: u64) -> Features<'_> {
        let header = self.header(tick);
        self.localise(&header, |_| {});
        self.extract(&header).unwrap()
    }
}
