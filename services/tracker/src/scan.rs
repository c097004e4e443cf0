use bytemuck::Zeroable;
use wire::{AgentType, Detection, Forecast, Header};

/// A frame of detections, and the forecasts that were available when it arrived, in reusable memory.
#[derive(Clone, Debug)]
pub struct Scan {
    /// Header of the frame.
    pub header: Header,
    /// The detections.
    pub detections: Vec<Detection>,
    /// Types of the detections.
    pub types: Vec<AgentType>,
    /// Header of the forecasts, if there were any.
    pub prior: Option<Header>,
    /// The forecasts.
    pub forecasts: Vec<Forecast>,
}

impl Default for Scan {
    fn default() -> Self {
        Self::new()
    }
}

impl Scan {
    /// An empty scan.
    #[must_use]
    pub fn new() -> Self {
        let (detections, types, forecasts) = (Vec::new(), Vec::new(), Vec::new());
        Self { header: Header::zeroed(), detections, types, prior: None, forecasts }
    }

    /// Whether some detections were made at times other than the frame's stamp.
    #[must_use]
    pub fn has_own_times(&self) -> bool {
        self.detections.iter().any(|detection| detection.offset_ns != 0)
    }

    /// Copies a frame and its forecasts.
    pub fn fill(
        &mut self,
        header: &Header,
        (detections, types): (&[Detection], &[AgentType]),
        prior: Option<(&Header, &[Forecast])>,
    ) {
        self.header = *header;
        self.detections.clear();
        self.detections.extend_from_slice(detections);
        self.types.clear();
        self.types.extend_from_slice(types);
        self.prior = prior.map(|(header, _)| *header);
        self.forecasts.clear();
        self.forecasts.extend_from_slice(prior.map_or(&[], |(_, forecasts)| forecasts));
    }
}
