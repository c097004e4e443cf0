//! The ticks that a run has published: from its recording, or from its forecasts as JSON lines.

use std::collections::{BTreeMap, VecDeque};
use std::fs::File;
use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};

use console::failure::Failure;
use recording::{Message, ReadError, Recording};
use serde::Deserialize;
use view::Pairing;
use wire::tick_view::{AgentView, ForecastView, Point, TickView};
use wire::{AgentType, Cause, EXPERTS_MAX, Quality, WorldOrigin};

/// Number of earlier positions of an agent, Δt apart; JSON lines contain no histories.
const HISTORY: usize = 7;

/// A file with published forecasts.
#[derive(Debug)]
pub enum Published {
    /// A recording of a run.
    Recording(Box<Recording>),
    /// Forecasts as JSON lines.
    Lines(PathBuf),
}

#[derive(Deserialize)]
struct Line {
    seq: u64,
    stamp_ns: i64,
    step_s: f64,
    agents: Vec<Agent>,
}

#[derive(Deserialize)]
struct Agent {
    id: u64,
    source_id: u64,
    r#type: String,
    quality: String,
    cause: String,
    out_of_distribution: f32,
    age_s: f64,
    x_m: f64,
    y_m: f64,
    vx_mps: f32,
    vy_mps: f32,
    heading_rad: f32,
    length_m: f32,
    width_m: f32,
    probability: Vec<f32>,
    modes_m: Vec<Vec<[f64; 2]>>,
    best_m: Vec<[f64; 2]>,
}

/// The positions of agents in the last ticks, by track.
type Past = BTreeMap<u64, VecDeque<(i64, Point)>>;

impl Published {
    /// The file, by its ending: `.mcap` or `.jsonl`; `None` for other files and for bags of other systems.
    ///
    /// # Errors
    /// [`Failure::Data`] if the file cannot be read.
    pub fn open(path: &Path) -> Result<Option<Self>, Failure> {
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
        Ok(match ending.as_deref() {
            Some("mcap") => match Recording::open(path) {
                Err(ReadError::NotOurs { .. }) => None,
                opened => Some(Self::Recording(Box::new(opened.map_err(Failure::data)?))),
            },
            Some("jsonl") => Some(Self::Lines(path.to_owned())),
            _ => None,
        })
    }

    /// Whether the forecasts have their covariances. JSON lines contain only the mixture's covariance.
    pub const fn has_regions(&self) -> bool {
        matches!(self, Self::Recording(_))
    }

    /// Hands the ticks over in their order. Positions of JSON lines are in the recording's own frame, and
    /// `origin` is subtracted.
    ///
    /// # Errors
    /// [`Failure`] if the file can't be read, with the line or the place.
    pub fn each(&self, origin: WorldOrigin, mut take: impl FnMut(TickView)) -> Result<(), Failure> {
        match self {
            Self::Recording(recording) => {
                let mut pairing = Pairing::default();
                for message in recording.messages() {
                    if let Message::Frame(frame) = message.map_err(Failure::data)?
                        && let Some((view, _)) = pairing.take(frame)
                    {
                        take(view);
                    }
                }
            }
            Self::Lines(path) => {
                let file = File::open(path).map_err(|error| Failure::file(path, error))?;
                let mut past = Past::new();
                for (number, line) in BufReader::new(file).lines().enumerate() {
                    let line = line.map_err(|error| Failure::file(path, error))?;
                    let failed = |why: String| Failure::file(path, format!("line {}: {why}", number + 1));
                    let line: Line =
                        serde_json::from_str(&line).map_err(|error| failed(error.to_string()))?;
                    take(line.view(origin, &mut past).map_err(failed)?);
                }
            }
        }
        Ok(())
    }
}

impl Line {
    fn view(self, origin: WorldOrigin, past: &mut Past) -> Result<TickView, String> {
        let Self { seq, stamp_ns, step_s, agents } = self;
        let step_ns = (step_s * 1e9).round() as i64;
        let agents = agents.into_iter().map(|agent| agent.view(stamp_ns, step_ns, origin, past));
        let agents = agents.collect::<Result<_, _>>()?;
        Ok(TickView { seq, stamp_ns, step_ns: step_ns.unsigned_abs(), agents, ..TickView::default() })
    }
}

impl Agent {
    fn view(
        self,
        stamp_ns: i64,
        step_ns: i64,
        origin: WorldOrigin,
        past: &mut Past,
    ) -> Result<AgentView, String> {
        let world = |own_m: [f64; 2]| {
            let [x_m, y_m] = own_m;
            origin.world_m(own_m).ok_or_else(|| format!("{x_m}, {y_m} is too far from the origin: --origin"))
        };
        let path =
            |own_m: &[[f64; 2]]| own_m.iter().map(|own_m| world(*own_m)).collect::<Result<Vec<_>, _>>();
        let named = |what: &str, name: &str| format!("agent {}: unknown {what} \"{name}\"", self.id);
        let quality = Quality::ALL.into_iter().find(|quality| quality.name() == self.quality);
        let agent_type: AgentType = self.r#type.parse().map_err(|_| named("type", &self.r#type))?;
        let modes = self.modes_m.iter().map(|mode| path(mode)).collect::<Result<Vec<_>, _>>()?;
        let best = path(&self.best_m)?;
        let forecast = ForecastView {
            quality: quality.ok_or_else(|| named("quality", &self.quality))?,
            cause: Cause::number_of(&self.cause).ok_or_else(|| named("cause", &self.cause))?,
            age_ns: (self.age_s * 1e9).round() as u64,
            experts: [0.0; EXPERTS_MAX],
            out_of_distribution: self.out_of_distribution,
            covariance: modes.iter().map(|mode| vec![[0.0; 3]; mode.len()]).collect(),
            best,
            modes,
            probability: self.probability,
        };
        let position_m = world([self.x_m, self.y_m])?;
        let known = past.entry(self.id).or_default();
        let at = |step: usize| {
            let wanted_ns = stamp_ns.saturating_sub(step_ns.saturating_mul(step as i64));
            let apart = |entry: &&(i64, Point)| entry.0.abs_diff(wanted_ns);
            let near =
                known.iter().min_by_key(apart).filter(|entry| apart(entry) < step_ns.unsigned_abs() / 4);
            near.map(|(_, position_m)| *position_m)
        };
        let history = (1..=HISTORY).rev().map(at).collect();
        known.push_back((stamp_ns, position_m));
        let begin_ns = stamp_ns.saturating_sub(step_ns.saturating_mul(HISTORY as i64 + 1));
        while known.front().is_some_and(|(stamp_ns, _)| *stamp_ns < begin_ns) {
            known.pop_front();
        }
        Ok(AgentView {
            id: self.id,
            source_id: self.source_id,
            agent_type,
            position_m,
            velocity_mps: [self.vx_mps, self.vy_mps],
            heading_rad: self.heading_rad,
            length_m: Some(self.length_m).filter(|size_m| *size_m > 0.0),
            width_m: Some(self.width_m).filter(|size_m| *size_m > 0.0),
            unseen_ns: 0,
            history,
            forecast: Some(forecast),
        })
    }
}
