//! Shows a run in a terminal, from the status of its launcher.

mod client;
mod columns;
mod draw;
mod stage;

use clap::ValueEnum;
use recorder::status::{RunStatus, StageStatus};

pub use client::Client;
pub use draw::text;

wire::named! {
    /// Order of the stages.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
    pub enum SortBy {
        /// In the order in which a tick passes them
        #[default]
        Chain => "chain",
        /// By the 99th percentile of compute time, slowest first
        P99 => "p99",
        /// By compute time relative to the budget, largest first
        Budget => "budget",
        /// By waiting time, longest first
        Waiting => "waiting",
        /// By lost frames, most first
        Lost => "lost",
        /// By CPU use, most first
        Cpu => "cpu",
        /// By memory, most first
        Memory => "memory",
    }
}

impl SortBy {
    fn next(self) -> Self {
        let all = Self::ALL;
        let place = all.iter().position(|&by| by == self).unwrap_or(0);
        all[(place + 1) % all.len()]
    }
}

/// The displayed state of a run.
#[derive(Debug)]
pub struct View {
    status: RunStatus,
    sort: SortBy,
    /// Index of the selected stage in the displayed order.
    selected: usize,
    /// The stage shown alone, if any.
    stage: Option<String>,
    paused: bool,
    silent: bool,
}

impl View {
    /// Creates the view of a run.
    pub const fn new(status: RunStatus, sort: SortBy, stage: Option<String>) -> Self {
        Self { status, sort, selected: 0, stage, paused: false, silent: false }
    }

    /// Returns the newest displayed status.
    pub const fn status(&self) -> &RunStatus {
        &self.status
    }

    /// Sets a newer status, unless the view is paused.
    pub fn update(&mut self, status: RunStatus) {
        self.silent = false;
        if !self.paused {
            self.status = status;
        }
    }

    /// Records that the launcher has not answered.
    pub const fn silent(&mut self) {
        self.silent = true;
    }

    /// Pauses or resumes status updates.
    pub const fn pause(&mut self) {
        self.paused = !self.paused;
    }

    /// Sorts by the next column.
    pub fn sort_by_next(&mut self) {
        self.sort = self.sort.next();
    }

    /// Selects another stage.
    pub fn select(&mut self, by: isize) {
        let last = self.status.stages.len().saturating_sub(1);
        self.selected = self.selected.saturating_add_signed(by).min(last);
        if self.stage.is_some() {
            self.enter_stage();
        }
    }

    /// Shows only the selected stage.
    pub fn enter_stage(&mut self) {
        let name = self.stages().get(self.selected).map(|stage| stage.name.clone());
        self.stage = name;
    }

    /// Shows all stages. Returns false if they were shown already.
    pub fn leave_stage(&mut self) -> bool {
        self.stage.take().is_some()
    }

    /// Returns the stages in the displayed order.
    fn stages(&self) -> Vec<&StageStatus> {
        let mut stages: Vec<&StageStatus> = self.status.stages.iter().collect();
        let lost = |stage: &StageStatus| self.of_report(stage).map_or(0, |report| report.drops.total());
        let key = |stage: &StageStatus| -> f64 {
            let p99 = stage.recent_compute_ms.p99;
            let value = match self.sort {
                SortBy::Chain => None,
                SortBy::P99 => p99,
                SortBy::Budget => p99.zip(stage.budget_ms).map(|(p99, budget)| p99 / budget),
                SortBy::Waiting => stage.recent_waiting_ms.p99,
                SortBy::Lost => Some(lost(stage) as f64),
                SortBy::Cpu => stage.process.cpu,
                SortBy::Memory => stage.process.memory_bytes.map(|bytes| bytes as f64),
            };
            value.unwrap_or(-1.0)
        };
        // The sort is stable, so equal stages stay in pipeline order.
        stages.sort_by(|a, b| key(b).total_cmp(&key(a)));
        stages
    }

    /// Finds the report so far of a stage.
    fn of_report(&self, stage: &StageStatus) -> Option<&recorder::report::StageReport> {
        self.status.report.stages.iter().find(|report| report.name == stage.name)
    }
}

#[cfg(test)]
mod tests;
