use std::path::{Path, PathBuf};

use ::scene::ContextMap;
use clap::{Args, ValueEnum};
use console::failure::Failure;
use console::say;
use drawing::{Mask, SceneDrawing, SceneOptions, scenes};
use lanes::LaneMap;
use launch::arguments::{PlaybackArguments, Played, lanes_of};
use localiser::MapChoice;
use run::Exit;

use crate::gallery::{Shot, Wanted, published_shots, shots};
use crate::picture::save;
use crate::published::Published;

/// Arguments of `stgdat plot scene`.
#[derive(Debug, Args)]
pub struct Arguments {
    #[command(flatten)]
    playback: PlaybackArguments,
    /// Times to show, in seconds from the first tick, one panel each with the nearest tick; by default the
    /// middle
    #[arg(long, value_name = "SECONDS", value_delimiter = ',', conflicts_with = "best_worst")]
    at: Vec<f64>,
    /// Show the N agents with the smallest and the N agents with the largest errors, one panel each
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=16))]
    best_worst: Option<u16>,
    /// Show only the forecasts of these agents, by their identities in the recording
    #[arg(long, value_name = "IDS", value_delimiter = ',', conflicts_with = "best_worst")]
    agents: Vec<u64>,
    /// Output file, .svg or .png; by default the recording's name with the extension png
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
    /// Width of the picture in points: a paper's column has about 252, a page 516
    #[arg(long, value_name = "PT", default_value_t = SceneOptions::default().width)]
    width: f64,
    /// Height of a panel relative to its width
    #[arg(long, value_name = "RATIO", default_value_t = SceneOptions::default().height_per_width)]
    ratio: f64,
    /// Minimum extent of a panel in metres; by default it depends on the agents' types
    #[arg(long, value_name = "METRES")]
    extent: Option<f64>,
}

/// What a mask stands for.
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
enum MaskChoice {
    /// The union of every moment's regions
    #[default]
    Moments,
    /// The region in which the agent spends a share of the horizon
    Pooled,
    /// The end of the horizon
    End,
    /// No mask
    None,
}

/// Draws ticks with their published forecasts: of a run that has ended, or of a recording that is played through
/// the stages.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let playback = &arguments.playback;
    let origin = playback.read().options().origin;
    let lanes = playback.model().open_lanes(origin)?;
    let path = playback.path()?;
    let published = path.as_deref().map(Published::open).transpose()?.flatten();
    let site = match &playback.model().map {
        Some(MapChoice::File(path)) => Some(ContextMap::load(path).map_err(Failure::data)?),
        _ => None,
    };
    let has_map = playback.model().map != Some(MapChoice::None);
    let (wanted, agents) = (arguments.wanted(), &arguments.agents);
    let mut options = arguments.options();
    let (name, shots) = match &published {
        Some(published) => {
            if !published.has_regions() {
                options.mask = Mask::Hidden;
            }
            let name = path.as_deref().and_then(Path::file_name).unwrap_or_default();
            (name.to_string_lossy().into_owned(), published_shots(published, origin, &wanted, agents)?)
        }
        None => {
            let Played { playback: played, run, model, .. } = playback.start()?;
            let name = played.recording().name.clone();
            (name, shots(played, (&run, &model), &wanted, agents)?)
        }
    };
    let lanes = match &published {
        Some(Published::Recording(recording)) if lanes.is_none() => lanes_of(&recording.about().run)?,
        _ => lanes,
    };
    let mut drawings = Vec::with_capacity(shots.len());
    for shot in &shots {
        let map = site.as_ref().or(shot.visits.as_ref()).filter(|_| has_map);
        drawings.push(drawing(shot, map, lanes.as_ref()));
    }
    options.columns = arguments.columns(drawings.len());
    let picture = scenes(&name, &drawings, &options).map_err(Failure::data)?;
    let stem = path.as_deref().and_then(Path::file_stem).unwrap_or("scene".as_ref());
    let out = arguments.out.clone().unwrap_or_else(|| Path::new(stem).with_extension("png"));
    save(&picture, &out)?;
    for shot in &shots {
        say!("tick {} at {:.2} s: {} forecasts", shot.tick, shot.time_s, shot.about.len());
    }
    say!("{}", out.display());
    Ok(Exit::Done)
}

impl Arguments {
    fn wanted(&self) -> Wanted {
        match self.best_worst {
            Some(count) => Wanted::Extremes(usize::from(count)),
            None if self.at.is_empty() => Wanted::Middle,
            None => Wanted::At(self.at.clone()),
        }
    }

    fn columns(&self, panel_count: usize) -> usize {
        // The best are above the worst.
        let usual = self.best_worst.map_or(panel_count.clamp(1, 2), usize::from).min(4);
        self.columns.map_or(usual, usize::from)
    }

    fn options(&self) -> SceneOptions {
        SceneOptions {
            width: self.width,
            columns: 1,
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

fn drawing<'a>(shot: &Shot, map: Option<&'a ContextMap>, lanes: Option<&LaneMap>) -> SceneDrawing<'a> {
    let bounds = lanes.into_iter().flat_map(LaneMap::lanes).flat_map(|lane| lane.bounds_m.clone());
    let note = shot.errors.map(|errors| {
        let ([ade_m, fde_m], [min_ade_m, min_fde_m]) = (errors.best, errors.hindsight);
        let agents = if errors.agents > 1 { format!(" ({} agents)", errors.agents) } else { String::new() };
        format!(
            "best forecast: ADE {ade_m:.2} m, FDE {fde_m:.2} m; best of {} in hindsight: {min_ade_m:.2} m, \
             {min_fde_m:.2} m{agents}",
            errors.modes
        )
    });
    let about = match shot.about[..] {
        [agent] => format!("agent {agent}, "),
        _ => String::new(),
    };
    SceneDrawing {
        title: format!("{about}t = {:.2} s, tick {}", shot.time_s, shot.tick),
        note: note.unwrap_or_default(),
        map,
        lanes: bounds.collect(),
        agents: shot.agents.clone(),
    }
}
