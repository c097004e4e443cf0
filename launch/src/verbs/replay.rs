use std::path::PathBuf;

use audit::{Noise, TypeNoise, noise_words};
use clap::Args;
use clap::builder::PossibleValuesParser;
use console::failure::Failure;
use console::show::show;
use nn::Weights;
use onboard::{Replay, Replayed, STAGES};
use recording::{About, Comparison, Frame, Recording, Writer};
use run::Exit;
use wire::{ForecastsTopic, StageId, Topic as _, TracksTopic};

use crate::arguments::{Speed, canonical};
use crate::differences::{table, title};
use crate::files::named_weights;
use crate::recorded::{self, open_and_check};
use crate::verbs::wire::layout;
use crate::version;

/// Maximum number of listed ticks.
const LISTED_MAX: usize = 8;

/// Numbers that differ by at most this much count as near: 0.1 mm.
const NEAR: f64 = 1e-4;

/// Arguments of `stgdat replay`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// The recording
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Replay only this stage, with its input from the file. The recording must contain the topics that the
    /// stage reads and writes
    #[arg(long, value_name = "NAME", value_parser = PossibleValuesParser::new(STAGES.map(|stage| stage.id().name())))]
    stage: Option<String>,
    /// Speed of the ticks; results do not depend on it
    #[arg(long, value_enum, default_value = "max")]
    speed: Speed,
    /// Weights to use instead of the recorded run's: a file, or the name of shipped weights such as `onboard-free`
    #[arg(long, value_name = "FILE|NAME")]
    weights: Option<PathBuf>,
    /// Write the results of the stages as a recording, for `stgdat diff`
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// Runs a recording through the stages again and compares the result with the recording.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let (recording, damages) = open_and_check(&arguments.file)?;
    let weights = weights(arguments, &recording)?;
    let stage = arguments.stage.as_deref().and_then(StageId::from_name);
    let mut text = title(&recording, &damages);
    for note in notes(&recording, &weights) {
        text += &format!("  {note}\n");
    }
    show(&text)?;
    let mut writer = writer(arguments, &recording, &weights)?;
    let replay = Replay::new(&recording, weights, stage).map_err(Failure::data)?;
    let replay = if arguments.speed == Speed::Real { replay.in_own_time() } else { replay };
    let mut noise = Noise::default();
    let replayed = replay
        .run(|frame: &Frame| {
            if let Ok(tracks) = frame.elements::<TracksTopic>() {
                let agents = tracks.iter().map(|track| (track.agent_type, track.noise()));
                noise.tick(frame.header().stamp_ns, agents);
            }
            if let Some(writer) = &mut writer {
                writer.frame(frame);
            }
        })
        .map_err(Failure::data)?;
    if let Some(mut writer) = writer {
        if let Some(error) = writer.take_error() {
            return Err(Failure::data(error));
        }
        writer.finish("the replay has ended").map_err(Failure::data)?;
    }
    show(&(summary(&replayed) + &noise_lines(&noise)))?;
    recorded::end_with(damages)?;
    let is_equal = replayed.comparison.is_equal() && replayed.comparison.ticks() > 0;
    Ok(if is_equal { Exit::Done } else { Exit::Different })
}

/// Returns the weights of the command line, or else the run's weights, which must be unchanged.
fn weights(arguments: &Arguments, recording: &Recording) -> Result<Weights, Failure> {
    let about = recording.about();
    let named = arguments.weights.as_deref().map(|path| canonical(&named_weights(path))).transpose()?;
    let path = named.as_deref().or(about.run.weights.as_deref());
    let weights = match path {
        Some(path) => Weights::open(path).map_err(|error| Failure::weights(path, error))?,
        None => Weights::onboard(),
    };
    if named.is_none() && weights.sha256() != about.weights_sha256 {
        let what = path.map_or_else(|| "the embedded weights".to_owned(), |path| path.display().to_string());
        let why = format!(
            "{}: recorded with the weights {}; {what} are now {}: name a file with --weights",
            recording.path().display(),
            about.weights_sha256,
            weights.sha256()
        );
        return Err(Failure::data(std::io::Error::other(why)));
    }
    Ok(weights)
}

/// Lists possible reasons for a replay that differs.
fn notes(recording: &Recording, weights: &Weights) -> Vec<String> {
    let about = recording.about();
    let mut notes = Vec::new();
    if weights.sha256() != about.weights_sha256 {
        notes.push(format!("replayed with other weights: {}", weights.sha256()));
    }
    let kernels = version::kernels(&about.run);
    if about.kernels != kernels {
        notes.push(format!("replayed with the kernels {kernels}"));
    }
    let options = sampler::STAGE.options(&about.run).ok();
    if let Some(memory) = options.and_then(|options| options.memory) {
        let path = memory.display();
        notes
            .push(format!("the retrieval memory {path} is not in the file: replayed with what it holds now"));
    }
    if about.before {
        notes.push("the ticks before the file are replayed first, from the run's begin".to_owned());
    }
    if !about.run.lockstep {
        notes.push(
            "recorded in real time: what came when, and what was lost, is taken from the record".to_owned(),
        );
    }
    notes
}

/// Creates the writer of the replay's recording.
fn writer(
    arguments: &Arguments,
    recording: &Recording,
    weights: &Weights,
) -> Result<Option<Writer>, Failure> {
    let Some(path) = &arguments.out else { return Ok(None) };
    let topics = STAGES.iter().flat_map(|stage| stage.writes()).map(|&topic| topic.to_owned()).collect();
    let about = About {
        topics,
        weights_sha256: weights.sha256().to_owned(),
        kernels: version::kernels(&recording.about().run),
        ..recording.about().clone()
    };
    Writer::create(path, &about, &layout()).map(Some).map_err(Failure::data)
}

/// Describes the tick from which the forecasts stay near the recorded ones. The text follows the statement
/// that they are never equal.
fn near(comparison: &Comparison, newest: Option<u64>) -> String {
    let forecasts = comparison.topics.iter().find(|(name, _)| *name == ForecastsTopic::NAME);
    let Some((_, forecasts)) = forecasts else { return String::new() };
    let far = forecasts.growth.iter().rev().find(|(_, apart)| **apart > NEAR);
    match far {
        None => format!("; no forecast is more than {NEAR} apart"),
        Some((tick, _)) if Some(*tick) == newest => format!("; the forecasts stay more than {NEAR} apart"),
        Some((tick, _)) => format!("; from tick {} on no forecast is more than {NEAR} apart", tick + 1),
    }
}

/// Describes the noise of the detections, as the replayed tracker has learned it.
fn noise_lines(noise: &Noise) -> String {
    let types: Vec<TypeNoise> = noise.types().collect();
    let words = noise_words(&types).map(|words| format!("noise: {words}\n"));
    words.into_iter().chain(noise.changes().map(|change| format!("doubt: {change}\n"))).collect()
}

/// Describes the result of the replay.
fn summary(replayed: &Replayed) -> String {
    let Replayed {
        comparison,
        ticks,
        ticks_before,
        before,
        newest,
        guessed,
        missing_before,
        tracks_are_recorded,
        without_detections,
        close_priors,
        not_resumed,
        impossible,
        own_time,
    } = replayed;
    let mut text = table(comparison, ["recorded", "replayed"]);
    if let Some(first) = missing_before {
        text += &format!(
            "the recording begins with tick {first}: the stages had seen others before, which the replay has not\n"
        );
    }
    if *ticks_before > 0 {
        text += &format!(
            "the {ticks_before} ticks before the file were replayed first, of what the stages were given then"
        );
        text += &match before.first() {
            None if before.is_equal() => "\n".to_owned(),
            None => "; not all of them had the frames that they have now\n".to_owned(),
            Some(first) => {
                format!("; they differ from tick {} on: {} {}\n", first.tick, first.topic, first.field)
            }
        };
    }
    if *tracks_are_recorded {
        text += "the tracks are taken from the record: what the tracker remembered is not in the file\n";
    }
    if *guessed > 0 {
        text += &format!(
            "of {guessed} ticks the record does not say which stages had them: --topics all records it\n"
        );
    }
    for (what, ticks) in [
        ("replayed without their detections, which are not in the file", without_detections),
        ("whose prior came in at the very time", close_priors),
        ("at which a new sampler went on with what is not in the file", not_resumed),
    ] {
        if !ticks.is_empty() {
            let listed: Vec<String> = ticks.iter().take(LISTED_MAX).map(ToString::to_string).collect();
            let more = if ticks.len() > LISTED_MAX { ", …" } else { "" };
            text += &format!("{} ticks {what}: {}{more}\n", ticks.len(), listed.join(", "));
        }
    }
    if let Some(error) = impossible {
        text += &format!("frames that no stage can have taken are left out, the first: {error}\n");
    }
    if let Some(took) = own_time {
        let [p50_ms, p99_ms, most_ms] = [0.5, 0.99, 1.0].map(|share| took.computed_ms(share));
        text += &format!(
            "in its own time: a tick was computed in {p50_ms:.1} ms in the median, {p99_ms:.1} ms at the 99th percentile, \
             {most_ms:.1} ms at most; {} began late\n",
            took.late_ticks
        );
    }
    let last = comparison.topics.iter().filter_map(|(_, topic)| topic.last).max();
    let alone: u64 = comparison.topics.iter().map(|(_, topic)| topic.only_a + topic.only_b).sum();
    text += &match last {
        _ if comparison.ticks() == 0 => {
            "nothing to compare: no output of a replayed stage was recorded\n".to_owned()
        }
        None if alone == 0 => format!("equal to the byte: {ticks} ticks\n"),
        None => format!("equal where both have a frame; {alone} frames are on one side alone\n"),
        last if last == *newest => format!("the last tick differs still{}\n", near(comparison, *newest)),
        Some(last) => format!("the replay agrees from tick {} on\n", last + 1),
    };
    text
}
