use std::collections::BTreeMap;

use run::Run;
use wire::StageId;

use crate::arrivals::SILENCE_NS;
use crate::input::InputReport;
use crate::report::RunInfo;

/// The recorder's information about the run in addition to its topics.
#[derive(Clone, Debug)]
pub struct RecorderOptions {
    /// Copied to the report. Interval, durations and lockstep are measured if they are `None`.
    pub run: RunInfo,
    /// The stages, in the order in which a tick passes them.
    pub stages: Vec<StageId>,
    /// Each stage's share of the tick limit.
    pub budgets_ms: BTreeMap<StageId, f64>,
    /// The topics that each stage reads and writes.
    pub topics: BTreeMap<StageId, [Vec<String>; 2]>,
    /// File names of external programs.
    pub programs: BTreeMap<StageId, String>,
    /// Whether forecasts are kept and scored when truth arrives. Otherwise only times and counts are
    /// recorded, and the forecasts' numbers are not checked.
    pub scores: bool,
    /// Information about the recording's input.
    pub input: InputReport,
    /// Time without a tick that is silence.
    pub silence_ns: u64,
    /// A tick whose cause [`Recorder::explained`](super::Recorder::explained) returns.
    pub explain: Option<u64>,
}

impl Default for RecorderOptions {
    fn default() -> Self {
        Self {
            run: RunInfo::default(),
            stages: StageId::ALL.to_vec(),
            budgets_ms: BTreeMap::new(),
            topics: BTreeMap::new(),
            programs: BTreeMap::new(),
            scores: true,
            input: InputReport::default(),
            silence_ns: SILENCE_NS,
            explain: None,
        }
    }
}

impl RecorderOptions {
    /// The stages of a run.
    #[must_use]
    pub fn of(run: &Run) -> Self {
        let programs = run.stages.iter().filter(|stage| !stage.program.is_empty());
        Self {
            stages: run.order(),
            budgets_ms: run.budgets_ms(),
            topics: run.topics_of_stages(),
            programs: programs
                .filter_map(|stage| Some((StageId::from_number(stage.stage)?, stage.program.clone())))
                .collect(),
            ..Self::default()
        }
    }
}
