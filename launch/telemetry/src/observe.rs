//! Observation of a running pipeline: metrics for Prometheus, the status for `stgdat top`, and a trace file.
//!
//! The launcher already reads the forecasts and heartbeats. [`Observer`] measures them and answers questions
//! about them. It opens no ports, so tools cost the stages nothing. Sockets and files have their own threads,
//! so a slow client or disk does not delay the launcher.

mod files;
mod mark;
mod server;

use std::collections::{BTreeMap, VecDeque};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::{Duration, Instant};

use clap::Args;
use console::failure::Failure;
use console::log;
use perfetto::Clocks;
use ports::monotonic_ns;
use recorder::exposition::metrics;
use recorder::status::{Facts, ProcessStatus, RunStatus, StatusEvent};
use recorder::trace::Tracer;
use recorder::{Errors, InputReport, Recorder, RecorderOptions, Supervision, Tick};
use recording::Event as Happening;
use run::Run;
use rustix::time::{ClockId, clock_gettime};
use supervisor::Usage;
use supervisor::{Event, Fleet};
use tracing::Level;
use wire::{Forecast, Header, Heartbeat, StageId};

use crate::outages::Outages;
use files::{MetricsFile, TraceFile};
pub use mark::mark;
pub use server::SOCKET;
use server::{Asked, Question, SocketFile};

/// Maximum number of waiting questions.
const QUESTIONS_MAX: usize = 16;
/// Maximum number of questions answered in a row, so that supervision is not delayed.
const ANSWERS_MAX: usize = 4;
/// Number of events kept for the status.
const EVENTS_MAX: usize = 32;

/// Outputs about a run: metrics and traces.
#[derive(Clone, Debug, Default, Args)]
pub struct ObserveArguments {
    /// Serve metrics for Prometheus on this address (http://ADDRESS/metrics). A port alone, or no address,
    /// means the loopback interface. A path means a Unix socket that only this user and root can read
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, default_missing_value = "127.0.0.1:9464", value_parser = endpoint)]
    metrics: Option<Endpoint>,
    /// Write the metrics to this file every second, for the textfile collector of node_exporter
    #[arg(long, value_name = "FILE")]
    metrics_file: Option<PathBuf>,
    /// Write a trace of all stages for Perfetto (ui.perfetto.dev)
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
}

/// Where the metrics are served.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Endpoint {
    /// Address of a TCP socket.
    Address(SocketAddr),
    /// Path of a Unix socket.
    Path(PathBuf),
}

/// Parses the place of the metrics: an address, a port, or the path of a Unix socket.
fn endpoint(text: &str) -> Result<Endpoint, String> {
    if text.contains('/') {
        return Ok(Endpoint::Path(text.into()));
    }
    let error = |error| format!("{error}, or the path of a Unix socket with a /");
    address(text).map(Endpoint::Address).map_err(error)
}

/// Parses an address, or a port of the loopback interface.
pub fn address(text: &str) -> Result<SocketAddr, String> {
    if let Ok(port) = text.parse::<u16>() {
        return Ok(SocketAddr::from(([127, 0, 0, 1], port)));
    }
    text.parse().map_err(|_| "expected an IP address with a port, such as 127.0.0.1:9464".to_owned())
}

/// Measures a run from the launcher, and answers questions about it.
pub struct Observer {
    measured: Recorder,
    accuracy_path: PathBuf,
    run: String,
    /// The recording or scene.
    title: String,
    ticks_limit: Option<u64>,
    /// The stage that a run which has not begun waits for.
    waiting_for: Option<StageId>,
    /// Whether the log says why the run waits.
    is_explained: bool,
    begun: Instant,
    usage: Usage,
    events: VecDeque<StatusEvent>,
    /// What is wrong with the input, and since when.
    input_fault: Option<(String, Instant)>,
    questions: Receiver<Asked>,
    /// Removed at the end.
    _sockets: Vec<SocketFile>,
    metrics_file: Option<MetricsFile>,
    tracer: Option<(Tracer, TraceFile)>,
}

impl Observer {
    /// Opens the sockets and files of a run.
    ///
    /// # Errors
    /// [`Failure`] if an address is taken or a file can't be written.
    pub fn open(
        run: &Run,
        arguments: &ObserveArguments,
        input: InputReport,
        title: String,
        ticks_limit: Option<u64>,
    ) -> Result<Self, Failure> {
        let (ask, questions) = sync_channel(QUESTIONS_MAX);
        let metrics_socket = match &arguments.metrics {
            Some(Endpoint::Address(address)) => server::listen_tcp(*address, ask.clone()).map(|()| None)?,
            Some(Endpoint::Path(path)) => Some(server::listen_unix(path, ask.clone())?),
            None => None,
        };
        let status_socket = server::listen_unix(&run.root.join(SOCKET), ask.clone())?;
        let metrics_file = arguments.metrics_file.as_deref();
        let metrics_file = metrics_file.map(|path| MetricsFile::begin(path, ask)).transpose()?;
        let tracer = arguments.trace.as_deref().map(|path| {
            let tracer = Tracer::new(clocks(), Some(std::process::id()));
            Ok::<_, Failure>((tracer, TraceFile::begin(path)?))
        });
        let options = RecorderOptions {
            silence_ns: recorder::STAGE.options(run).unwrap_or_default().silence_ns(),
            scores: false,
            input,
            ..RecorderOptions::of(run)
        };
        Ok(Self {
            measured: Recorder::new(options),
            accuracy_path: recorder::saved::accuracy_path(run),
            run: name_of(&run.root),
            title,
            ticks_limit,
            waiting_for: None,
            is_explained: false,
            begun: Instant::now(),
            usage: Usage::default(),
            events: VecDeque::with_capacity(EVENTS_MAX),
            input_fault: None,
            questions,
            _sockets: metrics_socket.into_iter().chain([status_socket]).collect(),
            metrics_file,
            tracer: tracer.transpose()?,
        })
    }

    /// Measures the forecasts of a tick. Returns its figures; `None` if the frame is not a newer tick.
    pub fn forecasts(&mut self, header: &Header, forecasts: &[Forecast]) -> Option<Tick> {
        // Refused frames are counted here. The launcher can't notify their stage.
        self.measured.set_clock_offset(ports::clock_offset_ns());
        let tick = self.measured.forecasts(header, forecasts).ok().flatten()?;
        if let Some((tracer, file)) = &mut self.tracer {
            tracer.tick(header, &tick);
            file.write(tracer.take());
        }
        Some(tick)
    }

    /// Measures the header of a frame that an added stage has sent outside a tick's path.
    pub fn side_output(&mut self, header: &Header) {
        let passage = self.measured.added_stage(header);
        if let (Some((stage, times)), Some((tracer, file))) = (passage, &mut self.tracer) {
            tracer.added_stage(header, stage, times);
            file.write(tracer.take());
        }
    }

    /// Measures a stage's heartbeat.
    pub fn heartbeat(&mut self, heartbeat: &Heartbeat) {
        self.measured.heartbeat(heartbeat);
        if let Some((tracer, _)) = &mut self.tracer {
            tracer.heartbeat(heartbeat);
        }
    }

    /// Returns the number of ticks whose forecasts have arrived.
    pub const fn ticks(&self) -> u64 {
        self.measured.ticks()
    }

    /// Logs an event of a stage, and records it for the status and the trace.
    pub fn event(&mut self, event: &Event) {
        if let Some((tracer, _)) = &mut self.tracer {
            let at_ns = monotonic_ns();
            match event {
                Event::Promoted { stage } => tracer.event(*stage, at_ns, "promoted", "spare took over"),
                Event::SpareGivenUp { stage, how } => tracer.event(*stage, at_ns, "given up", how),
                _ => {
                    let what = event.happened();
                    what.into_iter().for_each(|what| mark(tracer, &Happening { at_ns, what }));
                }
            }
        }
        if event.is_logged() && !self.repeats(event) {
            self.report(event.to_string());
        }
    }

    /// Whether this event was logged less than a minute ago.
    fn repeats(&mut self, event: &Event) -> bool {
        let may_repeat = match event {
            Event::NotReady { .. } => true,
            Event::Died { how, .. } => how.contains("without room"),
            _ => false,
        };
        self.is_explained |= may_repeat;
        may_repeat && log::repeats(None, Level::WARN, &event.to_string())
    }

    /// Sets the stage that a run which has not begun waits for. The first time is logged.
    pub fn wait_for(&mut self, stage: Option<StageId>) {
        if let (Some(stage), None, false) = (stage, self.waiting_for, self.is_explained) {
            self.report(format!("WAITING for {}: it has not sent a frame yet", stage.name()));
        }
        self.waiting_for = stage;
    }

    /// Logs a line and adds it to the events in the status.
    pub fn report(&mut self, text: String) {
        tracing::warn!(target: "launcher", "{text}");
        if self.events.len() == EVENTS_MAX {
            self.events.pop_front();
        }
        let elapsed_s = (self.begun.elapsed().as_secs_f64() * 10.0).round() / 10.0;
        self.events.push_back(StatusEvent { elapsed_s, text });
    }

    /// Logs a line when the input of a live run fails, and one when it is well again.
    pub fn check_input(&mut self) {
        let status = self.measured.input_status(monotonic_ns());
        if !status.is_live || status.kind() == self.input_fault.as_ref().map(|(kind, _)| kind.as_str()) {
            return;
        }
        if let Some((kind, since)) = self.input_fault.take() {
            self.report(format!(
                "the input is back: {kind} has ended after {:.1} s",
                since.elapsed().as_secs_f64()
            ));
        }
        if let (Some(kind), Some(state)) = (status.kind(), &status.state) {
            // Silence has begun with the last input.
            let age = Duration::from_secs_f64(status.age_s.unwrap_or(0.0));
            let since = Instant::now().checked_sub(age).unwrap_or_else(Instant::now);
            self.input_fault = Some((kind.to_owned(), since));
            self.report(state.clone());
        }
    }

    /// Answers the pending questions.
    pub fn answer(&mut self, fleet: &Fleet, outages: &Outages, is_linked: bool) {
        for _ in 0..ANSWERS_MAX {
            let Ok((question, reply)) = self.questions.try_recv() else { return };
            let status = self.status(fleet, outages, is_linked);
            // The client may have stopped waiting.
            let _ = reply.try_send(match question {
                Question::Metrics => metrics(&status, &self.measured),
                // The status contains nothing that JSON can't represent.
                Question::Status => serde_json::to_string(&status).unwrap_or_default() + "\n",
            });
        }
    }

    /// Returns the status of the run.
    pub fn status(&mut self, fleet: &Fleet, outages: &Outages, is_linked: bool) -> RunStatus {
        let facts = self.facts(fleet, outages, is_linked);
        RunStatus::new(&self.measured, facts)
    }

    fn facts(&mut self, fleet: &Fleet, outages: &Outages, linked: bool) -> Facts {
        let processes: BTreeMap<StageId, ProcessStatus> = fleet
            .processes()
            .map(|process| {
                let spare = fleet.spares().find(|(stage, ..)| *stage == process.stage);
                let used = process.pid.and_then(|pid| self.usage.look(process.stage, pid));
                let status = ProcessStatus {
                    state: process.state.to_owned(),
                    pid: process.pid.map(|pid| pid.as_raw_nonzero().get().unsigned_abs()),
                    restarts: process.incarnation,
                    cpu_s: used.map(|used| used.cpu_s),
                    cpu: used.and_then(|used| used.cpu),
                    memory_bytes: used.map(|used| used.memory_bytes),
                    shared_bytes: used.map(|used| used.shared_bytes),
                    spare: spare.map(|(_, state, _)| state.to_owned()),
                    promotions: spare.map_or(0, |(.., promotions)| promotions),
                };
                (process.stage, status)
            })
            .collect();
        Facts {
            run: self.run.clone(),
            launcher_pid: std::process::id(),
            linked,
            waiting_for: self.waiting_for.filter(|_| !linked),
            title: self.title.clone(),
            ticks_limit: self.ticks_limit,
            now_ns: monotonic_ns(),
            processes,
            accuracy: self.accuracy(),
            supervision: Supervision { dead_readers: fleet.dead_readers(), ..outages.record().clone() },
            events: self.events.iter().cloned().collect(),
        }
    }

    /// Returns the forecast errors that the recorder last published.
    fn accuracy(&self) -> Option<Errors> {
        serde_json::from_slice(&std::fs::read(&self.accuracy_path).ok()?).ok()
    }

    /// Writes the remaining data. Returns the failures of the files.
    pub fn close(mut self, fleet: &Fleet, outages: &Outages) -> Vec<Failure> {
        let metrics_file = self.metrics_file.take();
        let last = metrics_file.is_some().then(|| {
            let status = self.status(fleet, outages, true);
            metrics(&status, &self.measured)
        });
        let of_metrics = metrics_file.zip(last).and_then(|(file, last)| file.finish(last).err());
        let of_trace = self.tracer.and_then(|(tracer, mut file)| {
            file.write(tracer.finish());
            file.finish().err()
        });
        of_metrics.into_iter().chain(of_trace).collect()
    }
}

/// Returns a run's name: the name of its folder.
fn name_of(root: &Path) -> String {
    root.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Reads the clocks one after the other.
fn clocks() -> Clocks {
    let read = |id| {
        let now = clock_gettime(id);
        now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
    };
    Clocks {
        monotonic_ns: read(ClockId::Monotonic),
        boottime_ns: read(ClockId::Boottime),
        realtime_ns: Some(read(ClockId::Realtime)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_may_be_a_port_of_the_loopback() {
        assert_eq!(address("9464"), Ok(SocketAddr::from(([127, 0, 0, 1], 9464))));
        assert_eq!(address("0.0.0.0:80"), Ok(SocketAddr::from(([0, 0, 0, 0], 80))));
        assert!(address("localhost").is_err() && address("99999").is_err());
    }
}
