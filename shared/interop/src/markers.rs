//! A tick as markers of rviz: boxes, paths and labels with the colours, dashes and words of [`vocabulary`].

use wire::tick_view::{AgentView, ForecastView};
use wire::vocabulary::{self, described};
use wire::{AgentType, Quality};

use crate::autoware::{Tick, header, pose, probable_paths, size_m};
use crate::foxglove::color;
use crate::messages::{ColorRgba, Duration, Marker, MarkerArray, Point, Vector3, marker};

/// Time after which rviz removes a marker that no newer message has replaced.
const LIFETIME: Duration = Duration { sec: 1, nanosec: 0 };
/// Length in the world of a pixel of a dash. Markers have no lengths in pixels.
const DASH_M: f64 = 0.25;
/// A line that needs more repetitions of its dash is solid.
const DASHES_MAX: f64 = 200.0;
const LINE_M: f64 = 0.12;
const LINES_Z_M: f64 = 0.05;
const TEXT_M: f64 = 0.8;

/// The markers of a tick, which replace all previous ones: of each agent a box, its most probable paths, dashed by the
/// cause of its forecast, and a label.
#[must_use]
pub fn markers(view: &Tick<'_>, paths_max: usize) -> MarkerArray {
    let mut all = vec![Marker { header: header(view), action: marker::DELETEALL, ..Marker::default() }];
    for agent in &view.agents {
        let forecast = agent.forecast.as_ref();
        let mut add = |ns: &str, r#type, [x, y, z]: [f64; 3], color, more: Marker| {
            all.push(Marker {
                header: header(view),
                ns: ns.to_owned(),
                id: i32::try_from(all.len()).unwrap_or(i32::MAX),
                r#type,
                action: marker::ADD,
                scale: Vector3 { x, y, z },
                color,
                lifetime: LIFETIME,
                ..more
            });
        };
        let at = |z_m, heading_rad| pose(view.origin.own_m(agent.position_m), z_m, heading_rad);
        let size_m = size_m(agent).map(f64::from);
        let body = if agent.agent_type == AgentType::Pedestrian { marker::CYLINDER } else { marker::CUBE };
        let more = Marker { pose: at(size_m[2] / 2.0, agent.heading_rad), ..Marker::default() };
        add("agents", body, size_m, tone(forecast, 0.6), more);
        for (points, opacity) in paths(view, agent, paths_max) {
            let more = Marker { pose: pose([0.0; 2], 0.0, 0.0), points, ..Marker::default() };
            add("paths", marker::LINE_LIST, [LINE_M, 0.0, 0.0], tone(forecast, opacity), more);
        }
        let more = Marker { pose: at(size_m[2] + 0.5, 0.0), text: label(agent), ..Marker::default() };
        add("labels", marker::TEXT_VIEW_FACING, [0.0, 0.0, TEXT_M], tone(forecast, 1.0), more);
    }
    MarkerArray { markers: all }
}

/// The colour of a forecast's cause.
fn tone(forecast: Option<&ForecastView>, opacity: f64) -> ColorRgba {
    let [r, g, b, _] = color(forecast).map(|value| value as f32);
    ColorRgba { r, g, b, a: opacity as f32 }
}

/// The paths as pairs of points, each with its opacity: the more probable, the more opaque.
fn paths(view: &Tick<'_>, agent: &AgentView, paths_max: usize) -> Vec<(Vec<Point>, f64)> {
    let Some(forecast) = &agent.forecast else { return Vec::new() };
    let dash = vocabulary::look(forecast.cause).map_or(&[][..], |look| look.dash);
    let all = probable_paths(forecast, paths_max);
    let most = all.first().map_or(1.0, |(_, probability)| probability.max(f32::MIN_POSITIVE));
    let path = |(points, probability): (&[[f32; 2]], f32)| {
        let whole = std::iter::once(agent.position_m).chain(points.iter().copied());
        let whole: Vec<[f64; 2]> = whole.map(|point| view.origin.own_m(point)).collect();
        (dashed(&whole, dash), 0.25 + 0.75 * f64::from(probability / most))
    };
    all.into_iter().map(path).collect()
}

/// The begin and end of each piece of a line that is drawn with a dash.
fn dashed(line: &[[f64; 2]], dash: &[u8]) -> Vec<Point> {
    let line_m: f64 =
        line.windows(2).map(|ends| (ends[1][0] - ends[0][0]).hypot(ends[1][1] - ends[0][1])).sum();
    let mut lengths: Vec<f64> = dash.iter().map(|px| f64::from(*px) * DASH_M).collect();
    if line_m > DASHES_MAX * lengths.iter().sum::<f64>() {
        lengths.clear();
    }
    let (mut pieces, mut place) = (Vec::new(), 0);
    let mut left = lengths.first().copied().unwrap_or(f64::INFINITY);
    for ends in line.windows(2) {
        let [[ax, ay], [bx, by]] = [ends[0], ends[1]];
        let (len, mut from) = ((bx - ax).hypot(by - ay), 0.0);
        let point =
            |at: f64| Point { x: ax + (bx - ax) * at / len, y: ay + (by - ay) * at / len, z: LINES_Z_M };
        while from < len {
            let to = len.min(from + left);
            // Each second length is a gap.
            if place % 2 == 0 {
                pieces.extend([point(from), point(to)]);
            }
            left -= to - from;
            from = to;
            // A remainder may be too short to advance.
            if left <= 1e-9 {
                place = (place + 1) % lengths.len();
                left = lengths[place];
            }
        }
    }
    pieces
}

/// Type and identity, and the cause in words unless the forecast is learned.
pub(crate) fn label(agent: &AgentView) -> String {
    let name = format!("{} {}", agent.agent_type.name(), agent.known_as());
    let forecast = agent.forecast.as_ref().filter(|forecast| forecast.quality != Quality::Learned);
    forecast.map_or_else(|| name.clone(), |of| format!("{name}\n{}", described(of.quality, of.cause)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ends(line: &[[f64; 2]], dash: &[u8]) -> Vec<[f64; 2]> {
        dashed(line, dash).iter().map(|point| [point.x, point.y]).collect()
    }

    #[test]
    fn a_dash_goes_on_around_corners() {
        let line = [[0.0, 0.0], [2.0, 0.0], [2.0, 0.0], [2.0, 1.0]];
        assert_eq!(ends(&line, &[]), [[0.0, 0.0], [2.0, 0.0], [2.0, 0.0], [2.0, 1.0]]);
        // 1 m drawn, 0.5 m left out: a gap ends at 1.5 m, and the next dash goes around the corner.
        let drawn = [[0.0, 0.0], [1.0, 0.0], [1.5, 0.0], [2.0, 0.0], [2.0, 0.0], [2.0, 0.5]];
        assert_eq!(ends(&line, &[4, 2]), drawn);
        assert!(ends(&[[1.0, 1.0]], &[4, 2]).is_empty());
        assert_eq!(ends(&[[0.0, 0.0], [1e6, 0.0]], &[4, 2]), [[0.0, 0.0], [1e6, 0.0]], "too many dashes");
    }
}
