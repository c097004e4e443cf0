use std::path::{Path, PathBuf};

use clap::Args;
use onboard::Chain;
use recorder::{ForecastWriter, is_standard_output};
use run::Exit;
use source::Playback;
use wire::WorldOrigin;

use crate::arguments::{PlaybackArguments, Played};
use crate::failure::Failure;
use crate::play_report::{PlayReport, VerdictArguments};
use crate::show::is_read;

/// Arguments of `stgdat predict`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Output file, a line of JSON per tick; `-` is standard output
    #[arg(long, value_name = "FILE", default_value = "-")]
    out: PathBuf,
    #[command(flatten)]
    playback: PlaybackArguments,
    #[command(flatten)]
    verdict: VerdictArguments,
}

/// Runs a recording through all stages in this process.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    arguments.verdict.check()?;
    let Played { mut playback, input, run, model } = arguments.playback.start()?;
    let mut chain = Chain::new(&run, &model)?;
    let mut report = PlayReport::new(&playback, input);
    let played = play(&arguments.out, run.origin(), &mut playback, &mut chain, &mut report);
    let kept = chain.keep_memory(&run);
    let is_whole = played?;
    kept?;
    // A verdict needs the whole recording.
    match is_whole {
        true => report.finish(&playback, arguments.verdict.report.as_deref(), arguments.verdict.strict),
        false => Ok(Exit::Done),
    }
}

/// Writes the forecasts of all ticks.
fn play(
    out: &Path,
    origin: WorldOrigin,
    playback: &mut Playback,
    chain: &mut Chain,
    report: &mut PlayReport,
) -> Result<bool, Failure> {
    let written = |error: std::io::Error| Failure::output(out, error);
    let mut writer = ForecastWriter::create(out, origin).map_err(written)?;
    let (mut ticks, mut forecasts_len) = (0_u64, 0_u64);
    while let Some(tick) = playback.next_tick() {
        let (header, forecasts) = chain.tick(&tick.header, tick.detections, |_| ());
        if !is_read(writer.write(&header, forecasts)).map_err(written)? {
            return Ok(false);
        }
        report.tick(&header, forecasts.len());
        report.lanes.add(forecasts);
        ticks += 1;
        forecasts_len += forecasts.len() as u64;
    }
    let is_read = is_read(writer.finish()).map_err(written)?;
    if is_read && !is_standard_output(out) {
        say!("{ticks} ticks, {forecasts_len} forecasts: {}", out.display());
        if let Some(line) = report.lanes.line() {
            say!("{line}");
        }
    }
    Ok(is_read)
}
