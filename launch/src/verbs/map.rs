use std::path::{Path, PathBuf};

use clap::Args;
use lanes::{Coordinates, LaneMap, Origin};
use run::Exit;

use crate::arguments::ReadArguments;
use crate::failure::Failure;

/// Arguments of `stgdat map`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Recordings of one site in one world frame, without those to be forecast
    #[arg(required_unless_present = "lanelet2", value_name = "RECORDING")]
    recordings: Vec<PathBuf>,
    /// Lanelet2 map of the site (OSM XML) in place of recordings
    #[arg(long, value_name = "FILE", conflicts_with_all = ["recordings", "format", "fps"])]
    lanelet2: Option<PathBuf>,
    /// Latitude and longitude of the world frame's origin in that map, degrees; if not given, the tags local_x
    /// and local_y of its nodes count, else 0,0 is the origin
    #[arg(long, value_name = "LAT,LON", requires = "lanelet2", allow_hyphen_values = true)]
    origin: Option<Origin>,
    #[command(flatten)]
    read: ReadArguments,
    /// Map to write, for `--map FILE`
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Builds the context map of a site: density and mean velocity of the agents per square metre, from recordings
/// or from its lanes.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    if let Some(path) = &arguments.lanelet2 {
        return draw_lanes(path, arguments);
    }
    let open = |path: &PathBuf| arguments.read.open(path);
    let recordings = arguments.recordings.iter().map(open).collect::<Result<Vec<_>, _>>()?;
    let site = mapper::build(&recordings).map_err(Failure::data)?;
    site.map.save(&arguments.out).map_err(Failure::data)?;
    let (rows, cols) = (site.map.rows(), site.map.cols());
    let [x_m, y_m] = site.map.origin_m();
    println!(
        "{}: {cols} × {rows} m from ({x_m}, {y_m}), {} visits",
        arguments.out.display(),
        site.visits_len
    );
    if site.left_out_len > 0 {
        println!("{} detections left out: their velocity is unknown", site.left_out_len);
    }
    Ok(Exit::Done)
}

/// The map of a site's lanes.
fn draw_lanes(path: &Path, arguments: &Arguments) -> Result<Exit, Failure> {
    let coordinates = arguments.origin.map_or_else(Coordinates::default, Coordinates::About);
    let lanes = LaneMap::open(path, coordinates).map_err(Failure::data)?;
    let map = mapper::of_lanes(&lanes).map_err(Failure::data)?;
    map.save(&arguments.out).map_err(Failure::data)?;
    let ([x_m, y_m], lanes_len) = (map.origin_m(), lanes.lanes().len());
    let (rows, cols) = (map.rows(), map.cols());
    println!("{}: {cols} × {rows} m from ({x_m}, {y_m}), {lanes_len} lanes", arguments.out.display());
    Ok(Exit::Done)
}
