//! Any recordings, evaluated with one set of weights.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use data::{OpenOptions, Recording};
use lanes::LaneMap;

use super::{Baselines, Basis, Judge, Rules, State, Subset};
use crate::error::EvaluateError;
use crate::footage::{Footage, Options, SEED};
use crate::forecaster::{EMBEDDED, MapInput, Model};
use crate::lines::ForecastLines;
use crate::scenes::Cut;
use crate::threads;

/// The subsets of recordings. Only the first two have tables.
pub(crate) const SUBSETS: [Subset; 2 + wire::AGENT_TYPES.len()] = [
    Subset::All,
    Subset::Moving,
    Subset::Of(wire::AGENT_TYPES[0]),
    Subset::Of(wire::AGENT_TYPES[1]),
    Subset::Of(wire::AGENT_TYPES[2]),
];

/// An evaluation of recordings with one set of weights, in steps of the model. Anchors and a site map are not
/// available, because there is no training part.
pub struct Evaluation {
    model: Model,
    baselines: Baselines,
    cut: Cut,
    horizons: Vec<usize>,
    map: MapInput<'static>,
    lanes: Option<Arc<LaneMap>>,
    threads: usize,
    lines: Option<Arc<ForecastLines>>,
    basis: Basis,
}

impl Evaluation {
    /// Opens the weights.
    ///
    /// # Errors
    /// If the weights can't be read.
    pub fn new(options: &Options, from_positions: bool) -> Result<Self, EvaluateError> {
        let model = options.weights.open(EMBEDDED, SEED)?;
        let cut = Cut { from_positions, ..Cut::of(model.forecaster.config()) };
        let horizons = quarters(cut.horizon_len);
        let (map, map_label) = options.map.without_sites();
        let basis = Basis {
            provenance: model.provenance("", map_label, &[]),
            from_positions,
            lanes: false,
            steps: cut.history_len + cut.horizon_len,
            dt_s: cut.dt_s,
            horizons_s: horizons.iter().map(|&steps| (steps as i64 * cut.step_ns()) as f64 / 1e9).collect(),
        };
        let baselines = Baselines::fit(std::iter::empty(), &cut, SEED);
        let (threads, lines) = (options.threads, options.lines.clone());
        Ok(Self { model, baselines, cut, horizons, map, lanes: None, threads, lines, basis })
    }

    /// Forecasts vehicles along the lanes of the recordings' site.
    #[must_use]
    pub fn along(mut self, lanes: Arc<LaneMap>) -> Self {
        self.basis.lanes = true;
        self.lanes = Some(lanes);
        self
    }

    /// Evaluates one recording. A recording without an agent over a whole window is listed as left out.
    ///
    /// # Errors
    /// If the recording can't be read.
    pub fn recording(&self, path: &Path, open: OpenOptions) -> Result<State, EvaluateError> {
        Ok(self.judged(&self.cut.read(path, open)?))
    }

    /// As [`Evaluation::recording`], of a recording that is already read.
    #[must_use]
    pub fn opened(&self, recording: Recording) -> State {
        let scenes = self.cut.scenes(&recording);
        self.judged(&Footage { recording, scenes })
    }

    /// Evaluates recordings. A recording that can't be read is one line in the state.
    ///
    /// # Errors
    /// The first failure if no recording can be read; [`EvaluateError::NoWindows`] if none has an agent over
    /// a whole window.
    pub fn recordings(
        &self,
        paths: &[PathBuf],
        open: &OpenOptions,
        mut progress: impl FnMut(&str),
    ) -> Result<State, EvaluateError> {
        let mut whole = State::new(self.basis.clone());
        let mut failure = None;
        for paths in paths.chunks(self.threads.max(1)) {
            let read = |path: &PathBuf, (): &mut ()| self.cut.read(path, open.clone());
            for (path, footage) in paths.iter().zip(threads::each(paths, self.threads, read)) {
                match footage {
                    Ok(footage) => {
                        progress(&footage.recording.name);
                        whole.add(self.judged(&footage));
                    }
                    Err(error) => {
                        whole.add_failure(&path.display().to_string(), &error.to_string());
                        failure.get_or_insert(error);
                    }
                }
            }
        }
        whole.sort();
        match (whole.need_agents(), failure) {
            (Err(_), Some(failure)) => Err(failure),
            (checked, _) => checked.map(|()| whole),
        }
    }

    fn judged(&self, footage: &Footage) -> State {
        let Footage { recording, scenes } = footage;
        let rules = Rules {
            horizons: &self.horizons,
            subsets: &SUBSETS,
            of_type: None,
            threads: self.threads,
            lines: self.lines.as_deref(),
        };
        let judge = rules.judge_with(&self.model, &self.baselines, &recording.name);
        let judge = Judge { lanes: self.lanes.clone(), ..judge };
        let blocks = judge.recording(recording, scenes, self.map, None);
        State::of(self.basis.clone(), recording, self.model.has_seen(recording), &blocks)
    }
}

/// Splits the horizon into quarters, or into fifths, if these are whole steps.
fn quarters(horizon_len: usize) -> Vec<usize> {
    let parts = [4, 5].into_iter().find(|parts| horizon_len.is_multiple_of(*parts)).unwrap_or(1);
    (1..=parts).map(|part| horizon_len * part / parts).collect()
}
