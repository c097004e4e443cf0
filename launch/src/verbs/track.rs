use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use clap::Args;
use config::{Exit, MapChoice, Run, Scene};
use data::formats::kitti::WorldFromCamera;
use data::{Format, TrackFormat, TrackRows, TrackWriter};
use recorder::WholeFile;
use source::{Playback, PlaybackOptions};

use crate::arguments::{ModelArguments, TrackerArguments};
use crate::failure::Failure;
use crate::tracking::Tracking;

/// Arguments of `stgdat track`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// The recording
    recording: PathBuf,
    /// The recording's format; found out where not given
    #[arg(long)]
    format: Option<Format>,
    /// Where the tracks go; `-` for standard output
    #[arg(long, value_name = "FILE", default_value = "-")]
    out: PathBuf,
    /// How the tracks are written: `csv`, `kitti` or `mot`
    ///
    /// csv: our own format of recordings, so that tracks can be played again: stamp_s, id, type, x_m, y_m, heading_rad, speed_mps,
    /// length_m, width_m, score (probability that the object exists), vx_mps, vy_mps, status (confirmed or coasting), unseen_s (since
    /// the last detection), xx_m2, xy_m2, yy_m2 (covariance of the position), prior (what moved the state: learned, held or
    /// kinematic), prior_age_s (since the forecast was made); an `ego` row per frame.
    ///
    /// kitti: frame id type truncated occluded alpha x1 y1 x2 y2 h w l x y z rot_y score, in the camera frame, of KITTI recordings alone.
    /// Unknown are truncation, occlusion and the box in the image (-1) and the height (a usual one, on the plane the car stands on).
    ///
    /// mot: frame,id,-1,-1,-1,-1,score,x,y,0 with frames from 1 and positions in the world frame, m. Types are not told.
    #[arg(long = "as", value_name = "FORMAT", default_value_t, verbatim_doc_comment)]
    written_as: TrackFormat,
    /// Seed of all that is random
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// End after so many ticks
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    ticks: Option<u64>,
    #[command(flatten)]
    tracker: TrackerArguments,
    #[command(flatten)]
    model: ModelArguments,
}

/// Runs a recording through the tracker in this process and writes what it publishes.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let (weights_path, weights) = arguments.model.open_weights(None)?;
    let path = &arguments.recording;
    let path = path.canonicalize().map_err(|error| Failure::file(path, &error))?;
    let rows = rows(arguments.written_as, &path)?;
    let scene = Scene::Recording { path, format: arguments.format.map(|format| format.name().to_owned()) };
    let recording = source::recording(&scene, arguments.seed, arguments.ticks)?;
    let options = PlaybackOptions { run_id: 0, ticks_max: arguments.ticks, lockstep: true };
    let mut playback = Playback::new(recording, options);
    let mut tracking = Tracking::new(&Run {
        interval_ns: playback.interval_ns(),
        lockstep: true,
        seed: arguments.seed,
        scene,
        ticks: arguments.ticks,
        associate: arguments.tracker.associate,
        prior: arguments.tracker.prior.unwrap_or_default(),
        weights: weights_path,
        model: weights.config().clone(),
        map: arguments.model.map.clone().unwrap_or(MapChoice::Online),
        ..Run::default()
    })?;
    let standard_output = arguments.out.as_os_str() == "-";
    let out = if standard_output { Path::new("/dev/stdout") } else { &arguments.out };
    let written = |error: std::io::Error| Failure::file(out, &error);
    let file = WholeFile::create(out).map_err(written)?;
    let mut writer = TrackWriter::new(file, rows).map_err(written)?;
    let (mut ticks, mut tracks_len) = (0_u64, 0_u64);
    while let Some(tick) = playback.next_tick() {
        let tracks = tracking.tick(&tick.header, tick.detections);
        match writer.write(&tick.header, tracks) {
            // The reader of a pipe has seen enough.
            Err(error) if error.kind() == ErrorKind::BrokenPipe => return Ok(Exit::Done),
            result => result.map_err(written)?,
        }
        ticks += 1;
        tracks_len += tracks.len() as u64;
    }
    writer.finish().and_then(WholeFile::finish).map_err(written)?;
    if !standard_output {
        println!("{ticks} ticks, {tracks_len} tracks: {}", out.display());
    }
    Ok(Exit::Done)
}

/// The format of the rows, with what it takes from beside the recording.
fn rows(format: TrackFormat, recording: &Path) -> Result<TrackRows, Failure> {
    Ok(match format {
        TrackFormat::Csv => TrackRows::Csv,
        TrackFormat::Mot => TrackRows::Mot,
        TrackFormat::Kitti => {
            let poses = WorldFromCamera::open(recording)
                .map_err(|error| Failure::Data(format!("--as kitti needs a sequence of KITTI: {error}")))?;
            TrackRows::Kitti(Box::new(poses))
        }
    })
}
