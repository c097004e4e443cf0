use std::path::PathBuf;

use clap::Args;
use run::Exit;

use crate::arguments::ReadArguments;
use crate::failure::Failure;

/// Arguments of `stgdat map`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Recordings of one site in one world frame, without those to be forecast
    #[arg(required = true, value_name = "RECORDING")]
    recordings: Vec<PathBuf>,
    #[command(flatten)]
    read: ReadArguments,
    /// Map to write, for `--map FILE`
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Builds the context map of a site: density and mean velocity of the agents per square metre.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
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
