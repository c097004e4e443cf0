use std::path::PathBuf;
use std::sync::Arc;

/// The options of an evaluation.
#[derive(Clone, Debug)]
pub struct Options {
    /// Folder that contains one folder of recordings per source.
    pub folder: PathBuf,
    /// Names of the sources; all sources if empty.
    pub sources: Vec<String>,
    /// Weights; `None` uses the embedded weights.
    pub weights: Option<PathBuf>,
    /// Precision of the decoder.
    pub precision: nn::Precision,
    /// Whether the network reads the online map.
    pub map: bool,
    /// Folder with a Lanelet2 map of each recording, `SOURCE/RECORDING.osm`, whose lanes vehicles follow.
    /// Recordings without a map are played without lanes.
    pub lanes: Option<PathBuf>,
    /// Whether the sampler uses evidence from matured forecasts.
    pub evidence: bool,
    /// Whether a source begins with a prior from the other sources. If not, it begins without a prior, so its
    /// evidence is independent of them.
    pub priors: bool,
    /// The sensor that sees the recordings. Errors are relative to the recordings as they are.
    pub noise: crate::noise::Noise,
    /// Threads that share the work; results do not depend on their number.
    pub threads: usize,
    /// Where all forecasts behind the tables are written. Sources are then played in turn.
    pub lines: Option<Arc<crate::lines::ForecastLines>>,
}
