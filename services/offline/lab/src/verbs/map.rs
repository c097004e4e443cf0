use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::Args;
use data::{Format, FrameRate};
use lanes::Coordinates;
use run::Exit;

use console::failure::Failure;
use console::say;
use launch::arguments::{ReadArguments, open_lanes};

/// Arguments of `stgdat map`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Recordings of one site in one world frame, without the recordings to be forecast
    #[arg(required_unless_present = "lanelet2", value_name = "RECORDING")]
    recordings: Vec<PathBuf>,
    /// Lanelet2 map of the site (OSM XML), instead of recordings
    #[arg(long, value_name = "FILE", conflicts_with_all = ["recordings", "format", "fps"])]
    lanelet2: Option<PathBuf>,
    /// World frame's origin in the own frame of recordings or map, in metres, such as 458000,5428000m; in a map also
    /// its latitude and longitude, such as 49.01,8.42
    #[arg(long, value_name = "X,Ym|LAT,LON", allow_hyphen_values = true)]
    origin: Option<String>,
    /// Format of the recordings; detected for each file if not given
    #[arg(long)]
    format: Option<Format>,
    /// Frame rate of the recordings, Hz, if the files contain frame numbers but no times; by default the
    /// published rate of the data set
    #[arg(long, value_name = "HZ")]
    fps: Option<FrameRate>,
    /// Map to write, for `--map FILE`
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

impl Arguments {
    /// The origin in the notation of recordings or of maps.
    fn origin<T: FromStr<Err: Display>>(&self) -> Result<Option<T>, Failure> {
        let parse =
            |text: &String| text.parse().map_err(|error| Failure::Usage(format!("--origin: {error}")));
        self.origin.as_ref().map(parse).transpose()
    }
}

/// Builds the context map of a site from recordings or from its lanes: density and mean velocity per m².
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    if let Some(path) = &arguments.lanelet2 {
        return draw_lanes(path, arguments);
    }
    let (format, fps, origin) = (arguments.format, arguments.fps, arguments.origin()?);
    let read = ReadArguments { format, fps, origin, topic: Vec::new() };
    let open = |path: &PathBuf| read.open(path);
    let recordings = arguments.recordings.iter().map(open).collect::<Result<Vec<_>, _>>()?;
    let site = mapper::build(&recordings).map_err(Failure::data)?;
    site.map.save(&arguments.out).map_err(Failure::data)?;
    let (rows, cols) = (site.map.rows(), site.map.cols());
    let [x_m, y_m] = site.map.origin_m();
    say!("{}: {cols} × {rows} m from ({x_m}, {y_m}), {} visits", arguments.out.display(), site.visit_count);
    if site.left_out_len > 0 {
        say!("{} detections left out: their velocity is unknown", site.left_out_len);
    }
    Ok(Exit::Done)
}

/// Builds the map from a site's lanes.
fn draw_lanes(path: &Path, arguments: &Arguments) -> Result<Exit, Failure> {
    let lanes = open_lanes(path, arguments.origin::<Coordinates>()?.unwrap_or_default())?;
    let map = mapper::of_lanes(&lanes).map_err(Failure::data)?;
    map.save(&arguments.out).map_err(Failure::data)?;
    let ([x_m, y_m], lane_count) = (map.origin_m(), lanes.lanes().len());
    let (rows, cols) = (map.rows(), map.cols());
    say!("{}: {cols} × {rows} m from ({x_m}, {y_m}), {lane_count} lanes", arguments.out.display());
    Ok(Exit::Done)
}
