use std::path::Path;
use std::process::ExitStatus;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use config::Pipeline;
use run::Run;
use rustix::process::Signal;
use wire::StageId;

use crate::child::{Child, Line};
use crate::failure::{Failure, StageDeath};

/// Time that the stages have to end after a request.
const END_LIMIT: Duration = Duration::from_secs(3);
/// The same where the retrieval memory has to be written.
const MEMORY_LIMIT: Duration = Duration::from_secs(20);
/// Interval between checks of processes that are ending.
const LOOK: Duration = Duration::from_millis(5);

/// The processes of a run; dropping it ends them all.
#[derive(Debug)]
pub struct Fleet {
    children: Vec<Child>,
    lines: Receiver<Line>,
    end_limit: Duration,
}

impl Fleet {
    /// Starts all stages of a pipeline; they have more time to end where `keeps_memory`.
    pub fn start(pipeline: &Pipeline, run: &Run, record: &Path, keeps_memory: bool) -> Result<Self, Failure> {
        let (sender, lines) = channel();
        let end_limit = if keeps_memory { MEMORY_LIMIT } else { END_LIMIT };
        let mut fleet = Self { children: Vec::new(), lines, end_limit };
        for stage in &pipeline.stages {
            fleet.children.push(Child::start(stage.id, stage.command.as_deref(), run, record, &sender)?);
        }
        Ok(fleet)
    }

    /// Lines that the stages wrote since the last look.
    pub fn lines(&self) -> impl Iterator<Item = Line> {
        self.lines.try_iter()
    }

    /// Whether a stage has ended with success.
    pub fn done(&mut self, stage: StageId) -> bool {
        self.children.iter_mut().any(|c| c.stage == stage && c.ended().is_some_and(|status| status.success()))
    }

    /// The first stage that ended during the run. The source and the recorder may end with success: their
    /// work can be done.
    pub fn death(&mut self) -> Option<StageDeath> {
        let unexpected = |child: &mut Child| {
            let may_end = matches!(child.stage, StageId::Source | StageId::Recorder);
            child.ended().filter(|status| !(may_end && status.success()))
        };
        let (child, status): (&mut Child, ExitStatus) =
            self.children.iter_mut().find_map(|child| unexpected(child).map(|status| (child, status)))?;
        Some(child.death(status))
    }

    /// Asks all stages to end, waits, and kills those that do not end in time.
    pub fn end(&mut self) {
        for child in &mut self.children {
            child.signal(Signal::TERM);
            // A stopped process receives the request only when it continues.
            child.signal(Signal::CONT);
        }
        let start = Instant::now();
        let running = |children: &mut Vec<Child>| children.iter_mut().any(|child| child.ended().is_none());
        while running(&mut self.children) {
            if start.elapsed() > self.end_limit {
                for child in &mut self.children {
                    child.signal(Signal::KILL);
                }
            }
            std::thread::sleep(LOOK);
        }
    }

    /// Describes the end of a stage that was asked to end and failed.
    pub fn failure(&mut self, stage: StageId) -> Option<StageDeath> {
        let child = self.children.iter_mut().find(|child| child.stage == stage)?;
        let status = child.ended().filter(|status| !status.success())?;
        Some(child.death(status))
    }
}

impl Drop for Fleet {
    fn drop(&mut self) {
        self.end();
    }
}
