//! Plays the recordings of a source through the pipeline.

use std::borrow::Cow;
use std::collections::{BTreeMap, VecDeque};

use ::conflicts::OddsOfSources;
use evidence::{MotionNow, Prior, RoadUser, Traffic};
use metrics::{Anchors, HighestDensity};
use nn::ModelConfig;
use onboard::Chain;
use scene::AgentType;
use wire::{Forecast, MODES_MAX};

use super::{Judge, Judged, Known, Pair, Sample, Source, conflicts, subsets_of};
use crate::error::EvaluateError;
use crate::footage::Options;
use crate::lines::{Candidate, ForecastLine, ForecastLines};
use crate::playback::Playing;

/// Time between two forecasts of an agent that count.
pub(crate) const EVERY_NS: i64 = 400_000_000;
/// Time over which the kinematic baselines measure turn rate and acceleration.
const RATES_NS: i64 = 800_000_000;
/// An agent has a leader if one is on its way within this time and 20 m.
const LEADER_S: f32 = 2.0;
/// Minimum number of forecasts that a context needs to enter a prior.
pub(crate) const LEARNED_MIN: f64 = 30.0;

/// A source's matured forecasts, and the sampler's evidence after it.
#[derive(Default)]
pub(crate) struct Played {
    pub(crate) samples: Vec<Sample>,
    /// Pairs of agents, for conflicts.
    pub(crate) pairs: Vec<Pair>,
    /// Time that agents with forecasts were present, summed over the agents.
    pub(crate) agent_s: f64,
    pub(crate) seconds: f64,
    /// The evidence of the source, as a prior for others.
    pub(crate) learned: Option<Prior>,
}

/// Plays a source as one run.
pub(crate) fn play(
    source: &Source,
    anchors: &BTreeMap<AgentType, Anchors>,
    options: &Options,
    model: &ModelConfig,
) -> Result<Played, EvaluateError> {
    let odds = OddsOfSources::shipped();
    let mut judge = Judge {
        anchors,
        odds: odds.for_source(&source.folder_name()),
        levels: HighestDensity::with_room(MODES_MAX),
        dt_s: model.dt_s as f32,
        horizon_len: model.horizon_len,
    };
    let mut played = Played::default();
    let last = source.play(options, model, |number, path, playing| {
        let lines = options.lines.as_deref().map(|file| Lines {
            file,
            part: &source.name,
            recording: path.file_stem().unwrap_or_default().to_string_lossy(),
        });
        // Agents' ids are unique only within a recording.
        played.recording(playing, (number as u64) << 32, &mut judge, lines.as_ref());
        Ok(())
    })?;
    let evidence = last.as_ref().and_then(Chain::evidence);
    played.learned = evidence.map(|evidence| evidence.as_prior(LEARNED_MIN));
    Ok(played)
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

impl Played {
    /// Plays a recording to its end. `first_agent` is added to the ids of its agents.
    fn recording(
        &mut self,
        playing: &mut Playing,
        first_agent: u64,
        judge: &mut Judge<'_>,
        lines: Option<&Lines<'_>>,
    ) {
        let mut recent: BTreeMap<u64, Recent> = BTreeMap::new();
        let (mut first_ns, mut next_pairs_ns, mut seconds) = (None, None, 0.0);
        let mut traffic = Traffic::default();
        while let Some(tick) = playing.next() {
            let stamp_ns = tick.header.stamp_ns;
            let since_ns = stamp_ns - *first_ns.get_or_insert(stamp_ns);
            seconds = since_ns as f64 * 1e-9;
            if next_pairs_ns.is_none_or(|next_ns| stamp_ns >= next_ns) {
                next_pairs_ns = Some(stamp_ns + conflicts::EVERY_NS);
                let known = tick.followed().filter_map(|(forecast, track)| {
                    let truth_m = judge.truth(tick.truth, stamp_ns, track.id)?;
                    let truth_m = truth_m.into_iter().flatten().collect();
                    Some(Known { forecast, truth_m })
                });
                let known: Vec<Known<'_>> = known.collect();
                self.agent_s += known.len() as f64 * conflicts::EVERY_NS as f64 * 1e-9;
                conflicts::pairs(&known, judge.dt_s, judge.odds, &mut self.pairs);
            }
            traffic.clear();
            tick.forecasts.iter().for_each(|forecast| traffic.push(road_user(forecast)));
            for (forecast, track) in tick.followed() {
                let recent = recent.entry(forecast.id).or_default();
                let before = recent.add(stamp_ns, forecast);
                if forecast.modes_len < 2 || !recent.counts(stamp_ns) {
                    continue;
                }
                if let Some(judged) = judge.judge(tick.truth, stamp_ns, forecast, before, track.id) {
                    let sample = Sample {
                        recording_s: seconds,
                        source_s: self.seconds + seconds,
                        has_leader: traffic.leader_on_turn(&road_user(forecast), LEADER_S).is_some(),
                        agent: first_agent + track.id,
                        ..judged.sample
                    };
                    lines
                        .iter()
                        .for_each(|lines| lines.write(stamp_ns, track.id, &sample, forecast, &judged));
                    self.samples.push(sample);
                }
            }
        }
        self.seconds += seconds;
    }
}

impl Lines<'_> {
    fn write(&self, stamp_ns: i64, agent: u64, sample: &Sample, forecast: &Forecast, judged: &Judged) {
        let published = Candidate::published(forecast, judged.truth_m.len());
        let mut forecasts: BTreeMap<&str, &Candidate> = BTreeMap::from([("published", &published)]);
        forecasts
            .extend(judged.baselines.iter().filter(|(_, of)| !of.is_empty()).map(|(name, of)| (*name, of)));
        let line = ForecastLine {
            part: self.part,
            recording: &self.recording,
            stamp_ns,
            agent,
            agent_type: sample.agent_type.name(),
            speed_mps: sample.speed_mps,
            subsets: subsets_of(sample).collect(),
            pixel_m: None,
            truth_m: &judged.truth_m,
            forecasts,
        };
        self.file.add(&line);
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
