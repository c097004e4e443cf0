//! The log of a process: events of `tracing` as lines of text or as JSON.
//!
//! `RUST_LOG` selects the events, `--log` or [`LOG_VARIABLE`] the format. A line of JSON is one object with
//! `timestamp`, `level`, `target`, `message` and the other fields of the event. In a process of a run, the
//! object also has `run` and `tick`. In systemd's journal, each line begins with its priority.

use std::fmt;
use std::io::{self, IsTerminal as _};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{LazyLock, Mutex, PoisonError};

use rustix::fs::fstat;
use serde_json::{Map, Value};
use tracing::{Event, Level, Subscriber};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::time::{FormatTime as _, SystemTime};
use tracing_subscriber::fmt::{FmtContext, FormatEvent, FormatFields, MakeWriter};
use tracing_subscriber::registry::LookupSpan;

use crate::escape::EscapedError;

/// The environment variable that holds a [`LogFormat`], for programs that get no `--log`.
pub const LOG_VARIABLE: &str = "STGDAT_LOG";

/// Target of lines that are logged whatever `RUST_LOG` selects, such as those of other programs.
pub const OUTPUT_TARGET: &str = "output";

/// The environment variable in which systemd names the device and the file of its journal.
const JOURNAL_VARIABLE: &str = "JOURNAL_STREAM";

/// Name of the run that this process belongs to; empty before it has joined one.
static RUN: Mutex<String> = Mutex::new(String::new());

/// The newest tick of this process.
static TICK: AtomicU64 = AtomicU64::new(NO_TICK);

/// The value of [`TICK`] before the first tick.
const NO_TICK: u64 = u64::MAX;

/// Gives further lines of JSON the name of the run with this folder.
pub fn log_run(root: &Path) {
    let name = root.file_name().unwrap_or_default().to_string_lossy();
    RUN.lock().unwrap_or_else(PoisonError::into_inner).clone_from(&name.into_owned());
}

/// Gives further lines of JSON the number of this tick.
pub fn log_tick(seq: u64) {
    TICK.store(seq, Ordering::Relaxed);
}

wire::named! {
    /// Format of the log.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub enum LogFormat {
        /// Lines for people.
        #[default]
        Text => "text",
        /// A JSON object per line.
        Json => "json",
    }
}

impl LogFormat {
    /// The format of this name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.name() == name)
    }

    /// The format in [`LOG_VARIABLE`]; `Text` if there is none.
    #[must_use]
    pub fn of_environment() -> Self {
        std::env::var(LOG_VARIABLE).ok().and_then(|name| Self::from_name(&name)).unwrap_or_default()
    }
}

/// The priority of syslog before a line of this level, such as `<4>`, if standard error is systemd's journal.
/// Empty otherwise.
#[must_use]
pub fn priority(level: Level) -> &'static str {
    static IS_JOURNAL: LazyLock<bool> = LazyLock::new(|| {
        let journal = std::env::var(JOURNAL_VARIABLE).unwrap_or_default();
        fstat(io::stderr()).is_ok_and(|error| journal == format!("{}:{}", error.st_dev, error.st_ino))
    });
    match level {
        _ if !*IS_JOURNAL => "",
        Level::ERROR => "<3>",
        Level::WARN => "<4>",
        Level::INFO => "<6>",
        _ => "<7>",
    }
}

/// The time as in the lines of JSON.
#[must_use]
pub fn now() -> String {
    let mut text = String::new();
    let _ = SystemTime.format_time(&mut Writer::new(&mut text));
    text
}

/// Logs a panic as one line of JSON.
fn log_panics() {
    std::panic::set_hook(Box::new(|panic| tracing::error!(target: OUTPUT_TARGET, "{panic}")));
}

/// Starts the log of a stage's process on standard error, with time and level in each line. Without
/// `RUST_LOG`, it has warnings and errors. The launcher adds the colours.
pub fn begin_logging(format: LogFormat) {
    let builder = tracing_subscriber::fmt()
        .with_env_filter(with_output(filter("warn")))
        .with_writer(|| EscapedError)
        .with_ansi(io::stderr().is_terminal())
        // A closed pipe would make a second message about it panic.
        .log_internal_errors(false);
    // Starting fails if a test or an embedding program has already installed a log, which is then used.
    let _ = match format {
        LogFormat::Text => builder.with_target(false).try_init(),
        LogFormat::Json => {
            log_panics();
            builder.json().flatten_event(true).with_span_list(false).map_event_format(OfRun).try_init()
        }
    };
}

/// Starts the log of a command. As text, a line is the message alone, after `warning: ` or `error: `, and
/// after `launcher: ` if that is the target. Without `RUST_LOG`, the directives `default` select the events.
pub fn begin_command_logging(
    format: LogFormat,
    default: &str,
    writer: impl for<'w> MakeWriter<'w> + Send + Sync + 'static,
) {
    let filter = with_output(filter(default));
    let builder =
        tracing_subscriber::fmt().with_env_filter(filter).with_writer(writer).log_internal_errors(false);
    // As above.
    let _ = match format {
        LogFormat::Text => builder.event_format(Message).try_init(),
        LogFormat::Json => {
            log_panics();
            builder.json().flatten_event(true).with_span_list(false).map_event_format(OfRun).try_init()
        }
    };
}

/// The selection of `RUST_LOG`, else the default.
fn filter(default: &str) -> EnvFilter {
    EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(default))
}

/// The selection with the events of [`OUTPUT_TARGET`].
fn with_output(filter: EnvFilter) -> EnvFilter {
    match "output=info".parse() {
        Ok(directive) => filter.add_directive(directive),
        Err(_) => filter,
    }
}

/// The text of a command's event.
struct Message;

impl<S, N> FormatEvent<S, N> for Message
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
{
    fn format_event(
        &self,
        context: &FmtContext<'_, S, N>,
        mut writer: Writer<'_>,
        event: &Event<'_>,
    ) -> fmt::Result {
        let metadata = event.metadata();
        writer.write_str(priority(*metadata.level()))?;
        writer.write_str(match *metadata.level() {
            _ if metadata.target() == "launcher" => "launcher: ",
            Level::ERROR => "error: ",
            Level::WARN => "warning: ",
            _ => "",
        })?;
        context.format_fields(writer.by_ref(), event)?;
        writeln!(writer)
    }
}

/// Lines of JSON with `run` and `tick`.
struct OfRun<F>(F);

impl<S, N, F> FormatEvent<S, N> for OfRun<F>
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
    F: FormatEvent<S, N>,
{
    fn format_event(
        &self,
        context: &FmtContext<'_, S, N>,
        mut writer: Writer<'_>,
        event: &Event<'_>,
    ) -> fmt::Result {
        let mut line = String::new();
        self.0.format_event(context, Writer::new(&mut line), event)?;
        let Ok(mut object) = serde_json::from_str::<Map<String, Value>>(&line) else {
            return write!(writer, "{}{line}", priority(*event.metadata().level()));
        };
        let run = RUN.lock().unwrap_or_else(PoisonError::into_inner).clone();
        // An event's own field of this name stays.
        if !run.is_empty() {
            object.entry("run").or_insert(run.into());
        }
        let tick = TICK.load(Ordering::Relaxed);
        if tick != NO_TICK {
            object.entry("tick").or_insert(tick.into());
        }
        writeln!(writer, "{}{}", priority(*event.metadata().level()), Value::Object(object))
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;
    use std::sync::{Arc, Mutex};

    use super::*;

    /// Output that is stored in memory.
    #[derive(Clone, Default)]
    struct Kept(Arc<Mutex<Vec<u8>>>);

    impl Write for Kept {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.lock().unwrap().write(bytes)
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_command_prints_messages_with_their_level_or_the_launcher() {
        let kept = Kept::default();
        let writer = kept.clone();
        let builder = tracing_subscriber::fmt().event_format(Message);
        let subscriber = builder.with_writer(move || writer.clone()).finish();
        tracing::subscriber::with_default(subscriber, || {
            tracing::info!("lanes 3");
            tracing::warn!("a.csv: 3 rows skipped");
            tracing::error!("no space");
            tracing::warn!(target: "launcher", stage = "decoder", "the decoder gets no CPU");
        });
        let text = String::from_utf8(kept.0.lock().unwrap().clone()).unwrap();
        assert_eq!(
            text,
            "lanes 3\nwarning: a.csv: 3 rows skipped\nerror: no space\n\
             launcher: the decoder gets no CPU stage=\"decoder\"\n"
        );
    }

    #[test]
    fn a_line_is_json_whatever_the_run_is_named() {
        let kept = Kept::default();
        let writer = kept.clone();
        let builder = tracing_subscriber::fmt().json().flatten_event(true).map_event_format(OfRun);
        let subscriber = builder.with_writer(move || writer.clone()).finish();
        let name = "a \"run\" \u{7f}\u{301}";
        log_run(&Path::new("/tmp").join(name));
        log_tick(7);
        tracing::subscriber::with_default(subscriber, || {
            tracing::warn!("late");
            tracing::warn!(tick = 3, "an older tick");
        });
        let text = String::from_utf8(kept.0.lock().unwrap().clone()).unwrap();
        let lines: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).expect(line)).collect();
        assert_eq!((&lines[0]["run"], &lines[0]["tick"]), (&name.into(), &7.into()));
        assert_eq!((&lines[0]["message"], &lines[0]["level"]), (&"late".into(), &"WARN".into()));
        assert_eq!(lines[1]["tick"], 3);
        assert_eq!(text.matches("\"tick\"").count(), 2, "{text}");
    }

    #[test]
    fn formats_are_read_by_name() {
        assert_eq!(LogFormat::from_name("json"), Some(LogFormat::Json));
        assert_eq!(LogFormat::from_name("text"), Some(LogFormat::Text));
        assert_eq!(LogFormat::from_name("xml"), None);
    }
}
