use std::path::{Path, PathBuf};
use std::sync::Arc;

use ::scene::ContextMap;
use clap::{Args, ValueEnum};
use drawing::{Mask, SceneDrawing, SceneOptions, scenes};
use evaluator::{Forecaster, MapInput};
use lanes::LaneMap;
use launch::arguments::{ModelArguments, ReadArguments};
use launch::failure::Failure;
use launch::say;
use localiser::MapChoice;
use run::Exit;

use crate::picture::save;
use crate::storyboard::{Shot, Storyboard};

/// Arguments of `stgdat plot scene`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Recording whose agents carry identities
    recording: PathBuf,
    #[command(flatten)]
    read: ReadArguments,
    /// Times to show, in seconds from the recording's start, a panel each; by default the middle of the time in
    /// which agents can be forecast
    #[arg(long, value_name = "SECONDS", value_delimiter = ',', conflicts_with = "best_worst")]
    at: Vec<f64>,
    /// Show the N agents with the smallest and the N with the largest errors, a panel each
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=16))]
    best_worst: Option<u16>,
    /// Agents whose forecasts are shown; by default all
    #[arg(long, value_name = "IDS", value_delimiter = ',', conflicts_with = "best_worst")]
    agents: Vec<u64>,
    /// Output file, .svg or .png; by default named after the recording
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Meaning of the mask of the forecast distribution
    #[arg(long, value_enum, default_value_t)]
    mask: MaskChoice,
    /// Draw the map's mean velocities as arrows
    #[arg(long)]
    velocity: bool,
    /// Label agents with their identities
    #[arg(long)]
    identities: bool,
    /// Panels side by side
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=16))]
    columns: Option<u16>,
    /// Width of the picture in points; a column of a paper has about 252, a page 516
    #[arg(long, value_name = "PT", default_value_t = SceneOptions::default().width)]
    width: f64,
    /// Height of a panel relative to its width
    #[arg(long, value_name = "RATIO", default_value_t = SceneOptions::default().height_per_width)]
    ratio: f64,
    /// Least extent of a panel in metres; by default that of the agents' types
    #[arg(long, value_name = "METRES")]
    extent: Option<f64>,
    #[command(flatten)]
    model: ModelArguments,
    /// Seed of latent variables, for models that draw them
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// What a mask stands for.
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
enum MaskChoice {
    /// The union of every moment's regions
    #[default]
    Moments,
    /// Where the agent spends a share of the horizon
    Pooled,
    /// The end of the horizon
    End,
    /// No mask
    None,
}

/// Draws scenes of a recording with their forecasts.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let (_, weights) = arguments.model.open_weights(None)?;
    let recording = arguments.read.open(&arguments.recording)?;
    let mut forecaster = Forecaster::new(weights, arguments.seed).map_err(Failure::data)?;
    let lanes = arguments.model.open_lanes(arguments.read.options().origin)?.map(Arc::new);
    lanes.iter().for_each(|map| forecaster.guide_along(Arc::clone(map)));
    let site = match &arguments.model.map {
        Some(MapChoice::File(path)) => Some(ContextMap::load(path).map_err(Failure::data)?),
        _ => None,
    };
    let map = match (&arguments.model.map, &site) {
        (_, Some(site)) => MapInput::Site(site),
        (Some(MapChoice::None), None) => MapInput::None,
        _ => MapInput::Online,
    };
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let storyboard = Storyboard::new(&forecaster, &recording, map, threads);
    let storyboard = storyboard.map_err(|error| Failure::file(&arguments.recording, error))?;
    let shots = arguments.shots(&storyboard)?;
    let drawings: Vec<SceneDrawing<'_>> =
        shots.iter().map(|shot| drawing(shot, site.as_ref(), lanes.as_deref())).collect();
    let picture =
        scenes(&recording.name, &drawings, &arguments.options(drawings.len())).map_err(Failure::data)?;
    let usual = || Path::new(arguments.recording.file_stem().unwrap_or_default()).with_extension("png");
    let out = arguments.out.clone().unwrap_or_else(usual);
    save(&picture, &out)?;
    say!("{}", out.display());
    Ok(Exit::Done)
}

impl Arguments {
    fn shots(&self, storyboard: &Storyboard<'_>) -> Result<Vec<Shot>, Failure> {
        let failed = |error| Failure::file(&self.recording, error);
        match self.best_worst {
            Some(len) => {
                let [best, worst] = storyboard.extremes(usize::from(len)).map_err(failed)?;
                Ok([best, worst].concat())
            }
            None => {
                let shot = |time_s: &f64| storyboard.at(*time_s, &self.agents).map_err(failed);
                if !self.at.is_empty() {
                    return self.at.iter().map(shot).collect();
                }
                let middle = shot(&storyboard.middle_s().unwrap_or_default())?;
                tracing::info!(
                    "shown: t = {:.1} s, frame {}; --at SECONDS shows other times",
                    middle.time_s,
                    middle.frame
                );
                Ok(vec![middle])
            }
        }
    }

    fn options(&self, panels_len: usize) -> SceneOptions {
        // The best are above the worst.
        let usual = self.best_worst.map_or(panels_len.clamp(1, 2), usize::from).min(4);
        SceneOptions {
            width: self.width,
            columns: self.columns.map_or(usual, usize::from),
            height_per_width: self.ratio,
            extent_min_m: self.extent,
            mask: match self.mask {
                MaskChoice::Moments => Mask::EveryMoment,
                MaskChoice::Pooled => Mask::Pooled,
                MaskChoice::End => Mask::End,
                MaskChoice::None => Mask::Hidden,
            },
            velocity: self.velocity,
            identities: self.identities,
        }
    }
}

fn drawing<'a>(shot: &'a Shot, site: Option<&'a ContextMap>, lanes: Option<&LaneMap>) -> SceneDrawing<'a> {
    let bounds = lanes.into_iter().flat_map(LaneMap::lanes).flat_map(|lane| lane.bounds_m.clone());
    let note = shot.errors.map(|errors| {
        let [ade_m, fde_m] = errors.best;
        let best = format!("best of {} modes: minADE {ade_m:.2} m, minFDE {fde_m:.2} m", errors.modes_len);
        let [ade_m, fde_m] = errors.likeliest;
        let likeliest = format!("top-1: ADE {ade_m:.2} m, FDE {fde_m:.2} m");
        let agents =
            if errors.agents_len > 1 { format!(" ({} agents)", errors.agents_len) } else { String::new() };
        format!("{best}; {likeliest}{agents}")
    });
    let about = match shot.about[..] {
        [agent] => format!("agent {agent}, "),
        _ => String::new(),
    };
    SceneDrawing {
        title: format!("{about}t = {:.1} s", shot.time_s),
        note: note.unwrap_or_default(),
        map: site.or(shot.online_map.as_ref()),
        lines: bounds.collect(),
        agents: shot.agents.clone(),
    }
}
