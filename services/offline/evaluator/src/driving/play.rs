//! Plays the recordings of a source through the pipeline.

use std::borrow::Cow;
use std::collections::{BTreeMap, VecDeque};
use std::path::PathBuf;

use data::RecordedTrack;
use evidence::{MotionNow, Prior, Priors, RoadUser, Traffic};
use metrics::{Anchors, HighestDensity};
use nn::ModelConfig;
use onboard::Chain;
use run::{Run, StageRun};
use scene::AgentType;
use source::{Playback, PlaybackOptions};
use wire::{Forecast, MODES_MAX};

use crate::driving::{
    conflicts::{self, Known, Pair},
    error::DrivingError,
    matching::agents,
    options::Options,
    report::subsets_of,
    sample::{Judge, Sample},
    source::Source,
};
use crate::lines::{Candidate, ForecastLine, ForecastLines};

/// The evidence of a source, as a prior for others.
pub(crate) type Learned = Option<Prior>;

/// Time between two forecasts of an agent that count.
const EVERY_NS: i64 = 400_000_000;
/// Time over which the kinematic baselines measure turn rate and acceleration.
const RATES_NS: i64 = 800_000_000;
/// An agent has a leader if one is on its way within this time and 20 m.
const LEADER_S: f32 = 2.0;
/// Minimum number of forecasts that a context needs to enter a prior.
pub(crate) const LEARNED_MIN: f64 = 30.0;

/// A source's matured forecasts, and the sampler's evidence after it.
pub(crate) struct Played {
    pub(crate) samples: Vec<Sample>,
    /// Pairs of agents, for conflicts.
    pub(crate) pairs: Vec<Pair>,
    /// Time that agents with forecasts were present, summed over the agents.
    pub(crate) agent_s: f64,
    pub(crate) seconds: f64,
    pub(crate) learned: Learned,
}

/// Plays a source as one run.
pub(crate) fn play(
    source: &Source,
    anchors: &BTreeMap<AgentType, Anchors>,
    options: &Options,
    model: &ModelConfig,
) -> Result<Played, DrivingError> {
    let mut judge = Judge {
        anchors,
        levels: HighestDensity::with_room(MODES_MAX),
        dt_s: model.dt_s as f32,
        horizon_len: model.horizon_len,
    };
    let (mut seen, mut played_s) = (Seen::default(), 0.0);
    let mut before: Option<Chain> = None;
    for (number, path) in source.files.iter().enumerate() {
        let recording = source.open(path)?;
        let tracks: BTreeMap<u64, RecordedTrack> =
            data::tracks(&recording).into_iter().map(|track| (track.id, track)).collect();
        let noisy = options.noise.applied_to(&recording);
        let has_identities = noisy.has_identities;
        let playback = Playback::new(noisy, PlaybackOptions { lockstep: true, ..PlaybackOptions::default() });
        let mut chain = Chain::new(&run_along(&playback, options, source.lanes_of(path, options))?, model)?;
        match before.take() {
            Some(before) => chain.continue_from(before),
            None if options.priors => chain.expect(Priors::shipped().without(&source.folder_name())),
            None => chain.expect(Prior::default()),
        }
        let agents = (number as u64) << 32;
        let lines = options.lines.as_deref().map(|file| Lines {
            file,
            part: &source.name,
            recording: path.file_stem().unwrap_or_default().to_string_lossy(),
        });
        let session = Session { agents, before_s: played_s, tracks: &tracks, has_identities, lines };
        played_s += session.play(playback, &mut chain, &mut judge, &mut seen);
        before = Some(chain);
    }
    let evidence = before.as_ref().and_then(Chain::evidence);
    let learned = evidence.map(|evidence| evidence.as_prior(LEARNED_MIN));
    let Seen { samples, pairs, agent_s } = seen;
    Ok(Played { samples, pairs, agent_s, seconds: played_s, learned })
}

/// The run of a playback, without lanes.
pub(crate) fn run(playback: &Playback, options: &Options) -> Result<Run, DrivingError> {
    run_along(playback, options, None)
}

/// The run of a playback along the lanes of a map, if there is one.
fn run_along(playback: &Playback, options: &Options, lanes: Option<PathBuf>) -> Result<Run, DrivingError> {
    let sampler = sampler::Options { evidence: options.evidence, lanes, ..sampler::Options::default() };
    let decoder = decoder::Options { precision: options.precision, ..decoder::Options::default() };
    let map = if options.map { localiser::MapChoice::Online } else { localiser::MapChoice::None };
    Ok(Run {
        interval_ns: playback.interval_ns(),
        lockstep: true,
        weights: options.weights.clone(),
        stages: vec![
            StageRun::with_options(&sampler::STAGE, &sampler)?,
            StageRun::with_options(&decoder::STAGE, &decoder)?,
            StageRun::with_options(&localiser::STAGE, &localiser::Options { map })?,
        ],
        ..Run::default()
    })
}

/// What is collected while a source is played.
#[derive(Default)]
struct Seen {
    samples: Vec<Sample>,
    pairs: Vec<Pair>,
    agent_s: f64,
}

/// One recording.
struct Session<'a> {
    /// Added to agents' ids, which are unique only within a recording.
    agents: u64,
    /// Time that earlier recordings of the source took.
    before_s: f64,
    tracks: &'a BTreeMap<u64, RecordedTrack>,
    has_identities: bool,
    lines: Option<Lines<'a>>,
}

/// Where the forecasts of a recording are written.
struct Lines<'a> {
    file: &'a ForecastLines,
    part: &'a str,
    recording: Cow<'a, str>,
}

/// The recent motion of an agent.
#[derive(Default)]
struct Recent {
    counted_ns: Option<i64>,
    velocities_mps: VecDeque<(i64, [f32; 2])>,
}

impl Session<'_> {
    /// Plays a recording to its end and returns its duration, s.
    fn play(&self, mut playback: Playback, chain: &mut Chain, judge: &mut Judge<'_>, seen: &mut Seen) -> f64 {
        let mut recent: BTreeMap<u64, Recent> = BTreeMap::new();
        let (mut first_ns, mut next_pairs_ns, mut seconds) = (None, None, 0.0);
        let mut traffic = Traffic::default();
        while let Some(tick) = playback.next_tick() {
            let stamp_ns = tick.header.stamp_ns;
            let since_ns = stamp_ns - *first_ns.get_or_insert(stamp_ns);
            seconds = since_ns as f64 * 1e-9;
            let (_, forecasts) = chain.tick(&tick.header, tick.detections, |_| ());
            let agents = agents(forecasts, self.tracks, stamp_ns, self.has_identities);
            if next_pairs_ns.is_none_or(|next_ns| stamp_ns >= next_ns) {
                next_pairs_ns = Some(stamp_ns + conflicts::EVERY_NS);
                let known: Vec<Known<'_>> = forecasts
                    .iter()
                    .zip(&agents)
                    .filter_map(|(forecast, agent)| {
                        let truth_m = judge.truth(stamp_ns, self.tracks.get(&(*agent)?)?)?;
                        let agent_type = AgentType::try_from(forecast.agent_type).ok()?;
                        Some(Known { forecast, agent_type, truth_m })
                    })
                    .collect();
                seen.agent_s += known.len() as f64 * conflicts::EVERY_NS as f64 * 1e-9;
                conflicts::pairs(&known, judge.dt_s, &mut seen.pairs);
            }
            traffic.clear();
            forecasts.iter().for_each(|forecast| traffic.push(road_user(forecast)));
            for (forecast, agent) in forecasts.iter().zip(agents) {
                let Some(track) = agent.and_then(|agent| self.tracks.get(&agent)) else { continue };
                let recent = recent.entry(forecast.id).or_default();
                let before = recent.add(stamp_ns, forecast);
                if forecast.modes_len < 2 || !recent.counts(stamp_ns) {
                    continue;
                }
                if let Some(judged) = judge.judge(stamp_ns, forecast, before, track) {
                    let has_leader = traffic.leader_on_turn(&road_user(forecast), LEADER_S).is_some();
                    let (agent, source_s) = (self.agents + track.id, self.before_s + seconds);
                    let sample = Sample { recording_s: seconds, source_s, has_leader, ..judged.sample };
                    if let Some(lines) = &self.lines {
                        lines.write(stamp_ns, &sample, &judged.truth_m, forecast, &judged.baselines);
                    }
                    seen.samples.push(Sample { agent, ..sample });
                }
            }
        }
        seconds
    }
}

impl Lines<'_> {
    fn write(
        &self,
        stamp_ns: i64,
        sample: &Sample,
        truth_m: &[Option<[f32; 2]>],
        forecast: &Forecast,
        baselines: &[(&'static str, Candidate)],
    ) {
        let len = truth_m.len();
        let modes_len = forecast.modes_len as usize;
        let published = Candidate {
            modes: forecast.modes[..modes_len].iter().map(|mode| mode[..len].to_vec()).collect(),
            probability: Some(forecast.probability[..modes_len].to_vec()),
            single: Some(forecast.best[..len].to_vec()),
        };
        let mut forecasts: BTreeMap<&str, &Candidate> = BTreeMap::from([("published", &published)]);
        forecasts.extend(baselines.iter().filter(|(_, of)| !of.is_empty()).map(|(name, of)| (*name, of)));
        let line = ForecastLine {
            part: self.part,
            recording: &self.recording,
            stamp_ns,
            agent: sample.agent,
            agent_type: sample.agent_type.name(),
            speed_mps: sample.speed_mps,
            subsets: subsets_of(sample).collect(),
            pixel_m: None,
            truth_m,
            forecasts,
        };
        self.file.write(&line.text());
    }
}

/// A forecast's agent as others see it on the road, without its rates.
fn road_user(forecast: &Forecast) -> RoadUser {
    let motion = MotionNow::since([forecast.x_m, forecast.y_m], [forecast.vx_mps, forecast.vy_mps], None);
    let size_m = [forecast.length_m, forecast.width_m];
    RoadUser { id: forecast.id, motion, heading_rad: forecast.heading_rad, size_m }
}

impl Recent {
    /// Adds the current velocity. Returns the velocity about [`RATES_NS`] earlier, and its age in s.
    fn add(&mut self, stamp_ns: i64, forecast: &Forecast) -> Option<([f32; 2], f32)> {
        let oldest_ns = stamp_ns - RATES_NS;
        while self.velocities_mps.len() > 1 && self.velocities_mps[1].0 <= oldest_ns {
            self.velocities_mps.pop_front();
        }
        let before = self
            .velocities_mps
            .front()
            .map(|(at_ns, velocity_mps)| (*velocity_mps, (stamp_ns - at_ns) as f32 * 1e-9));
        self.velocities_mps.push_back((stamp_ns, [forecast.vx_mps, forecast.vy_mps]));
        before
    }

    /// Whether a forecast of this time counts.
    fn counts(&mut self, stamp_ns: i64) -> bool {
        let counts = self.counted_ns.is_none_or(|counted_ns| stamp_ns >= counted_ns + EVERY_NS);
        if counts {
            self.counted_ns = Some(stamp_ns);
        }
        counts
    }
}
