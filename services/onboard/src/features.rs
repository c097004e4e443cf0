use bytemuck::Zeroable;
use extractor::{Effort, Extractor, ExtractorOptions, StartError};
use localiser::{Localiser, LocaliserOptions};
use nn::Weights;
use wire::{
    Context, ContextMut, FeatureShape, Features, FeaturesMut, Header, Rejected, Row, StageId, Track,
    context_rows, feature_rows,
};

/// Localiser and extractor. They keep maps and embeddings of earlier ticks.
pub struct TracksToFeatures {
    localiser: Localiser,
    extractor: Extractor,
    context: Vec<Row>,
}

/// The `features` payload of a tick, in reused memory.
#[derive(Default)]
pub struct FeatureFrame {
    header: Header,
    rows: Vec<Row>,
    shape: Option<FeatureShape>,
}

impl FeatureFrame {
    /// The header that the extractor sends.
    #[must_use]
    pub const fn header(&self) -> &Header {
        &self.header
    }

    /// Number of agents in the frame.
    #[must_use]
    pub fn agents_len(&self) -> usize {
        self.shape.map_or(0, |shape| shape.agents_len)
    }

    /// The payload; `None` before the first tick that was not refused.
    ///
    /// # Errors
    /// [`Rejected`] if the payload is invalid.
    pub fn features(&self) -> Option<Result<Features<'_>, Rejected>> {
        let shape = self.shape?;
        let history_len = self.header.counts.history_len as usize;
        Some(Features::read(&self.rows[..feature_rows(&shape)], shape, history_len))
    }
}

impl TracksToFeatures {
    /// Stages before their first tick.
    ///
    /// # Errors
    /// [`StartError`] if the weights do not contain the model or a thread can't be started.
    pub fn new(
        weights: &Weights,
        localiser: LocaliserOptions,
        extractor: ExtractorOptions,
    ) -> Result<Self, StartError> {
        let extractor = Extractor::new(weights, extractor)?;
        Ok(Self { localiser: Localiser::new(localiser), extractor, context: Vec::new() })
    }

    /// Takes the tracks of a tick to features; `passed` is called after each stage.
    ///
    /// # Errors
    /// [`Rejected`] if a stage refuses the tick. `out` is then unchanged or partly written.
    pub fn step(
        &mut self,
        header: &Header,
        tracks: &[Track],
        out: &mut FeatureFrame,
        mut passed: impl FnMut(StageId),
    ) -> Result<(), Rejected> {
        let mut header = *header;
        let shape = self.localiser.shape(tracks.len());
        let context = grown(&mut self.context, context_rows(&shape));
        let mut payload = ContextMut::over(context, shape)?;
        self.localiser.step(&header, tracks, &mut payload)?;
        header.counts.patch_side = shape.patch_side as u32;
        passed(StageId::Localiser);

        let context = Context::read(context, shape)?;
        let shape = self.extractor.prepare(&header, &context)?;
        let rows = grown(&mut out.rows, feature_rows(&shape));
        self.extractor.write(&mut FeaturesMut::over(rows, shape)?);
        header.counts.edges_len = shape.edges_len as u32;
        (out.header, out.shape) = (header, Some(shape));
        passed(StageId::Extractor);
        Ok(())
    }

    /// The extractor's work for the last tick, and the number of edges that it left out.
    #[must_use]
    pub const fn effort(&self) -> Effort {
        self.extractor.effort()
    }
}

/// The first `len` rows of a payload, which grows if it is too short.
fn grown(rows: &mut Vec<Row>, len: usize) -> &mut [Row] {
    if rows.len() < len {
        rows.resize(len, Row::zeroed());
    }
    &mut rows[..len]
}
