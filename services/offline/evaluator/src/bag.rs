//! Our forecasts beside the forecasts of another system, which a bag holds as `PredictedObjects`.
//!
//! Both are compared on the same agents, at the same times, over the same horizon and with the same truth:
//!
//! 1. A message of the bag is compared with our newest tick at its stamp, as a planner would read both.
//! 2. An object belongs to the nearest forecast of its type, at most 2 m away. Each belongs to one
//!    at most, so no identity of the bag is needed.
//! 3. The steps are ours, Δt apart from the message's stamp. Paths with other steps are interpolated.
//! 4. The truth is the recording's own, if it has identities, or else the later positions of our tracks.

mod report;

use std::collections::VecDeque;

use data::{PredictedAgent, PredictedFrame, Recording};
use metrics::{HighestDensity, Point, displacement, min_displacement};
use onboard::Chain;
use scene::State;
use source::Playback;
use wire::{AgentType, Forecast, HORIZON_MAX, MODES_MAX};

use report::{AgainstReport, Cells, Counts};

use crate::driving::{at_step, run};
use crate::error::EvaluateError;
use crate::footage::{Options, SEED};
use crate::matching::nearest_pairs;
use crate::page::Page;
use crate::playback::{GAP_NS, Truth, playback};

/// Largest distance between an object of the bag and our forecast of it.
const RADIUS_M: f32 = 2.0;

/// A forecast of both systems.
struct Pair {
    /// Identity in the truth.
    agent: u64,
    agent_type: AgentType,
    ours: Box<Forecast>,
    our_ns: i64,
    theirs: PredictedAgent,
    at_ns: i64,
}

/// The steps of the comparison.
#[derive(Clone, Copy, Debug)]
struct Steps {
    step_ns: i64,
    len: usize,
}

/// Plays a recording, and compares the forecasts with a bag's.
///
/// # Errors
/// [`EvaluateError`] if the stages can't be set up, or nothing can be compared.
pub fn against_bag(
    recording: Recording,
    frames: Vec<PredictedFrame>,
    options: &Options,
) -> Result<Page, EvaluateError> {
    Ok(compare(recording, frames, options)?.page())
}

fn compare(
    recording: Recording,
    mut frames: Vec<PredictedFrame>,
    options: &Options,
) -> Result<AgainstReport, EvaluateError> {
    let weights = options.weights.load()?;
    let model = weights.config();
    frames.sort_by_key(|frame| frame.stamp_ns);
    let is_truth_recorded = recording.has_identities;
    let truth = if is_truth_recorded { Truth::of(&recording) } else { Truth::default() };
    let mut playback = playback(recording);
    let mut chain = Chain::new(&run(playback.interval_ns(), options, None)?, model)?;
    let steps = Steps::of(&frames, &playback, (model.dt_s * 1e9).round() as i64, model.horizon_len)?;
    let mut comparison = Comparison {
        truth,
        is_truth_recorded,
        steps,
        interval_ns: playback.interval_ns().cast_signed(),
        waiting: VecDeque::new(),
        counts: Counts::default(),
        cells: Cells::new(steps.len),
        levels: HighestDensity::with_room(MODES_MAX),
        paths_max: 0,
    };
    let mut frames = frames.into_iter().peekable();
    let mut last: Option<(i64, Vec<Forecast>)> = None;
    while let Some(tick) = playback.next_tick() {
        let stamp_ns = tick.header.stamp_ns;
        while let Some(frame) = frames.next_if(|frame| frame.stamp_ns < stamp_ns) {
            comparison.frame(frame, last.as_ref());
        }
        let forecasts = chain.tick(&tick.header, tick.detections, |_| ()).1.to_vec();
        if !is_truth_recorded {
            let observed = chain.tracks().iter().filter(|track| track.unseen_ns == 0);
            observed.for_each(|track| {
                let state = State {
                    position_m: [track.x_m, track.y_m],
                    velocity_mps: [track.vx_mps, track.vy_mps],
                    heading_rad: track.heading_rad,
                };
                comparison.truth.add(track.id, stamp_ns, state);
            });
        }
        comparison.mature(stamp_ns);
        last = Some((stamp_ns, forecasts));
    }
    frames.for_each(|frame| comparison.frame(frame, last.as_ref()));
    comparison.mature(i64::MAX);
    let first = last.map_or(0, |(stamp_ns, _)| stamp_ns);
    comparison.report(first)
}

impl Steps {
    /// The longest horizon of both systems in steps of ours.
    fn of(
        frames: &[PredictedFrame],
        playback: &Playback,
        step_ns: i64,
        horizon_len: usize,
    ) -> Result<Self, EvaluateError> {
        let objects = frames.iter().flat_map(|frame| &frame.objects);
        let mut durations: Vec<i64> =
            objects.map(longest_ns).filter(|duration_ns| *duration_ns > 0).collect();
        durations.sort_unstable();
        let theirs_ns = durations.get(durations.len() / 2).copied().unwrap_or(0);
        let recorded = &playback.recording().frames;
        let is_tick = |frame: &PredictedFrame| {
            recorded.binary_search_by_key(&frame.stamp_ns, |frame| frame.stamp_ns).is_ok()
        };
        // Between two ticks our newest forecast is older, so its last step comes too early.
        let is_aligned = playback.thinning() == 1 && frames.iter().all(is_tick);
        let ours_len = if is_aligned { horizon_len } else { horizon_len.saturating_sub(1) };
        let len = usize::try_from(theirs_ns / step_ns).unwrap_or(0).min(ours_len);
        if len == 0 {
            let (theirs_s, step_s) = (theirs_ns as f64 / 1e9, step_ns as f64 / 1e9);
            return Err(EvaluateError::Against(format!(
                "half of the bag's paths end within {theirs_s:.1} s, and a step is {step_s:.1} s"
            )));
        }
        Ok(Self { step_ns, len })
    }

    const fn ahead_ns(self, step: usize) -> i64 {
        self.step_ns * (step as i64 + 1)
    }
}

fn longest_ns(agent: &PredictedAgent) -> i64 {
    agent.paths.iter().map(data::PredictedPath::duration_ns).max().unwrap_or(0)
}

/// A running comparison.
struct Comparison {
    /// The recording's own motion. Without identities it is the motion of our tracks.
    truth: Truth,
    is_truth_recorded: bool,
    steps: Steps,
    interval_ns: i64,
    waiting: VecDeque<Pair>,
    counts: Counts,
    cells: Cells,
    levels: HighestDensity,
    paths_max: usize,
}

impl Comparison {
    /// Pairs the objects of a message with the forecasts of the tick before it.
    fn frame(&mut self, frame: PredictedFrame, last: Option<&(i64, Vec<Forecast>)>) {
        let at_ns = frame.stamp_ns;
        let Some((our_ns, forecasts)) = last.filter(|(our_ns, _)| at_ns - our_ns <= self.interval_ns) else {
            self.counts.messages_outside += 1;
            return;
        };
        self.counts.messages += 1;
        self.counts.other += frame.other_len as u64;
        let pairs = matches(&frame.objects, forecasts, (at_ns - our_ns) as f32 * 1e-9);
        self.counts.only_ours += (forecasts.len() - pairs.len()) as u64;
        self.counts.only_theirs += (frame.objects.len() - pairs.len()) as u64;
        let mut objects: Vec<Option<PredictedAgent>> = frame.objects.into_iter().map(Some).collect();
        for (theirs, ours) in pairs {
            let Some(theirs) = objects[theirs].take() else { continue };
            if longest_ns(&theirs) < self.steps.ahead_ns(self.steps.len - 1) {
                self.counts.short += 1;
                continue;
            }
            let forecast = &forecasts[ours];
            let agent = if self.is_truth_recorded { forecast.source_id } else { forecast.id };
            let agent_type = theirs.agent_type;
            let (ours, our_ns) = (Box::new(*forecast), *our_ns);
            self.waiting.push_back(Pair { agent, agent_type, ours, our_ns, theirs, at_ns });
        }
    }

    /// Judges the pairs whose truth is complete at a time.
    fn mature(&mut self, now_ns: i64) {
        let whole_ns = self.steps.ahead_ns(self.steps.len - 1) + GAP_NS;
        while let Some(pair) = self.waiting.pop_front_if(|pair| pair.at_ns.saturating_add(whole_ns) < now_ns)
        {
            self.judge(&pair);
        }
    }

    fn judge(&mut self, pair: &Pair) {
        let Steps { step_ns, len } = self.steps;
        let truth = self.truth.ahead(pair.agent, pair.at_ns, step_ns as f64, len);
        let paths = pair.theirs_at(self.steps);
        let Some(truth) = truth.filter(|_| !paths.is_empty()) else {
            self.counts.without_truth += 1;
            return;
        };
        self.counts.forecasts += 1;
        self.paths_max = self.paths_max.max(paths.len());
        let modes = pair.modes_at(self.steps);
        let as_many = &modes[..paths.len().min(modes.len())];
        let paths: Vec<Vec<Point>> = paths.into_iter().map(|(_, points)| points).collect();
        let (ours, steady) = (pair.ours_at(&pair.ours.best, self.steps), pair.steady_at(self.steps));
        for (place, horizon) in self.cells.horizons().into_iter().enumerate() {
            let truth = &truth[..horizon];
            let one = |path: &[Point]| displacement(path, truth);
            let best = |paths: &[Vec<Point>]| min_displacement(paths, truth);
            let errors =
                [one(&ours), one(&paths[0]), one(&steady), best(as_many), best(&paths), best(&modes)];
            // A region belongs to a step of our own tick.
            let end = self.truth.state(pair.agent, pair.our_ns + step_ns * horizon as i64);
            let level = end.map(|end| pair.level(horizon - 1, end.position_m, &mut self.levels));
            self.cells.add(pair.agent_type, place, &errors, level);
        }
    }

    fn report(self, last_ns: i64) -> Result<AgainstReport, EvaluateError> {
        let Self { counts, cells, steps, is_truth_recorded, paths_max, .. } = self;
        if counts.forecasts == 0 {
            return Err(EvaluateError::Against(format!(
                "no forecast of the bag can be compared: {}; the recording ends at {:.3} s",
                counts.text(),
                last_ns as f64 / 1e9
            )));
        }
        Ok(AgainstReport { counts, rows: cells.rows(steps.step_ns), paths_max, is_truth_recorded })
    }
}

/// Places of objects and forecasts of the same agents. Our forecasts are moved on by `age_s`.
fn matches(objects: &[PredictedAgent], forecasts: &[Forecast], age_s: f32) -> Vec<(usize, usize)> {
    let apart_m = |theirs: usize, ours: usize| {
        let (object, forecast) = (&objects[theirs], &forecasts[ours]);
        let [x_m, y_m] = [forecast.x_m + age_s * forecast.vx_mps, forecast.y_m + age_s * forecast.vy_mps];
        let apart_m = (object.position_m[0] - x_m).hypot(object.position_m[1] - y_m);
        let is_near = forecast.agent_type == object.agent_type as u32 && apart_m <= RADIUS_M;
        is_near.then_some(f64::from(apart_m))
    };
    nearest_pairs([objects.len(), forecasts.len()], apart_m)
}

impl Pair {
    /// The other system's paths at our steps, the most confident one first, with their confidence. Paths that
    /// are shorter than the horizon are left out.
    fn theirs_at(&self, steps: Steps) -> Vec<(f32, Vec<Point>)> {
        let path = |path: &data::PredictedPath| {
            let points = (0..steps.len).map(|step| path.at(steps.ahead_ns(step)));
            Some((path.confidence, points.collect::<Option<_>>()?))
        };
        let mut paths: Vec<(f32, Vec<Point>)> = self.theirs.paths.iter().filter_map(path).collect();
        paths.sort_by(|a, b| b.0.total_cmp(&a.0));
        paths
    }

    /// One of our paths at the steps after the message's stamp.
    fn ours_at(&self, path: &[Point; HORIZON_MAX], steps: Steps) -> Vec<Point> {
        let share = (self.at_ns - self.our_ns) as f32 / steps.step_ns as f32;
        let at = |step: usize| {
            let (from, to) = (path[step], path[(step + 1).min(HORIZON_MAX - 1)]);
            if share == 0.0 { from } else { [0, 1].map(|axis| from[axis] + share * (to[axis] - from[axis])) }
        };
        (0..steps.len).map(at).collect()
    }

    /// Our modes at the steps, the most probable one first.
    fn modes_at(&self, steps: Steps) -> Vec<Vec<Point>> {
        let len = (self.ours.modes_len as usize).min(MODES_MAX);
        let mut order: Vec<usize> = (0..len).collect();
        order.sort_by(|a, b| self.ours.probability[*b].total_cmp(&self.ours.probability[*a]));
        let modes = order.into_iter().map(|mode| self.ours_at(&self.ours.modes[mode], steps));
        let modes: Vec<_> = modes.collect();
        if modes.is_empty() { vec![self.ours_at(&self.ours.best, steps)] } else { modes }
    }

    fn steady_at(&self, steps: Steps) -> Vec<Point> {
        let Forecast { x_m, y_m, vx_mps, vy_mps, .. } = *self.ours;
        let at = |step: usize| {
            let ahead_s = (self.at_ns - self.our_ns + steps.ahead_ns(step)) as f32 * 1e-9;
            [x_m + vx_mps * ahead_s, y_m + vy_mps * ahead_s]
        };
        (0..steps.len).map(at).collect()
    }

    /// The level of our region at a step whose border passes through the truth.
    fn level(&self, step: usize, truth: Point, levels: &mut HighestDensity) -> f64 {
        let len = (self.ours.modes_len as usize).min(MODES_MAX);
        let (means, covariances) = at_step(&self.ours, step);
        levels.level(&means[..len], &covariances[..len], &self.ours.probability[..len], truth, SEED)
    }
}

#[cfg(test)]
mod tests;
