//! The meaning of Lanelet2 tags: <https://github.com/fzi-forschungszentrum-informatik/Lanelet2>, tagging.

use wire::AgentType;

use crate::Users;
use crate::osm::Tags;

/// Highest speed limit that a map may set.
const LIMIT_MAX_MPS: f32 = 70.0;
/// The limit `walk` of OSM.
const WALK_MPS: f32 = 7.0 / KMH_PER_MPS;
const KMH_PER_MPS: f32 = 3.6;
const MPS_PER_MPH: f32 = 0.447_04;

/// The agents that use a lanelet. The `participant` tags name them; without these tags they are the usual
/// agents of the subtype. Unusual values are added to `odd`.
pub(crate) fn users(tags: Tags<'_>, odd: &mut Vec<String>) -> Users {
    use AgentType::{Cyclist, Pedestrian, Vehicle};
    let mut named = false;
    let mut types = Vec::new();
    for (key, value) in tags.iter() {
        let Some(participant) = key.strip_prefix("participant:") else { continue };
        let all: &[AgentType] = match participant.split(':').next().unwrap_or_default() {
            "vehicle" => &[Vehicle],
            "bicycle" => &[Cyclist],
            "pedestrian" => &[Pedestrian],
            _ => continue,
        };
        // `no` removes only the named participant.
        match tags.yes(key) {
            Ok(yes) => {
                named = true;
                types.extend_from_slice(if yes == Some(true) { all } else { &[] });
            }
            Err(_) => odd.push(format!("{key} = \"{}\": expected yes or no", crate::osm::shortened(value))),
        }
    }
    let usual: &[AgentType] = match tags.get("subtype") {
        Some("crosswalk" | "walkway" | "stairs" | "pedestrian_lane") => &[Pedestrian],
        Some("shared_walkway") => &[Pedestrian, Cyclist],
        Some("bicycle_lane") => &[Cyclist],
        Some("play_street") => &[Vehicle, Cyclist, Pedestrian],
        Some("highway" | "bus_lane" | "emergency_lane" | "road_shoulder") => &[Vehicle],
        Some("rail") => &[],
        _ => &[Vehicle, Cyclist],
    };
    Users::of(if named { &types } else { usual })
}

/// Whether a lanelet is used only in its own direction. The default is `true` for roads and `false` for ways
/// of pedestrians. An unusual value is added to `odd`.
pub(crate) fn is_one_way(tags: Tags<'_>, odd: &mut Vec<String>) -> bool {
    let of_subtype = !matches!(
        tags.get("subtype"),
        Some("crosswalk" | "walkway" | "shared_walkway" | "stairs" | "pedestrian_lane")
    );
    let own = tags.yes("one_way").unwrap_or_else(|why| {
        odd.push(why);
        None
    });
    own.unwrap_or(of_subtype)
}

/// Whether a vehicle may cross a bound. `side` is 0 if the bound is on the vehicle's left and 1 on its right.
/// `is_along` is set if the line runs in the vehicle's direction.
pub(crate) fn may_cross(tags: Tags<'_>, side: usize, is_along: bool) -> bool {
    let permits = |key: &str| tags.yes(key).ok().flatten();
    // A vehicle that crosses a line on its left moves from the line's right to its left, if the line runs
    // along.
    let goes_left = (side == 0) == is_along;
    let of_direction = permits(if goes_left { "lane_change:left" } else { "lane_change:right" });
    if let Some(allowed) = of_direction.or_else(|| permits("lane_change")) {
        return allowed;
    }
    match (tags.get("type"), tags.get("subtype")) {
        (Some("line_thin" | "line_thick"), Some("dashed")) => true,
        // The half nearer to the vehicle counts. The subtype names the left half first, in the line's
        // direction.
        (Some("line_thin" | "line_thick"), Some("dashed_solid")) => !goes_left,
        (Some("line_thin" | "line_thick"), Some("solid_dashed")) => goes_left,
        _ => false,
    }
}

/// The limit if no tag sets one: 50 km/h in towns and 100 km/h elsewhere; `None` for ways of pedestrians.
pub(crate) fn usual_limit_mps(tags: Tags<'_>) -> Option<f32> {
    match (tags.get("subtype"), tags.get("location")) {
        (Some("crosswalk" | "walkway" | "shared_walkway" | "stairs" | "pedestrian_lane"), _) => None,
        (_, Some("nonurban")) => Some(100.0 / KMH_PER_MPS),
        _ => Some(50.0 / KMH_PER_MPS),
    }
}

/// Parses a speed as maps write it: `50`, `50 km/h`, `30kmh`, `25mph`, `13.9 m/s`, `walk`. The default unit
/// is km/h.
pub(crate) fn speed_mps(text: &str) -> Option<f32> {
    let text = text.trim();
    if text == "walk" {
        return Some(WALK_MPS);
    }
    let end = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
    let (number, unit) = text.split_at(end);
    let number: f32 = number.parse().ok()?;
    let mps = match unit.trim().to_ascii_lowercase().as_str() {
        "" | "km/h" | "kmh" | "kph" => number / KMH_PER_MPS,
        "mph" => number * MPS_PER_MPH,
        "m/s" | "mps" => number,
        _ => return None,
    };
    (mps > 0.0 && mps <= LIMIT_MAX_MPS).then_some(mps)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn speeds_have_their_units() {
        for (text, mps) in [
            ("50", 13.889),
            ("50 km/h", 13.889),
            ("30kmh", 8.333),
            ("25mph", 11.176),
            ("7 m/s", 7.0),
            ("50 mph", 22.352),
            ("walk", 1.944),
        ] {
            let found = speed_mps(text).expect("a speed");
            assert!((found - mps).abs() < 1e-3, "{text}: {found}");
        }
        for text in ["", "fast", "none", "de274", "0", "-5", "999 km/h", "50 knots"] {
            assert_eq!(speed_mps(text), None, "{text}");
        }
    }
}
