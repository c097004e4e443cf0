//! The interval between sweeps, from rows whose sensors and clocks are unknown.
//!
//! The stamps alone do not show it: a sensor that stamps each of five objects 20 ms apart has the same stamps
//! as a 50 Hz sensor with a single object. But the rows of an agent recur once per sweep. With identities, an
//! agent's interval is the median time between its rows. Without identities, the next row of an agent is the
//! first later row of its type that it can have reached, unless a later row is much nearer:
//!
//! ```text
//! r(i, j) = |p_j − p_i| / (v_max (t_j − t_i) + 0.25 m)     j = first with r ≤ 1 and r ≤ min r + 0.3
//! ```
//!
//! Sensors can have different rates. The recording's interval is the interval of its fastest agents that
//! together have at least a tenth of the rows.

use std::collections::BTreeMap;

use wire::{AgentType, detection_flags};

use crate::row::Row;

/// Minimum share of all intervals that the fastest agents have: 1 / 10.
const FASTEST_SHARE: usize = 10;
/// Maximum number of rows without identity whose next row is searched, spread over the recording.
const SEARCHED_MAX: usize = 4_096;
/// Longest time to the next row of an agent without identity.
const SEARCH_NS: i64 = 2_000_000_000;
/// Shortest time to the next row. Two detections of an object in less time are of the same sweep.
const SEARCH_MIN_NS: i64 = 2_000_000;
/// Uncertainty of a position.
const POSITION_M: f32 = 0.25;
/// Margin by which a later row must be nearer to be preferred.
const NEARER: f32 = 0.3;

/// The usual interval between increasing times: the median. If short and long intervals alternate, as with
/// two sensors that detect the same agents, it is half of the median over two.
pub(crate) fn usual_ns(stamps_ns: &[i64]) -> Option<i64> {
    let median = |apart: usize| {
        let mut intervals: Vec<i64> =
            stamps_ns.windows(apart + 1).map(|window| window[apart] - window[0]).collect();
        intervals.sort_unstable();
        intervals.get(intervals.len() / 2).copied()
    };
    let single_ns = median(1)?;
    let paired_ns = median(2).map_or(single_ns, |two_ns| two_ns / 2);
    // Drifts and rounded stamps do not count as alternation.
    Some(if paired_ns < single_ns - single_ns / 10 { paired_ns } else { single_ns })
}

/// The interval between sweeps, from rows in time order; `None` if no agent has two rows.
pub(crate) fn of_sweeps_ns(rows: &[Row<'_>]) -> Option<i64> {
    let mut agents: BTreeMap<u64, Vec<i64>> = BTreeMap::new();
    let (identified, others): (Vec<&Row<'_>>, Vec<&Row<'_>>) =
        rows.iter().partition(|row| row.detection.has(detection_flags::HAS_ID));
    for row in identified {
        agents.entry(row.detection.id).or_default().push(row.stamp_ns);
    }
    let of_agent = |stamps_ns: &Vec<i64>| Some((usual_ns(stamps_ns)?, stamps_ns.len() - 1));
    let mut intervals: Vec<(i64, usize)> = agents.values().filter_map(of_agent).collect();
    let stride = others.len().div_ceil(SEARCHED_MAX).max(1);
    let searched = (0..others.len()).step_by(stride);
    intervals.extend(searched.filter_map(|place| Some((next_ns(&others[place..])?, stride))));
    fastest_ns(intervals)
}

/// The weighted median of the intervals that are about as short as the shortest ones.
fn fastest_ns(mut intervals: Vec<(i64, usize)>) -> Option<i64> {
    intervals.sort_unstable();
    let quantile = |intervals: &[(i64, usize)], share: usize| {
        let total: usize = intervals.iter().map(|(_, weight)| weight).sum();
        let mut before = 0;
        let reached = |&&(_, weight): &&(i64, usize)| {
            before += weight;
            before * share >= total
        };
        intervals.iter().find(reached).map(|(interval_ns, _)| *interval_ns)
    };
    let short_ns = quantile(&intervals, FASTEST_SHARE)?;
    intervals.retain(|(interval_ns, _)| (short_ns * 3 / 4..=short_ns * 3 / 2).contains(interval_ns));
    quantile(&intervals, 2)
}

/// The time from the first row to the next one of the same agent.
fn next_ns(rows: &[&Row<'_>]) -> Option<i64> {
    let (first, later) = rows.split_first()?;
    let speed_max_mps = match first.detection.agent_type() {
        Ok(AgentType::Vehicle) => 40.0,
        Ok(AgentType::Cyclist) => 12.0,
        _ => 4.0,
    };
    let ratio = |row: &Row<'_>| {
        let way_m = (row.detection.x_m - first.detection.x_m).hypot(row.detection.y_m - first.detection.y_m);
        way_m / (speed_max_mps * (row.stamp_ns - first.stamp_ns) as f32 * 1e-9 + POSITION_M)
    };
    let reachable = |row: &&&Row<'_>| {
        let elapsed_ns = row.stamp_ns - first.stamp_ns;
        elapsed_ns >= SEARCH_MIN_NS && row.detection.agent_type == first.detection.agent_type
    };
    let within = later.iter().take_while(|row| row.stamp_ns - first.stamp_ns <= SEARCH_NS).filter(reachable);
    let ratios: Vec<(i64, f32)> =
        within.map(|row| (row.stamp_ns, ratio(row))).filter(|(_, ratio)| *ratio <= 1.0).collect();
    let least = ratios.iter().map(|(_, ratio)| *ratio).min_by(f32::total_cmp)?;
    let next = ratios.iter().find(|(_, ratio)| *ratio <= least + NEARER)?;
    Some(next.0 - first.stamp_ns)
}
