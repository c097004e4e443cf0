use std::path::{Path, PathBuf};

use clap::Args;
use console::failure::Failure;
use console::say;
use console::show::is_read;
use onboard::Chain;
use recorder::{ForecastWriter, is_standard_output};
use run::Exit;
use source::Playback;
use wire::WorldOrigin;

use crate::arguments::{PlaybackArguments, Played};
use crate::pages::PlayedPage;
use crate::play_report::{PlayReport, VerdictArguments};

/// Arguments of `stgdat predict`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Output file, a line of JSON per tick; `-` is standard output
    #[arg(long, value_name = "FILE", default_value = "-")]
    out: PathBuf,
    /// Write the scenes, qualities and errors as an HTML page, as `run --html` does
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    /// Replace the file of --html if it exists
    #[arg(long, requires = "html")]
    force: bool,
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
    let name = playback.recording().name.clone();
    let page = arguments.html.as_deref();
    let mut page = page.map(|path| PlayedPage::new(path, &name, &run, arguments.force)).transpose()?;
    let out = &*arguments.out;
    let played = play(out, run.origin(), &mut playback, &mut chain, &mut report, page.as_mut());
    let kept = chain.end(&run);
    let is_whole = played?;
    kept?;
    page.map_or(Ok(()), PlayedPage::write)?;
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
    mut page: Option<&mut PlayedPage>,
) -> Result<bool, Failure> {
    let written = |error: std::io::Error| Failure::output(out, error);
    let mut writer = ForecastWriter::create(out, origin).map_err(written)?;
    let (mut ticks, mut forecasts_len) = (0_u64, 0_u64);
    while let Some(tick) = playback.next_tick() {
        let (header, forecasts) = chain.tick(&tick.header, tick.detections, |_| ());
        if !is_read(writer.write(&header, forecasts)).map_err(written)? {
            return Ok(false);
        }
        report.tick(&header, forecasts.iter().map(|of| (of.agent_type, of.noise())));
        report.lanes.add(forecasts);
        ticks += 1;
        forecasts_len += forecasts.len() as u64;
        if let Some(page) = &mut page {
            page.add(&tick, chain);
        }
    }
    let is_read = is_read(writer.finish()).map_err(written)?;
    if is_read && !is_standard_output(out) {
        say!("{ticks} ticks, {forecasts_len} forecasts: {}", out.display());
        for line in report.lanes.line().into_iter().chain(report.noise_line()) {
            say!("{line}");
        }
    }
    Ok(is_read)
}
