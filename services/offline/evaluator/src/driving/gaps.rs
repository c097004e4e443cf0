//! Tracking through gaps: how far tracks are from the truth while their agents are not detected.

use bytemuck::Zeroable;
use kinematics::Normals;
use metrics::Interval;
use nn::ModelConfig;
use scene::AgentType;
use tracker::Tracker;
use wire::{AGENTS_MAX, Detection, Track, detection_flags};

use super::{Source, source, sources};
use crate::error::EvaluateError;
use crate::footage::{Options, SEED};
use crate::lines::{Motion, TrackLine};
use crate::noise::Noise;
use crate::page::Page;
use crate::table::{Entry, RESAMPLES, Table, ratio_of_clusters};
use crate::threads;

/// Lengths of the gaps, s. An agent's gaps alternate between them.
const GAPS_S: [f64; 2] = [0.8, 1.6];
/// Time between the starts of an agent's gaps. Each agent has its own phase.
const PERIOD_S: f64 = 6.0;
/// Time in the period at which the gap begins.
const BEGINS_S: f64 = 4.0;
/// Standard deviation of a measured position per axis.
const SIGMA_M: f32 = 0.1;
/// The priors of the compared tracks.
const PRIORS: [&str; 2] = ["forecasts", "kinematic"];
/// Cells with fewer positions are left out.
const CELL_MIN: usize = 200;

/// A position in a gap, with the squared errors of two tracks: prior from forecasts, and kinematic prior.
#[derive(Clone, Copy, Debug)]
struct Position {
    agent: u64,
    agent_type: AgentType,
    /// Index into [`GAPS_S`].
    gap: usize,
    squares_m2: [f64; 2],
}

/// Tracks all sources from noisy positions with gaps. Calls `progress` with each source's name before it
/// starts.
///
/// # Errors
/// [`EvaluateError`] names the folder, recording or weights at fault.
pub fn through_gaps(options: &Options, progress: impl Fn(&str) + Sync) -> Result<Page, EvaluateError> {
    let weights = options.weights.load()?;
    let sources = sources(&options.data.join("driving"), &options.sources)?;
    let threads = if options.lines.is_some() { 1 } else { options.threads };
    let tracked = threads::each(&sources, threads, |source, _: &mut ()| {
        progress(&format!("tracking {}", source.name));
        track(source, options, weights.config())
    });
    let tracked = tracked.into_iter().collect::<Result<Vec<_>, _>>()?;
    let table = table(sources.iter().zip(&tracked));
    Ok(Page::of("driving", "evaluate tracking --parts driving", &[table]))
}

fn track(source: &Source, options: &Options, model: &ModelConfig) -> Result<Vec<Position>, EvaluateError> {
    // The sensor of this evaluation is `measured`.
    let options = &Options { noise: Noise::default(), ..options.clone() };
    let mut positions = Vec::new();
    source.play(options, model, |number, path, playing| {
        let recording = path.file_stem().unwrap_or_default().to_string_lossy();
        let run = source::run(playing.playback.interval_ns(), options, None)?;
        let mut plain = Tracker::new(tracker::settings(&run, model)?);
        let mut plain_tracks = vec![Track::zeroed(); AGENTS_MAX];
        let mut first_ns = None;
        while let Some(tick) = playing.playback.next_tick() {
            let stamp_ns = tick.header.stamp_ns;
            let time_s = (stamp_ns - *first_ns.get_or_insert(stamp_ns)) as f64 * 1e-9;
            let seen = tick.detections.iter().filter(|detection| gap(detection.id, time_s).is_none());
            let measured: Vec<Detection> =
                seen.map(|detection| measured(detection, tick.header.seq)).collect();
            let mut header = tick.header;
            header.counts.agents_len = measured.len() as u32;
            playing.chain.tick(&header, &measured, |_| ());
            let plain_count = plain.step(&header, &measured, None, &mut plain_tracks);
            let plain_count = plain_count.map_or(0, |tracked| tracked.track_count);
            let position = |track: &Track| {
                let id = track.source_id;
                let other = plain_tracks[..plain_count].iter().find(|other| other.source_id == id)?;
                let gap = gap(id, time_s)?;
                let truth_m = playing.truth.state(id, stamp_ns)?.position_m;
                let square_m2 = |track: &Track| {
                    let [x, y] = [track.x_m - truth_m[0], track.y_m - truth_m[1]].map(f64::from);
                    x * x + y * y
                };
                let agent_type = track.agent_type().ok()?;
                if let Some(lines) = &options.lines {
                    let at = |position_m: [f32; 2]| Motion {
                        position_m: position_m.map(f64::from),
                        velocity_mps: None,
                    };
                    let tracks = PRIORS.into_iter().zip([track, other].map(|of| at([of.x_m, of.y_m])));
                    lines.add(&TrackLine {
                        part: &source.name,
                        recording: &recording,
                        stamp_ns,
                        agent: id,
                        agent_type: agent_type.name(),
                        sigma_m: f64::from(SIGMA_M),
                        gap_s: GAPS_S[gap],
                        is_measured: false,
                        truth: at(truth_m),
                        tracks: tracks.collect(),
                    });
                }
                let agent = ((number as u64) << 32) + id;
                Some(Position { agent, agent_type, gap, squares_m2: [track, other].map(square_m2) })
            };
            positions.extend(playing.chain.tracks().iter().filter_map(position));
        }
        Ok(())
    })?;
    Ok(positions)
}

/// The gap that an agent is in at this time; `None` if it is detected.
fn gap(agent: u64, time_s: f64) -> Option<usize> {
    // The golden ratio spreads the agents' phases evenly over the period.
    let phase_s = PERIOD_S * (agent as f64 * 0.618_033_988_75).fract();
    let since_s = time_s + phase_s;
    let gap = (since_s / PERIOD_S) as usize % GAPS_S.len();
    let begun_s = since_s % PERIOD_S - BEGINS_S;
    (0.0..GAPS_S[gap]).contains(&begun_s).then_some(gap)
}

/// A detection as a sensor measures it that reports noisy positions only.
fn measured(detection: &Detection, seq: u64) -> Detection {
    let mut normals = Normals::new(SEED, detection.id, seq);
    let [x, y] = [0, 1].map(|_| SIGMA_M * normals.draw());
    Detection {
        x_m: detection.x_m + x,
        y_m: detection.y_m + y,
        sigma_m: SIGMA_M,
        flags: detection.flags & !(detection_flags::HAS_HEADING | detection_flags::HAS_SPEED),
        ..*detection
    }
}

/// Errors in gaps, by source, type and length of the gap.
fn table<'a>(sources: impl Iterator<Item = (&'a Source, &'a Vec<Position>)>) -> Table {
    let note = format!(
        "Root mean square of the position's error while an agent is not detected, from positions \
         alone with noise of {SIGMA_M} m: tracks with forecasts as their prior beside the kinematic prior, by the length of \
         the gap. Ratios with 95 % intervals ({RESAMPLES} resamples of agents)."
    );
    let columns = ["positions", "forecasts m", "kinematic m", "ratio"];
    let mut table = Table::new("Tracking through gaps", &note, &["source", "type", "gap s"], columns);
    for (source, positions) in sources {
        for (agent_type, gap) in
            wire::AGENT_TYPES.into_iter().flat_map(|of| (0..GAPS_S.len()).map(move |gap| (of, gap)))
        {
            let of_cell = positions.iter().filter(|of| of.agent_type == agent_type && of.gap == gap);
            let of_cell: Vec<&Position> = of_cell.collect();
            if of_cell.len() < CELL_MIN {
                continue;
            }
            let [ours, theirs] = rmse_m(&of_cell).map(|rmse_m| Some(Entry::number(rmse_m, 3)));
            let names = [&*source.name, agent_type.name(), &format!("{:.1}", GAPS_S[gap])];
            table.push(&names, [Some(Entry::count(of_cell.len())), ours, theirs, ratio(&of_cell)]);
        }
    }
    table
}

fn rmse_m(positions: &[&Position]) -> [f64; 2] {
    [0, 1].map(|prior| {
        let sum: f64 = positions.iter().map(|position| position.squares_m2[prior]).sum();
        (sum / positions.len() as f64).sqrt()
    })
}

fn ratio(positions: &[&Position]) -> Option<Entry> {
    let squares = positions.iter().map(|of| (of.agent, of.squares_m2));
    let root = |ratio: Interval| Interval {
        mean: ratio.mean.sqrt(),
        low: ratio.low.sqrt(),
        high: ratio.high.sqrt(),
    };
    Some(Entry::interval(root(ratio_of_clusters(squares)?), 3))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_agent_has_a_short_and_a_long_gap_in_two_periods() {
        for agent in 0..50 {
            let ticks = (0..1200).map(|tick| gap(agent, f64::from(tick) * 0.01));
            let mut len = [0; 2];
            ticks.flatten().for_each(|gap| len[gap] += 1);
            assert!((79..=81).contains(&len[0]) && (159..=161).contains(&len[1]), "{agent}: {len:?}");
        }
    }
}
