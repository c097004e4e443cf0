use std::io::Write as _;
use std::path::PathBuf;

use clap::Args;
use console::failure::Failure;
use console::say;
use perfetto::Clocks;
use recorder::trace::Tracer;
use recorder::{Recorder, RecorderOptions, WholeFile};
use recording::{FrameError, Message, Recording};
use run::Exit;
use telemetry::observe::mark;
use wire::{ForecastsTopic, HeartbeatsTopic, Topic};

use crate::recorded;

/// Arguments of `stgdat trace`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Recording of a run, as `run --record` and `record` write them
    file: PathBuf,
    /// Trace to write; by default the recording's name with the extension perfetto-trace
    #[arg(short, long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// Writes the trace of a recorded run.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let recording = recorded::open(&arguments.file)?;
    let path = arguments.out.clone().unwrap_or_else(|| arguments.file.with_extension("perfetto-trace"));
    let failed = |error| Failure::file(&path, error);
    let mut file = WholeFile::create(&path).map_err(failed)?;
    let mut tracer = None;
    let mut damages = Vec::new();
    let options = RecorderOptions { scores: false, ..RecorderOptions::default() };
    let mut measured = Recorder::new(options);
    for message in recording.messages() {
        let message = match message {
            Ok(message) => message,
            Err(error) => {
                damages.push(error);
                continue;
            }
        };
        let tracer = tracer.get_or_insert_with(|| Tracer::new(clocks(&recording, &message), None));
        if let Err(error) = take(tracer, &mut measured, &message) {
            tracing::warn!("{}: {error}", arguments.file.display());
        }
        file.write_all(&tracer.take()).map_err(failed)?;
    }
    let ticks = measured.ticks();
    if ticks == 0 {
        let why = "there are no forecasts of any tick in it";
        return Err(Failure::data_about(arguments.file.display(), why));
    }
    if let Some(tracer) = tracer {
        file.write_all(&tracer.finish()).map_err(failed)?;
    }
    file.finish().map_err(failed)?;
    if !recorder::is_standard_output(&path) {
        say!("{}: {ticks} ticks; open it at https://ui.perfetto.dev", path.display());
    }
    recorded::end_with(damages)
}

/// Returns the clocks at the first message. The machine's sleep time is not recorded, so boot time equals
/// monotonic time.
fn clocks(recording: &Recording, first: &Message) -> Clocks {
    let at_ns = match first {
        Message::Frame(frame) | Message::Before(frame) => frame.received_ns(),
        Message::Event(event) => event.at_ns,
        Message::Line(line) => line.at_ns,
    };
    let realtime_ns = at_ns.checked_add_signed(recording.about().clock_offset_ns);
    Clocks { monotonic_ns: at_ns, boottime_ns: at_ns, realtime_ns }
}

fn take(tracer: &mut Tracer, measured: &mut Recorder, message: &Message) -> Result<(), FrameError> {
    match message {
        Message::Frame(frame) if frame.topic().name == ForecastsTopic::NAME => {
            let forecasts = frame.elements::<ForecastsTopic>()?;
            // Its readers refused an invalid frame, too.
            if let Ok(Some(tick)) = measured.forecasts(frame.header(), &forecasts) {
                tracer.tick(frame.header(), &tick);
            }
        }
        Message::Frame(frame) if frame.topic().name == HeartbeatsTopic::NAME => {
            frame.elements::<HeartbeatsTopic>()?.iter().for_each(|heartbeat| tracer.heartbeat(heartbeat));
        }
        Message::Event(event) => mark(tracer, event),
        Message::Frame(_) | Message::Before(_) | Message::Line(_) => {}
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recording_becomes_a_trace_beside_it() {
        let folder = std::env::temp_dir().join(format!("stgdat_trace_{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder can be made");
        let file = folder.join("a.mcap");
        recorded::tests::write(&file);
        execute(&Arguments { file: file.clone(), out: None }).expect("it is a recording");
        let trace = std::fs::read(folder.join("a.perfetto-trace")).expect("the trace was written");
        let count =
            |text: &str| trace.windows(text.len()).filter(|window| *window == text.as_bytes()).count();
        assert_eq!(count("compute"), 9 * 7 + 3);
        assert_eq!((count("died"), count("decoder (restart 1)"), count("not learned: late")), (1, 1, 1));
        std::fs::remove_dir_all(folder).expect("the folder is ours");
    }
}
