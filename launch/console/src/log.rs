//! The log of this program and of the processes that it starts.
//!
//! Every line goes through `tracing`, except the failure with which a command ends (`Failure::print`). A line
//! of a stage was formatted by its own process and is relayed. While the table of a run is drawn, lines are
//! printed above the table. Otherwise, they go to standard error. In the launcher neither waits for the reader of
//! the log: `streams` and `outlet`.

use std::collections::{BTreeMap, VecDeque};
use std::io::Write;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use clap::builder::{PossibleValuesParser, TypedValueParser};
use ports::{LAUNCHER_VARIABLE, LOG_VARIABLE, LogFormat, OUTPUT_TARGET};
use serde_json::Value;
use supervisor::{Origin, QUEUE_BYTES_MAX, Queue, parse};
use tracing::Level;
use wire::StageId;

use crate::color;
use crate::streams::{self, Stream};

/// The events of the log unless `RUST_LOG` selects others: reports of the programs, and warnings of all other
/// crates.
const EVENTS: &str = "warn,launch=info,telemetry=info,stgdat_lab=info,trainer=info";

/// The format of this process.
static FORMAT: OnceLock<LogFormat> = OnceLock::new();

/// Whether a table is drawn.
static HAS_TABLE: AtomicBool = AtomicBool::new(false);

/// Holds the lines until they are printed above the table.
static ABOVE_TABLE: Queue = Queue::new(QUEUE_BYTES_MAX);

/// The formats as the values of an argument.
pub fn formats() -> impl TypedValueParser<Value = LogFormat> {
    PossibleValuesParser::new(LogFormat::ALL.map(LogFormat::name))
        .map(|name| LogFormat::from_name(&name).unwrap_or_default())
}

/// The format of this process.
pub fn format() -> LogFormat {
    FORMAT.get().copied().unwrap_or_default()
}

/// Starts the log of this process.
pub fn begin(format: Option<LogFormat>) {
    let format = *FORMAT.get_or_init(|| format.unwrap_or_default());
    if std::env::var_os(LAUNCHER_VARIABLE).is_some() {
        ports::begin_logging(format);
    } else {
        ports::begin_command_logging(format, EVENTS, || Output);
    }
}

/// The environment variable that gives the format to a process that this one starts.
pub fn variable() -> (&'static str, &'static str) {
    (LOG_VARIABLE, format().name())
}

/// Gives the format to a process that this one starts.
pub fn pass_on(command: &mut Command) -> &mut Command {
    let (name, value) = variable();
    command.env(name, value)
}

/// Sends all further lines to [`lines_above`], or to standard error again.
pub fn above_table(has_table: bool) {
    HAS_TABLE.store(has_table, Ordering::Release);
}

/// Hands the lines above the table to `print`. They wait if it returns false.
pub fn lines_above(print: impl FnOnce(&str) -> bool) {
    ABOVE_TABLE.offer(|lines| print(String::from_utf8_lossy(lines).trim_end_matches('\n')));
}

/// Returns the numbers of lines that were discarded, because their reader is too slow or gone.
pub fn lost() -> BTreeMap<Origin, u64> {
    let mut lost = ABOVE_TABLE.lost();
    streams::lost().into_iter().for_each(|(origin, lines)| *lost.entry(origin).or_default() += lines);
    lost
}

/// Time for which a repeated warning is not printed again, such as one about a full disk.
const REPEAT: Duration = Duration::from_mins(1);
/// Most warnings that are remembered for this.
const REPEATS_MAX: usize = 64;
/// The warnings of the last minute, oldest first.
static WARNINGS: Mutex<VecDeque<Warning>> = Mutex::new(VecDeque::new());

/// A printed warning.
struct Warning {
    origin: Origin,
    text: String,
    printed: Instant,
    repeats: u32,
}

/// Whether this warning or error was printed within the last minute. When the minute is over, the next warning
/// of anybody prints the number of repetitions first.
pub fn repeats(origin: Origin, level: Level, text: &str) -> bool {
    if level > Level::WARN {
        return false;
    }
    let now = Instant::now();
    let mut warnings = WARNINGS.lock().unwrap_or_else(PoisonError::into_inner);
    let mut over = Vec::new();
    while let Some(first) = warnings.front()
        && (now - first.printed >= REPEAT || warnings.len() > REPEATS_MAX)
    {
        over.extend(warnings.pop_front());
    }
    let known = warnings.iter_mut().find(|known| known.origin == origin && known.text == text);
    let is_known = known.map(|known| known.repeats += 1).is_some();
    if !is_known {
        warnings.push_back(Warning { origin, text: text.to_owned(), printed: now, repeats: 0 });
    }
    drop(warnings);
    for Warning { origin, text, repeats, .. } in over.into_iter().filter(|warning| warning.repeats > 0) {
        let name = origin.map_or("launcher", |stage| stage.name());
        tracing::warn!(target: "launcher", "{repeats} more times from the {name}: {}", text.trim_start());
    }
    is_known
}

/// Writes a line of a stage's output: as text with the stage's name before it, as JSON with the field
/// `stage`. A line that is not an object becomes the message. A warning is printed at most once per minute.
pub fn relay(stage: StageId, line: &str) {
    let line = match format() {
        LogFormat::Text => {
            let level = level_of(line);
            // The time comes first.
            if repeats(Some(stage), level, line.split_once(' ').map_or(line, |(_, message)| message)) {
                return;
            }
            let line = format!("{}{}: {line}", ports::priority(level), stage.name());
            match color::choice().is_on(&std::io::stderr()) && !HAS_TABLE.load(Ordering::Acquire) {
                true => color::with_level(&line).into_owned(),
                false => line,
            }
        }
        LogFormat::Json => match with_stage(stage, line) {
            Some(object) => {
                let level =
                    object["level"].as_str().and_then(|level| level.parse().ok()).unwrap_or(Level::INFO);
                if repeats(Some(stage), level, object["message"].as_str().unwrap_or_default()) {
                    return;
                }
                format!("{}{object}", ports::priority(level))
            }
            None => return tracing::info!(target: OUTPUT_TARGET, stage = stage.name(), "{line}"),
        },
    };
    write(Some(stage), &format!("{line}\n"));
}

/// The level in a line of text: time and level come first.
fn level_of(line: &str) -> Level {
    let level = |word: &str| word.parse().ok().filter(|_| word.chars().all(|c| c.is_ascii_uppercase()));
    line.split_whitespace().take(2).find_map(level).unwrap_or(Level::INFO)
}

/// The object of a stage's line with the stage's name; `None` if the stage did not write the line with
/// `tracing`.
fn with_stage(stage: StageId, line: &str) -> Option<Value> {
    let mut object = parse(line)?;
    object.insert("stage".to_owned(), stage.name().into());
    Some(object.into())
}

/// Prints a line of a run, such as the file of its recording: as an event if the log is JSON, and otherwise on
/// standard output.
pub fn print_line(line: &str) {
    match format() {
        LogFormat::Text => crate::say!("{line}"),
        LogFormat::Json => tracing::info!(target: OUTPUT_TARGET, "{line}"),
    }
}

/// Writes whole lines, without commands to the terminal.
pub fn write(origin: Origin, text: &str) {
    let text = &*ports::escaped(text, color::choice().is_on(&std::io::stderr()));
    if HAS_TABLE.load(Ordering::Acquire) {
        ABOVE_TABLE.push(origin, text.into());
    } else {
        streams::write(Stream::Error, origin, text);
    }
}

/// Output of `tracing`, which writes each event as a whole.
struct Output;

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        write(None, &String::from_utf8_lossy(bytes));
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_relayed_object_names_its_stage() {
        let line = r#"{"timestamp":"2026-11-27T00:00:00Z","level":"WARN","message":"late"}"#;
        let relayed = with_stage(StageId::Decoder, line).expect("an object");
        assert_eq!(relayed["stage"], "decoder");
        assert_eq!((&relayed["message"], &relayed["level"]), (&"late".into(), &"WARN".into()));
    }

    #[test]
    fn a_warning_repeats_by_stage_and_text() {
        let repeats = |stage, text| repeats(Some(stage), Level::WARN, text);
        assert!(!repeats(StageId::Recorder, "no space") && repeats(StageId::Recorder, "no space"));
        assert!(repeats(StageId::Recorder, "no space"));
        let counts = WARNINGS.lock().unwrap().iter().map(|warning| warning.repeats).collect::<Vec<_>>();
        assert_eq!(counts, [2]);
        assert!(!repeats(StageId::Sampler, "no space") && !repeats(StageId::Recorder, "no room"));
        assert!((0..2).all(|_| !super::repeats(Some(StageId::Recorder), Level::INFO, "tick")));
        assert_eq!(level_of("2026-11-27T00:00:00Z  WARN late"), Level::WARN);
        assert_eq!(level_of("frame 3 is late: error"), Level::INFO);
    }

    #[test]
    fn a_line_without_an_object_is_none() {
        for line in ["panicked at 'x'", "{broken", "[1, 2]", ""] {
            assert_eq!(with_stage(StageId::Tracker, line), None);
        }
    }
}
