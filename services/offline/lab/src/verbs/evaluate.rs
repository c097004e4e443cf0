mod noise;

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::{Args, ValueEnum};
use configuration::options::{Setting, StageOptions};
use console::failure::Failure;
use console::show::show;
use console::tables;
use data::sets::Part;
use evaluator::bag::against_bag;
use evaluator::{
    Evaluation, ForecastLines, InteractionPart, MapChoice, Options, Page, Report, State, StateError,
    WeightsChoice, driving, tracking,
};
use nn::Precision;
use run::Exit;
use wire::StageId;

use self::noise::NoiseArguments;
use crate::contenders::contenders;
use launch::arguments::ReadArguments;
use launch::files::named_weights;

/// The names of data sets and protocols.
const SETS: [&str; 6] = ["eth-ucy", "sdd", "interaction", "driving", "tracking", "noise"];
/// All other targets.
const RECORDINGS: &str = "recordings";
/// Sensible standard deviations of measured positions, m.
const SIGMAS_M: std::ops::RangeInclusive<f64> = 0.001..=10.0;
/// Parts of `interaction` that run by default.
const INTERACTION_PARTS: [&str; 3] = ["seen", "FT", "EP1"];
/// All parts of `tracking`, which run by default.
const TRACKING_PARTS: [&str; 3] = ["interaction", "kitti", "driving"];
/// Parts of `noise` that run by default.
const NOISE_PARTS: [&str; 5] = [SYNTHETIC, NETWORK, NOISE_SOURCES[0], NOISE_SOURCES[1], NOISE_SOURCES[2]];
/// The part of `noise` with generated agents.
const SYNTHETIC: &str = "synthetic";
/// The part of `noise` that compares the network with the published forecasts.
const NETWORK: &str = "network";
/// Sources of `driving` that `noise` plays by default.
const NOISE_SOURCES: [&str; 3] = ["womd", "av2_sensor", "nuscenes_mini"];
/// Recordings of each source that `noise` plays by default.
const NOISE_SCENES: u16 = 8;

/// Options that states already have.
const MERGED_BEFORE: [&str; 12] = [
    "validation",
    "weights",
    "beside",
    "map",
    "against_bag",
    "forecasts",
    "format",
    "fps",
    "origin",
    "positions",
    "threads",
    "set",
];

/// Arguments of `stgdat evaluate`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Data set `eth-ucy`, `sdd`, `interaction`, `driving` or `tracking`, or `noise`, or recordings, or states
    /// to merge
    #[arg(required = true, value_name = "SET|FILE")]
    targets: Vec<PathBuf>,
    /// Folder with the data sets in their published layout
    #[arg(long, value_name = "DIR", env = "STGDAT_DATA", default_value = "data")]
    data: PathBuf,
    /// Evaluate the validation part, which is for choosing options, instead of the test part
    #[arg(long)]
    validation: bool,
    /// Weights for all recipes: a file, or the name of shipped weights such as `onboard-free`
    #[arg(long, value_name = "FILE|NAME")]
    weights: Option<PathBuf>,
    /// Folder with the weights of each recipe; recordings use the embedded weights
    #[arg(long, value_name = "DIR", default_value = "shared/weights", conflicts_with = "weights")]
    weights_dir: PathBuf,
    /// Folders with other trainings of the same recipes, such as other seeds. Their errors are reported
    /// beside the first
    #[arg(long, value_name = "DIR,…", value_delimiter = ',', conflicts_with = "weights")]
    beside: Vec<PathBuf>,
    /// Map for models that read one; `site` means `none` at held-out sites, the map of their lanes with
    /// --lanes, and `online` in data sets without sites
    #[arg(long, value_enum, default_value_t = Map::Site)]
    map: Map,
    /// Forecast vehicles along the lanes of Lanelet2 maps: of each site of `interaction`, in DIR/interaction/maps,
    /// and of each recording of `driving` that has one, DIR/driving_maps/SOURCE/RECORDING.osm
    #[arg(long)]
    lanes: bool,
    /// Parts of `interaction`: `seen` or a held-out site [default: seen,FT,EP1]; of `tracking`: `interaction`
    /// (filters on noisy positions), `kitti` (trackers on a detector's output) and `driving` (gaps on many
    /// roads) [default: all]; of
    /// `driving`: sources [default: all]; of `noise`: `synthetic` (generated agents), `network` (the
    /// network's forecasts beside the published ones) and sources of `driving`
    /// [default: synthetic,network,womd,av2_sensor,nuscenes_mini]
    #[arg(long, value_name = "PART,…", value_delimiter = ',')]
    parts: Vec<String>,
    /// Standard deviations of the measured positions in `tracking`, m; by default the protocol's values
    #[arg(long, value_name = "M,…", value_delimiter = ',', allow_negative_numbers = true)]
    sigmas: Vec<f64>,
    /// Also evaluate the learned prior of `tracking` with Monte Carlo propagation, which takes several times
    /// as long
    #[arg(long)]
    particles: bool,
    #[command(flatten)]
    noise: NoiseArguments,
    /// Maximum number of recordings of each source in `noise`, spread evenly [default: 8]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    scenes: Option<u16>,
    /// Evaluate the network's forecasts in `driving` without evidence from earlier forecasts
    #[arg(long)]
    without_evidence: bool,
    /// Write the evidence of `driving` about the experts on each source, without a prior, as a prior for
    /// other roads
    #[arg(long, value_name = "FILE")]
    prior: Option<PathBuf>,
    /// Write how often the conflicts that forecasts of `driving` foretell happen, as odds for the sampler
    #[arg(long, value_name = "FILE")]
    odds: Option<PathBuf>,
    /// Compare the forecasts with the `PredictedObjects` of this bag: same agents, times, horizon and truth.
    /// The target is one recording, which is played as `predict` plays it; it may be the same bag
    #[arg(long, value_name = "BAG", conflicts_with_all = ["positions", "all", "validation", "beside"])]
    against_bag: Option<PathBuf>,
    #[command(flatten)]
    read: ReadArguments,
    /// Derive velocities and headings of the recordings from their positions. In `driving`, `interaction` and
    /// `eth-ucy`: detections have neither headings nor speeds
    #[arg(long)]
    positions: bool,
    /// Number of threads; figures do not depend on it
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..))]
    threads: Option<u8>,
    /// Set the precision of the decoder: decoder.precision=bf16. No other option can be set here
    #[arg(long, value_name = "STAGE.OPTION=VALUE")]
    set: Vec<Setting>,
    /// Print all tables of recordings, not only the published forecasts
    #[arg(long)]
    all: bool,
    /// Write the sums behind the tables of recordings. `--merge` combines such files
    #[arg(long, value_name = "FILE", conflicts_with = "against_bag")]
    state: Option<PathBuf>,
    /// Merge states that --state wrote, and print their tables: any split and order of the recordings gives
    /// the same figures
    #[arg(long, conflicts_with_all = MERGED_BEFORE)]
    merge: bool,
    /// Write every forecast or track behind the tables with its truth, as JSON lines
    #[arg(long, value_name = "FILE", conflicts_with = "against_bag")]
    forecasts: Option<PathBuf>,
    /// Write all figures as CSV, one per line
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Write all figures as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Markdown file whose marks `stgdat evaluate SET` get the main tables
    #[arg(long, value_name = "FILE")]
    table: Option<PathBuf>,
}

/// Map for models that read one.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum Map {
    None,
    Online,
    Site,
}

/// Measures forecasts, or filters with forecasts as their prior, against the recorded future, under the
/// protocol of a data set or on any recordings.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let name = match &arguments.targets[..] {
        [target] => target.to_str().unwrap_or_default(),
        _ => "",
    };
    refuse_unused(name, arguments)?;
    let lines = arguments.forecasts.as_deref().map(forecast_lines).transpose()?;
    let options = Options { lines: lines.clone(), ..options(name, arguments)? };
    let lanes = if arguments.lanes { " --lanes" } else { "" };
    let pages = match name {
        _ if arguments.against_bag.is_some() => vec![against(arguments, &options)?],
        "tracking" => track(arguments, &options)?,
        "driving" => vec![drive(arguments, options)?],
        "noise" => under_noise(arguments, options)?,
        "eth-ucy" | "sdd" | "interaction" => {
            let mut report = evaluate(name, arguments, &options)?;
            let beside = arguments.beside.iter().map(|folder| {
                let weights = WeightsChoice { folder: folder.clone(), ..options.weights.clone() };
                evaluate(name, arguments, &Options { weights, lines: None, ..options.clone() })
            });
            report.add_beside(&beside.collect::<Result<Vec<_>, _>>()?);
            vec![logged(&report, &format!("{name}{lanes}{}", options.noise.arguments()))]
        }
        _ => vec![logged(&recordings(arguments, &options)?.report(), name)],
    };
    if let (Some(path), Some(lines)) = (&arguments.forecasts, &lines) {
        lines.finish().map_err(|error| Failure::file(path, error))?;
    }
    if let Some(path) = &arguments.csv {
        let titles = pages.first().and_then(|page| page.csv.lines().next());
        let figures = pages.iter().flat_map(|page| page.csv.lines().skip(1));
        write(path, &titles.into_iter().chain(figures).flat_map(|line| [line, "\n"]).collect::<String>())?;
    }
    if let Some(path) = &arguments.json {
        write(path, &(serde_json::to_string_pretty(&json(&pages)).map_err(Failure::data)? + "\n"))?;
    }
    let shown = |page: &Page| {
        let text = page.text.as_ref().filter(|_| !arguments.all);
        text.unwrap_or(&page.markdown).clone()
    };
    let markdown: Vec<String> = pages.iter().map(shown).collect();
    let exit = show(&markdown.join("\n"))?;
    if let Some(path) = &arguments.table {
        for page in &pages {
            tables::replace(path, &page.mark, &page.summary)?;
        }
    }
    Ok(exit)
}

/// The report of windows, after its doubts are logged.
fn logged(report: &Report, set: &str) -> Page {
    report.warnings.iter().for_each(|line| tracing::warn!("{line}"));
    report.left_out.iter().for_each(|line| tracing::warn!("left out: {line}"));
    report.failed.iter().for_each(|line| tracing::warn!("failed: {line}"));
    report.page(set)
}

/// A single report unchanged, several reports by name.
fn json(pages: &[Page]) -> serde_json::Value {
    match pages {
        [one] => one.json.clone(),
        several => several.iter().map(|page| (page.name.to_owned(), page.json.clone())).collect(),
    }
}

/// Refuses options that have no effect.
fn refuse_unused(name: &str, arguments: &Arguments) -> Result<(), Failure> {
    let target = if SETS.contains(&name) { name } else { RECORDINGS };
    let sensor = arguments.noise.given().map(|option| (option, true, &noise::SETS[..]));
    let read = &arguments.read;
    let options: [(&str, bool, &[&str]); 19] = [
        ("--beside", !arguments.beside.is_empty(), &["eth-ucy", "sdd", "interaction"]),
        ("--parts", !arguments.parts.is_empty(), &["interaction", "driving", "tracking", "noise"]),
        ("--scenes", arguments.scenes.is_some(), &["noise"]),
        ("--lanes", arguments.lanes, &["interaction", "driving"]),
        ("--without-evidence", arguments.without_evidence, &["driving", "noise"]),
        ("--prior", arguments.prior.is_some(), &["driving"]),
        ("--odds", arguments.odds.is_some(), &["driving"]),
        ("--sigmas", !arguments.sigmas.is_empty(), &["tracking"]),
        ("--particles", arguments.particles, &["tracking"]),
        ("--against-bag", arguments.against_bag.is_some(), &[RECORDINGS]),
        ("--format", read.format.is_some(), &[RECORDINGS]),
        ("--fps", read.fps.is_some(), &[RECORDINGS]),
        ("--all", arguments.all, &[RECORDINGS]),
        ("--origin", read.origin.is_some(), &[RECORDINGS]),
        ("--positions", arguments.positions, &[RECORDINGS, "driving", "interaction", "eth-ucy"]),
        ("--state", arguments.state.is_some(), &[RECORDINGS]),
        ("--merge", arguments.merge, &[RECORDINGS]),
        (
            "--forecasts",
            arguments.forecasts.is_some(),
            &[RECORDINGS, "driving", "interaction", "eth-ucy", "sdd", "tracking"],
        ),
        (
            "--set",
            !arguments.set.is_empty(),
            &[RECORDINGS, "driving", "interaction", "eth-ucy", "sdd", "noise"],
        ),
    ];
    match sensor.chain(options).find(|(_, is_given, users)| *is_given && !users.contains(&target)) {
        Some((option, _, users)) => Err(Failure::Usage(format!(
            "{option} is for {}, and would change nothing here",
            users.join(", ")
        ))),
        None => Ok(()),
    }
}

/// The precision of the decoder, the only option of a stage that evaluations accept.
fn precision(arguments: &Arguments) -> Result<Precision, Failure> {
    let others = |set: &&Setting| !set.is_of(StageId::Decoder, "precision");
    if let Some(set) = arguments.set.iter().find(others) {
        return Err(set.refused("evaluations set decoder.precision alone"));
    }
    let mut options = StageOptions::defaults(&[StageId::Decoder]);
    options.apply(&arguments.set)?;
    Ok(options.read(&decoder::STAGE)?.precision)
}

fn options(name: &str, arguments: &Arguments) -> Result<Options, Failure> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    Ok(Options {
        data: arguments.data.clone(),
        part: if arguments.validation { Part::Validation } else { Part::Test },
        weights: WeightsChoice {
            file: arguments.weights.as_deref().map(named_weights),
            folder: arguments.weights_dir.clone(),
            precision: precision(arguments)?,
        },
        map: match arguments.map {
            Map::None => MapChoice::None,
            Map::Online => MapChoice::Online,
            Map::Site => MapChoice::Site,
        },
        lanes: arguments.lanes,
        noise: arguments.noise.sensor(arguments.positions && noise::SETS.contains(&name))?,
        threads: arguments.threads.map_or(threads, usize::from),
        evidence: !arguments.without_evidence,
        priors: arguments.prior.is_none(),
        ..Options::default()
    })
}

/// The file of `--forecasts`.
fn forecast_lines(path: &Path) -> Result<Arc<ForecastLines>, Failure> {
    let file = File::create(path).map_err(|error| Failure::file(path, error))?;
    Ok(Arc::new(ForecastLines::to(BufWriter::new(file))))
}

/// Forecasts as a car gets them, on many roads.
fn drive(arguments: &Arguments, options: Options) -> Result<Page, Failure> {
    let options = Options { sources: arguments.parts.clone(), ..options };
    let report = driving::evaluate(&options, progress).map_err(Failure::data)?;
    if let Some(path) = &arguments.prior {
        write(path, &(report.priors(options.threads).to_json() + "\n"))?;
    }
    if let Some(path) = &arguments.odds {
        write(path, &(serde_json::to_string_pretty(&report.odds()).map_err(Failure::data)? + "\n"))?;
    }
    Ok(report.page())
}

/// Forecasts under many kinds of noise, of generated agents and of recorded vehicles.
fn under_noise(arguments: &Arguments, options: Options) -> Result<Vec<Page>, Failure> {
    let (own, sources): (Vec<&str>, Vec<&str>) =
        parts(arguments, &NOISE_PARTS).partition(|part| [SYNTHETIC, NETWORK].contains(part));
    let has_recorded = !sources.is_empty();
    let sources = if has_recorded { sources } else { NOISE_SOURCES.to_vec() };
    let options = Options { sources: sources.into_iter().map(str::to_owned).collect(), ..options };
    let scenes = usize::from(arguments.scenes.unwrap_or(NOISE_SCENES));
    let mut pages = Vec::new();
    if own.contains(&SYNTHETIC) {
        progress("generated agents");
        pages.push(driving::synthetic(&options).map_err(Failure::data)?);
    }
    if own.contains(&NETWORK) {
        pages.push(driving::network_under_noise(&options, scenes, progress).map_err(Failure::data)?);
    }
    if has_recorded {
        pages.push(driving::under_noise(&options, scenes, progress).map_err(Failure::data)?);
    }
    Ok(pages)
}

/// Our forecasts of a recording beside the forecasts of a bag.
fn against(arguments: &Arguments, options: &Options) -> Result<Page, Failure> {
    let (Some(bag), [target]) = (&arguments.against_bag, &arguments.targets[..]) else {
        return Err(Failure::Usage("--against-bag is for one recording".to_owned()));
    };
    let frames = data::predicted_objects(bag, arguments.read.options().origin).map_err(Failure::data)?;
    against_bag(arguments.read.open(target)?, frames, options).map_err(Failure::data)
}

/// The parts of `tracking`, whose figures share one table.
fn track(arguments: &Arguments, options: &Options) -> Result<Vec<Page>, Failure> {
    if let Some(sigma_m) = arguments.sigmas.iter().find(|sigma_m| !(SIGMAS_M.contains(sigma_m))) {
        return Err(Failure::Usage(format!(
            "--sigmas {sigma_m}: expected deviations from {} to {} m",
            SIGMAS_M.start(),
            SIGMAS_M.end()
        )));
    }
    let known = |part: &str| TRACKING_PARTS.contains(&part);
    if let Some(other) = arguments.parts.iter().find(|part| !known(part)) {
        return Err(Failure::Usage(format!(
            "--parts {other}: `tracking` has interaction, kitti and driving"
        )));
    }
    let page = |part: &str| match part {
        "kitti" => {
            let weights = options.weights.load()?;
            let contenders = contenders(options.weights.file.as_ref(), weights.config());
            tracking::kitti(options, contenders, progress)
        }
        "driving" => driving::through_gaps(options, progress),
        _ => tracking::interaction(options, &arguments.sigmas, arguments.particles, progress),
    };
    let pages = parts(arguments, &TRACKING_PARTS).map(|part| page(part).map_err(Failure::data));
    pages.collect()
}

fn progress(step: &str) {
    tracing::info!("{step} …");
}

fn evaluate(name: &str, arguments: &Arguments, options: &Options) -> Result<Report, Failure> {
    let report = match name {
        "eth-ucy" => evaluator::eth_ucy(options, progress),
        "sdd" => evaluator::sdd(options, progress),
        _ => {
            let parts = parts(arguments, &INTERACTION_PARTS).map(|part| interaction_part(part, arguments));
            let parts: Vec<_> = parts.collect::<Result<_, _>>()?;
            evaluator::interaction(options, &parts, progress)
        }
    };
    report.map_err(Failure::data)
}

/// The state of recordings, or of the states that hold them.
fn recordings(arguments: &Arguments, options: &Options) -> Result<State, Failure> {
    let state = if arguments.merge {
        State::merged(arguments.targets.iter().map(|path| state(path))).map_err(Failure::data)?
    } else {
        let evaluation = Evaluation::new(options, arguments.positions).map_err(Failure::data)?;
        let state = evaluation.recordings(&arguments.targets, &arguments.read.options(), progress);
        state.map_err(Failure::data)?
    };
    if let Some(path) = &arguments.state {
        std::fs::write(path, state.to_bytes()).map_err(|error| Failure::file(path, error))?;
    }
    Ok(state)
}

/// Reads a state, with its path as its name.
fn state(path: &Path) -> Result<(String, State), StateError> {
    let name = path.display().to_string();
    let bytes = std::fs::read(path).map_err(|source| StateError::File { name: name.clone(), source })?;
    Ok((name.clone(), State::from_bytes(&name, &bytes)?))
}

/// The parts that the arguments name, or all of them.
fn parts<'a>(arguments: &'a Arguments, all: &'a [&str]) -> impl Iterator<Item = &'a str> {
    let all = all.iter().copied().filter(|_| arguments.parts.is_empty());
    arguments.parts.iter().map(String::as_str).chain(all)
}

/// The part with this name. Other sites need `--weights`, because no recipe leaves them out.
fn interaction_part(name: &str, arguments: &Arguments) -> Result<InteractionPart, Failure> {
    match name {
        "seen" => Ok(InteractionPart::Seen),
        site if arguments.weights.is_some() || INTERACTION_PARTS.contains(&site) => {
            Ok(InteractionPart::HeldOut(site.to_owned()))
        }
        other => Err(Failure::Usage(format!(
            "--parts {other}: `interaction` has seen, FT and EP1, and other sites with --weights"
        ))),
    }
}

fn write(path: &Path, text: &str) -> Result<(), Failure> {
    std::fs::write(path, text).map_err(|error| Failure::file(path, error))
}
