use std::path::{Path, PathBuf};

use clap::Args;
use console::failure::Failure;
use console::say;
use console::show::is_read;
use data::formats::kitti::WorldFromCamera;
use data::{TrackFormat, TrackRows, TrackWriter};
use recorder::{WholeFile, is_standard_output};
use run::Exit;
use source::Playback;
use wire::WorldOrigin;

use crate::arguments::{PlaybackArguments, Played};
use crate::play_report::{PlayReport, VerdictArguments};
use crate::tracking::Tracking;

/// Arguments of `stgdat track`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Output file; `-` is standard output
    #[arg(long, value_name = "FILE", default_value = "-")]
    out: PathBuf,
    /// Format of the tracks: `csv`, `kitti` or `mot`
    ///
    /// csv: stgdat's own recording format, so that tracks can be played again: stamp_s, id, type, x_m, y_m,
    /// heading_rad, speed_mps, length_m, width_m, score (existence probability), vx_mps, vy_mps, status
    /// (confirmed or coasting), unseen_s (coast time), xx_m2, xy_m2, yy_m2 (covariance of the position),
    /// prior (learned, held or kinematic), prior_age_s (age of the forecast that is the prior); a row of type
    /// `ego` per frame, or `above` for a view from above without occlusion.
    ///
    /// kitti: frame id type truncated occluded alpha x1 y1 x2 y2 h w l x y z rot_y score, in the camera
    /// frame; KITTI recordings only. Truncation, occlusion and the box in the image are unknown (-1); the
    /// height is a usual one, on the ground plane of the car.
    ///
    /// mot: frame,id,-1,-1,-1,-1,score,x,y,0 with frames from 1 and positions in the world frame, m; without
    /// types.
    #[arg(long = "as", value_name = "FORMAT", default_value_t, verbatim_doc_comment)]
    written_as: TrackFormat,
    #[command(flatten)]
    playback: PlaybackArguments,
    #[command(flatten)]
    verdict: VerdictArguments,
}

/// Runs a recording through the tracker in this process and writes the published tracks.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let rows = rows(arguments.written_as, arguments.playback.path()?.as_deref())?;
    arguments.verdict.check()?;
    let Played { mut playback, input, run, model } = arguments.playback.start()?;
    let mut tracking = Tracking::new(&run, &model)?;
    let mut report = PlayReport::new(&playback, input);
    let played = play(&arguments.out, rows, run.origin(), &mut playback, &mut tracking, &mut report);
    let kept = tracking.end(&run);
    let is_whole = played?;
    kept?;
    // A verdict needs the whole recording.
    match is_whole {
        true => report.finish(&playback, arguments.verdict.report.as_deref(), arguments.verdict.strict),
        false => Ok(Exit::Done),
    }
}

/// Writes the tracks of all ticks.
fn play(
    out: &Path,
    rows: TrackRows,
    origin: WorldOrigin,
    playback: &mut Playback,
    tracking: &mut Tracking,
    report: &mut PlayReport,
) -> Result<bool, Failure> {
    let written = |error: std::io::Error| Failure::output(out, error);
    let file = WholeFile::create(out).map_err(written)?;
    let mut writer = TrackWriter::new(file, rows, origin).map_err(written)?;
    let (mut ticks, mut track_count) = (0_u64, 0_u64);
    while let Some(tick) = playback.next_tick() {
        let (header, tracks) = tracking.tick(&tick.header, tick.detections);
        if !is_read(writer.write(&tick.header, tracks)).map_err(written)? {
            return Ok(false);
        }
        report.tick(&header, tracks.iter().map(|track| (track.agent_type, track.noise())));
        ticks += 1;
        track_count += tracks.len() as u64;
    }
    let is_read = is_read(writer.finish().and_then(WholeFile::finish)).map_err(written)?;
    if is_read && !is_standard_output(out) {
        say!("{ticks} ticks, {track_count} tracks: {}", out.display());
    }
    Ok(is_read)
}

/// Returns the row format, with the calibration file beside the recording if the format needs one.
fn rows(format: TrackFormat, recording: Option<&Path>) -> Result<TrackRows, Failure> {
    Ok(match format {
        TrackFormat::Csv => TrackRows::Csv,
        TrackFormat::Mot => TrackRows::Mot,
        TrackFormat::Kitti => {
            let recording =
                recording.ok_or_else(|| Failure::Usage("--as kitti needs a sequence of KITTI".to_owned()))?;
            let poses = WorldFromCamera::open(recording)
                .map_err(|error| Failure::data_about("--as kitti needs a sequence of KITTI", error))?;
            TrackRows::Kitti(Box::new(poses))
        }
    })
}
