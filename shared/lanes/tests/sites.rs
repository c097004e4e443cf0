//! The sites of INTERACTION: recorded vehicles are on the lanes of their maps.

use lanes::{Coordinates, LaneMap, Routes};
use testing::public_recording;
use wire::AgentType;

/// The sites, held-out ones first.
const SITES: [&str; 5] = [
    "DR_USA_Roundabout_FT",
    "DR_USA_Intersection_EP1",
    "DR_USA_Roundabout_SR",
    "DR_USA_Intersection_GL",
    "DR_CHN_Roundabout_LN",
];

#[test]
fn recorded_vehicles_are_on_the_lanes_of_their_site() {
    for site in SITES {
        let name = format!("interaction/recorded_trackfiles/{site}/vehicle_tracks_000.csv");
        let map = public_recording(&format!("interaction/maps/{site}.osm"));
        let (Some(map), Some(recording)) = (map, public_recording(&name)) else { return };
        let map = LaneMap::open(&map, Coordinates::Default).expect("a good map");
        let recording = data::open(&recording, None).expect("a good recording");
        let mut routes = Routes::default();
        let (mut moving, mut found, mut offsets_m) = (0, 0, Vec::new());
        for detection in recording.frames.iter().step_by(10).flat_map(|frame| &frame.detections) {
            if detection.speed_mps < 0.5 || detection.agent_type != AgentType::Vehicle as u32 {
                continue;
            }
            moving += 1;
            let position_m = [detection.x_m, detection.y_m];
            routes.find(&map, AgentType::Vehicle, position_m, detection.heading_rad, 30.0);
            if let Some(route) = routes.as_slice().first() {
                found += 1;
                offsets_m.push(route.offset_m.abs());
            }
        }
        offsets_m.sort_by(f32::total_cmp);
        let median_m = offsets_m[offsets_m.len() / 2];
        assert!(moving > 100 && f64::from(found) > 0.95 * f64::from(moving), "{site}: {found} of {moving}");
        assert!(median_m < 1.3, "{site}: {median_m} m from the middle");
    }
}
