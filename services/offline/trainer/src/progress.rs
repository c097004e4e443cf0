//! Progress of a run: a bar in a terminal, lines of the log elsewhere.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use crate::objective::LossParts;

/// Interval of the lines.
const LINE_EVERY: Duration = Duration::from_secs(30);
/// Weight of a new loss in the running mean that is shown.
const SMOOTHING: f32 = 0.02;

/// The progress display.
pub(crate) struct Progress {
    bar: ProgressBar,
    is_terminal: bool,
    begun: Instant,
    begun_at: u64,
    last_line: Instant,
    smoothed: Option<LossParts>,
}

impl Progress {
    /// Progress of a run of `steps` that begins at update `step`.
    pub(crate) fn new(steps: u64, step: u64) -> Self {
        let is_terminal = std::io::stderr().is_terminal();
        let bar = if is_terminal { ProgressBar::new(steps) } else { ProgressBar::hidden() };
        let template = "{bar:30} {pos}/{len}  {per_sec}  {eta} left  {msg}";
        bar.set_style(
            ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()),
        );
        bar.set_length(steps);
        bar.set_position(step);
        bar.reset_eta();
        let now = Instant::now();
        Self { bar, is_terminal, begun: now, begun_at: step, last_line: now, smoothed: None }
    }

    /// Restarts the count of time and updates.
    pub(crate) fn restart(&mut self, step: u64) {
        self.bar.set_position(step);
        self.bar.reset_eta();
        (self.begun, self.begun_at, self.last_line) = (Instant::now(), step, Instant::now());
    }

    /// Shows a step of the preparation or a result.
    pub(crate) fn note(&self, text: &str) {
        if self.is_terminal {
            self.bar.println(text);
        } else {
            tracing::info!("{text}");
        }
    }

    /// Shows the file that is being read.
    pub(crate) fn reading(&self, path: &std::path::Path) {
        self.bar.set_message(format!("reading {}", path.display()));
    }

    /// Counts an update.
    pub(crate) fn step(&mut self, step: u64, loss: LossParts) {
        let smoothed = self.smoothed.map_or(loss, |old| old.mixed(loss, SMOOTHING));
        self.smoothed = Some(smoothed);
        let LossParts { trajectory, single, probability, spread } = smoothed;
        let losses = format!(
            "trajectory {trajectory:.3}  single {single:.3}  probability {probability:.3}  spread {spread:.3}"
        );
        self.bar.set_position(step);
        if !self.is_terminal && self.last_line.elapsed() >= LINE_EVERY {
            let steps = self.bar.length().unwrap_or(step);
            let rate = (step - self.begun_at) as f64 / self.begun.elapsed().as_secs_f64().max(1e-9);
            let left_s = (steps.saturating_sub(step)) as f64 / rate.max(1e-9);
            tracing::info!("step {step}/{steps}  {rate:.1}/s  {:.0} min left  {losses}", left_s / 60.0);
            self.last_line = Instant::now();
        }
        self.bar.set_message(losses);
    }

    /// Ends the display.
    pub(crate) fn finish(&self) {
        self.bar.finish_and_clear();
    }
}
