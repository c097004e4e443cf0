use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use config::Exit;
use data::Format;
use data::sets::Part;
use evaluator::{InteractionPart, MapChoice, Options, Report, TrackingReport, WeightsChoice};

use crate::failure::Failure;
use crate::readme;
use crate::show::show;

/// Deviations of measured positions that make sense, m.
const SIGMAS_M: std::ops::RangeInclusive<f64> = 0.001..=10.0;

/// Arguments of `stgdat evaluate`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// `eth-ucy`, `sdd`, `interaction`, `tracking`, or recordings
    #[arg(required = true, value_name = "SET|FILE")]
    targets: Vec<PathBuf>,
    /// Folder with the data sets, laid out as published
    #[arg(long, value_name = "DIR", env = "STGDAT_DATA", default_value = "data")]
    data: PathBuf,
    /// Forecast the validation part instead of the test part: what options are chosen by
    #[arg(long)]
    validation: bool,
    /// The weights for everything
    #[arg(long, value_name = "FILE")]
    weights: Option<PathBuf>,
    /// Folder with the weights of each recipe, where no weights are named; recordings take the embedded ones
    #[arg(long, value_name = "DIR", default_value = "shared/weights", conflicts_with = "weights")]
    weights_dir: PathBuf,
    /// What models that read a map are told; `site` is `none` at a site that training left out, `online` in data sets
    /// that know no sites
    #[arg(long, value_enum, default_value_t = Map::Site)]
    map: Map,
    /// Parts of INTERACTION: `seen`, or a site that the weights know nothing of
    #[arg(long, value_name = "PART,…", value_delimiter = ',', default_values_t = ["seen", "FT", "EP1"].map(str::to_owned))]
    parts: Vec<String>,
    /// Deviations of the measured positions in `tracking`, m; those of the protocol where none are given
    #[arg(long, value_name = "M,…", value_delimiter = ',')]
    sigmas: Vec<f64>,
    /// Format of the recordings; found out where not given
    #[arg(long)]
    format: Option<Format>,
    /// Take velocities and headings of the recordings from their positions alone
    #[arg(long)]
    positions: bool,
    /// Threads; figures do not depend on it
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..))]
    threads: Option<u8>,
    /// Write every figure, a line each
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Write every figure as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Write the main tables between the marks `stgdat evaluate SET` of a Markdown file
    #[arg(long, value_name = "FILE")]
    readme: Option<PathBuf>,
}

/// What models that read a map are told.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum Map {
    None,
    Online,
    Site,
}

/// Measures forecasts, or filters that take them as their prior, against what really came, under the protocol of a data set or
/// on any recordings.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let name = match &arguments.targets[..] {
        [target] => target.to_str().unwrap_or_default(),
        _ => "",
    };
    let written = match name {
        "tracking" => Written::of_tracking(&track(arguments)?),
        _ => Written::of_forecasts(&evaluate(name, arguments)?),
    };
    if let Some(path) = &arguments.csv {
        write(path, &written.csv)?;
    }
    if let Some(path) = &arguments.json {
        write(path, &(serde_json::to_string_pretty(&written.json).map_err(Failure::data)? + "\n"))?;
    }
    let exit = show(&written.markdown)?;
    if let Some(path) = &arguments.readme {
        readme::insert(path, &format!("evaluate {name}"), &written.summary)?;
    }
    Ok(exit)
}

/// A report in all its forms.
struct Written {
    markdown: String,
    summary: String,
    csv: String,
    json: serde_json::Value,
}

impl Written {
    fn of_forecasts(report: &Report) -> Self {
        Self {
            markdown: report.markdown(),
            summary: report.summary(),
            csv: report.csv(),
            json: report.json(),
        }
    }

    fn of_tracking(report: &TrackingReport) -> Self {
        Self {
            markdown: report.markdown(),
            summary: report.summary(),
            csv: report.csv(),
            json: report.json(),
        }
    }
}

fn options(arguments: &Arguments) -> Options {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    Options {
        data: arguments.data.clone(),
        part: if arguments.validation { Part::Validation } else { Part::Test },
        weights: WeightsChoice { file: arguments.weights.clone(), folder: arguments.weights_dir.clone() },
        map: match arguments.map {
            Map::None => MapChoice::None,
            Map::Online => MapChoice::Online,
            Map::Site => MapChoice::Site,
        },
        threads: arguments.threads.map_or(threads, usize::from),
    }
}

fn track(arguments: &Arguments) -> Result<TrackingReport, Failure> {
    if let Some(sigma_m) = arguments.sigmas.iter().find(|sigma_m| !(SIGMAS_M.contains(sigma_m))) {
        return Err(Failure::Usage(format!(
            "--sigmas {sigma_m}: expected deviations from {} to {} m",
            SIGMAS_M.start(),
            SIGMAS_M.end()
        )));
    }
    evaluator::tracking(&options(arguments), &arguments.sigmas, progress).map_err(Failure::data)
}

fn progress(step: &str) {
    eprintln!("{step} …");
}

fn evaluate(name: &str, arguments: &Arguments) -> Result<Report, Failure> {
    let options = options(arguments);
    let report = match name {
        "eth-ucy" => evaluator::eth_ucy(&options, progress),
        "sdd" => evaluator::sdd(&options, progress),
        "interaction" => evaluator::interaction(&options, &parts(&arguments.parts), progress),
        _ => {
            let (targets, format) = (&arguments.targets, arguments.format);
            evaluator::files(&options, targets, format, arguments.positions, progress)
        }
    };
    report.map_err(Failure::data)
}

fn parts(names: &[String]) -> Vec<InteractionPart> {
    let part = |name: &String| match name.as_str() {
        "seen" => InteractionPart::Seen,
        site => InteractionPart::Unseen(site.to_owned()),
    };
    names.iter().map(part).collect()
}

fn write(path: &Path, text: &str) -> Result<(), Failure> {
    std::fs::write(path, text).map_err(|error| Failure::file(path, &error))
}
