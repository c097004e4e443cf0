use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use console::failure::Failure;
use console::say;
use ports::{Asked, Stop, clock_offset_ns};
use recording::tap::{Client, Item, Request};
use recording::{About, EVENTS, LOG};
use run::Exit;
use telemetry::tap::{FlightRecorder, Recorded, RingArguments, follow};
use wire::{ForecastsTopic, TABLE, Topic as _};

use crate::runs;
use crate::view_arguments::ViewArguments;

/// The topic name of forecasts with all their fields.
const WHOLE: &str = "forecasts-whole";
/// The topics that are recorded by default.
pub const TOPICS: &str = "detections,tracks,forecasts,events";
/// Time limit for the tap to open the topics.
const ATTACH_LIMIT: Duration = Duration::from_secs(10);

/// Nice value of a flight recorder, so that the stages come first.
const NICE: i32 = 10;

/// Arguments of `stgdat record`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// File to write, which must not exist. With --last, files are numbered: drive-1.mcap, …
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Name or folder of the run; not needed if only one is running
    #[arg(long, value_name = "NAME")]
    run: Option<PathBuf>,
    /// Topics to record, separated by commas. `events` are the supervisor's events and the stages' log lines;
    /// `forecasts` leaves out the controls, `forecasts-whole` includes them; `all` is everything
    #[arg(long, value_name = "LIST", default_value = TOPICS, value_parser = topics)]
    topics: Topics,
    /// Stop after this many seconds; by default at the end of the run
    #[arg(long, value_name = "S")]
    seconds: Option<f64>,
    #[command(flatten)]
    ring: RingArguments,
    #[command(flatten)]
    view: ViewArguments,
}

/// The topics to record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Topics {
    names: Vec<String>,
    /// Forecasts with their controls.
    whole: bool,
    events: bool,
}

/// Reads a list of topics.
pub fn topics(list: &str) -> Result<Topics, String> {
    let known = || TABLE.topics.iter().map(|topic| topic.name);
    let mut topics = Topics { names: Vec::new(), whole: false, events: false };
    for name in list.split(',').map(str::trim) {
        topics.whole |= name == WHOLE;
        match if name == WHOLE { ForecastsTopic::NAME } else { name } {
            "all" => {
                topics = Topics { names: known().map(str::to_owned).collect(), whole: true, events: true };
            }
            EVENTS | LOG => topics.events = true,
            name if known().any(|topic| topic == name) => {
                if !topics.names.iter().any(|have| have == name) {
                    topics.names.push(name.to_owned());
                }
            }
            name => {
                let known = known().collect::<Vec<_>>().join(", ");
                return Err(format!("there is no topic \"{name}\": {known}, {WHOLE}, {EVENTS} or all"));
            }
        }
    }
    Ok(topics)
}

/// Records a running pipeline.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let stop = Stop::on_signals().map_err(Failure::unavailable)?;
    let limit = arguments.seconds.map(Duration::try_from_secs_f64).transpose();
    let limit = limit.map_err(|error| Failure::Usage(format!("--seconds: {error}")))?;
    let run = runs::find(arguments.run.as_deref())?;
    let Topics { mut names, whole, events } = arguments.topics.clone();
    let element_bytes = if whole { BTreeMap::new() } else { recording::lean() };
    let about =
        About::of_run(&run.root).map_err(|error| Failure::file(&run.root.join(recording::ABOUT), error))?;
    let about = About { topics: names.clone(), element_bytes, clock_offset_ns: clock_offset_ns(), ..about };
    // The file has the requested topics; the messages for other tools may need more.
    arguments.view.add_topics(&mut names);
    let keeps_events = events || arguments.ring.limits().is_some();
    let recording = keeps_events.then(|| arguments.file.display().to_string());
    let tool = "record".to_owned();
    let request = Request { tool, topics: names, events: true, mark: None, recording };
    let mut client = Client::attach(&run.root, &request).map_err(Failure::unavailable)?;
    match client.next(ATTACH_LIMIT).map_err(Failure::unavailable)? {
        Some(Item::Attached) => {}
        Some(Item::Refused(why)) => return Err(Failure::unavailable_about(&run.name, why)),
        _ => return Err(Failure::Failed(format!("the tap of {} does not answer", run.name))),
    }
    let file = &arguments.file;
    let recorded = match arguments.ring.limits() {
        None => {
            let writer = arguments.view.create(file, &about).map_err(Failure::data)?;
            say!("recording {} to {}; Ctrl-C ends it", run.name, file.display());
            let recorded = follow(&run.root, &request, client, writer, events, limit, &stop)?;
            say!("{}", summary(file, &recorded));
            recorded
        }
        Some(limits) => {
            arguments.ring.check(file)?;
            // A whole ring is packed at once, so the stages get priority.
            let _ = rustix::process::nice(NICE);
            let asked = Asked::by_usr1().map_err(Failure::unavailable)?;
            say!("{}: {}", run.name, arguments.ring.description(file));
            let recorder = FlightRecorder::new(
                file,
                about,
                limits,
                asked,
                |line| say!("{line}"),
                |file, about| arguments.view.create(file, about),
            );
            follow(&run.root, &request, client, recorder, true, limit, &stop)?
        }
    };
    let lost = recorded.lost.values().chain(recorded.written.lost.values()).sum::<u64>();
    if lost > 0 {
        say!("  {lost} frames are not in it: {}", losses(&recorded));
    }
    Ok(Exit::Done)
}

fn summary(file: &Path, Recorded { written, seconds, .. }: &Recorded) -> String {
    let megabytes = written.bytes as f64 / 1e6;
    let topics: Vec<String> = written.by_topic.iter().map(|(name, len)| format!("{len} {name}")).collect();
    let percent = 100.0 * written.bytes as f64 / (written.uncompressed_bytes as f64).max(1.0);
    format!(
        "{}: {megabytes:.1} MB in {seconds:.1} s, {:.2} MB/s, {percent:.0} % of what was sent; {}",
        file.display(),
        megabytes / seconds.max(1e-3),
        topics.join(", ")
    )
}

fn losses(recorded: &Recorded) -> String {
    let of = |losses: &recording::Losses, at: &str| {
        let each = losses.iter().map(|(topic, frames)| format!("{frames} {topic}"));
        let each: Vec<String> = each.collect();
        (!each.is_empty()).then(|| format!("{} lost {at}", each.join(", ")))
    };
    let parts = [of(&recorded.lost, "at the tap"), of(&recorded.written.lost, "by the disk")];
    parts.into_iter().flatten().collect::<Vec<_>>().join("; ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_of_topics_are_read() {
        let default = topics(TOPICS).unwrap();
        assert_eq!((default.names.join(" ").as_str(), default.events), ("detections tracks forecasts", true));
        assert!(!default.whole);
        let all = topics("all").unwrap();
        assert!(all.names.len() == TABLE.topics.len() && all.whole);
        let whole = topics("tracks,forecasts,forecasts-whole").unwrap();
        assert_eq!((whole.names.join(" ").as_str(), whole.whole), ("tracks forecasts", true));
        assert_eq!(topics("tracks, tracks").unwrap().names, ["tracks"]);
        let error = topics("tracks,traks").unwrap_err();
        assert!(error.contains("\"traks\"") && error.contains("heartbeats"), "{error}");
    }
}
