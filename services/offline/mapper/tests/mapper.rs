//! Maps of synthetic and real recordings.

use data::sets::{DataSet, Part};
use data::{Frame, Recording};
use lanes::{Coordinates, LaneMap};
use mapper::{MapError, build, of_lanes};
use testing::{public_recording, recordings_folder};
use wire::Detection;
use wire::detection_flags::{HAS_HEADING, HAS_ID, HAS_SPEED};

/// Frames `dt_ns` apart. `detections` returns the detections at a time in seconds.
fn recording(frames_len: i64, dt_ns: i64, detections: impl Fn(f32) -> Vec<Detection>) -> Recording {
    let frames = (0..frames_len).map(|k| Frame {
        stamp_ns: k * dt_ns,
        detections: detections((k * dt_ns) as f32 * 1e-9),
        ..Frame::default()
    });
    Recording { interval_ns: dt_ns as u64, frames: frames.collect(), ..Recording::default() }
}

fn detection(id: u64, x_m: f32, y_m: f32) -> Detection {
    Detection { id, x_m, y_m, score: 1.0, agent_type: 2, flags: HAS_ID, ..Detection::default() }
}

#[test]
fn a_trajectory_is_mapped_with_its_velocity() {
    // One agent at 2 m/s along y = −0.5 from x = −3.75, and one that stands.
    let site = build(&[recording(25, 100_000_000, |t| {
        vec![detection(1, -3.75 + 2.0 * t, -0.5), detection(2, 0.5, 2.5)]
    })])
    .unwrap();
    assert_eq!((site.visit_count, site.left_out_len), (50, 0));
    assert_eq!(site.map.origin_m(), [-4.0, -1.0]);
    assert_eq!((site.map.rows(), site.map.cols()), (4, 6));
    let density: Vec<f32> = site.map.density().collect();
    let velocity: Vec<[f32; 2]> = site.map.velocity_mps().collect();
    assert!((density.iter().sum::<f32>() - 1.0).abs() < 1e-6);
    // The walk crosses the lowest row with five visits per cell. The first visit has the velocity of the
    // second.
    assert!((density[1] - 5.0 / 50.0).abs() < 1e-6, "{density:?}");
    assert!((velocity[0][0] - 2.0).abs() < 1e-3 && velocity[0][1].abs() < 1e-3, "{velocity:?}");
    assert!((density[3 * 6 + 4] - 0.5).abs() < 1e-6);
    assert_eq!(velocity[3 * 6 + 4], [0.0, 0.0]);
}

#[test]
fn the_rate_of_a_recording_does_not_change_its_weight() {
    let walk =
        |dt_ns: i64, y_m: f32| recording(8_000_000_000 / dt_ns, dt_ns, move |t| vec![detection(1, t, y_m)]);
    let site = build(&[walk(100_000_000, 0.5), walk(10_000_000, 2.5)]).unwrap();
    let density: Vec<f32> = site.map.density().collect();
    let rows: Vec<f32> = density.chunks_exact(site.map.cols()).map(|row| row.iter().sum()).collect();
    assert!((rows[2] / rows[0] - 100.0 / 80.0).abs() < 1e-3, "10 Hz against a tick of 12.5 Hz: {rows:?}");
}

#[test]
fn detections_without_identity_need_heading_and_speed() {
    let heading_rad = std::f32::consts::FRAC_PI_2;
    let moving =
        Detection { flags: HAS_HEADING | HAS_SPEED, heading_rad, speed_mps: 3.0, ..detection(0, 0.5, 0.5) };
    let without_speed = Detection { flags: HAS_HEADING, ..moving };
    let site = build(&[recording(10, 100_000_000, |_| vec![moving, without_speed])]).unwrap();
    assert_eq!((site.visit_count, site.left_out_len), (10, 10));
    let velocity = site.map.velocity_mps().next().unwrap();
    assert!(velocity[0].abs() < 1e-6 && (velocity[1] - 3.0).abs() < 1e-6);
}

#[test]
fn recordings_without_visits_or_too_large_are_refused() {
    assert_eq!(build(&[]).unwrap_err(), MapError::NoVisits);
    let one_frame = recording(1, 100_000_000, |_| vec![detection(1, 0.0, 0.0)]);
    assert_eq!(build(&[one_frame]).unwrap_err(), MapError::NoVisits);
    let apart = recording(2, 100_000_000, |_| vec![detection(1, 0.0, 0.0), detection(2, 9_000.0, 9_000.0)]);
    assert_eq!(build(&[apart]).unwrap_err(), MapError::TooLarge { rows: 9_001, cols: 9_001 });
}

#[test]
fn real_recordings_make_plausible_maps() {
    for (set, folder) in [(DataSet::EthUcy, "eth_ucy"), (DataSet::Interaction, "interaction")] {
        if public_recording(folder).is_none() {
            continue;
        }
        let files = set.files(&recordings_folder(), Part::Train).unwrap();
        let path = &files[0];
        let recording = data::open(path, Some(set.format())).unwrap();
        let states: usize = data::tracks(&recording).iter().map(|track| track.states.len()).sum();
        let site = build(&[recording]).unwrap();
        assert!(
            site.visit_count <= states && site.visit_count > states / 2,
            "{} of {states}",
            site.visit_count
        );
        assert!((site.map.density().sum::<f32>() - 1.0).abs() < 1e-3);
        let fastest = site.map.velocity_mps().map(|[x, y]| x.hypot(y)).fold(0.0, f32::max);
        assert!(fastest > 0.5 && fastest < 40.0, "{fastest} m/s");
    }
}

/// A lane to the east, 4 m wide and 40 m long, with these additional tags.
fn lane(tags: &str) -> LaneMap {
    let node = |id: u8, x: f32, y: f32| {
        format!("<node id='{id}'><tag k='local_x' v='{x}'/><tag k='local_y' v='{y}'/></node>")
    };
    let text = format!(
        "<osm>{}{}{}{}<way id='5'><nd ref='1'/><nd ref='2'/></way><way id='6'><nd ref='3'/><nd ref='4'/></way>\
         <relation id='7'><member type='way' role='left' ref='5'/><member type='way' role='right' ref='6'/>\
         <tag k='type' v='lanelet'/>{tags}</relation></osm>",
        node(1, 0.0, 2.0),
        node(2, 40.0, 2.0),
        node(3, 0.0, -2.0),
        node(4, 40.0, -2.0)
    );
    LaneMap::parse("lane.osm", text.as_bytes(), Coordinates::Default).expect("a good map")
}

#[test]
fn a_lane_is_mapped_with_its_direction_and_limit() {
    let map = of_lanes(&lane("<tag k='speed_limit' v='10 m/s'/>")).unwrap();
    assert_eq!((map.origin_m(), map.cols(), map.rows()), ([0.0, -2.0], 41, 5));
    let cells = map.density().zip(map.velocity_mps());
    let visited: Vec<_> = cells.filter(|(density, _)| *density > 0.0).collect();
    assert!(visited.iter().all(|(_, [vx, vy])| (vx - 10.0).abs() < 1e-3 && vy.abs() < 1e-3), "{visited:?}");
    let density: Vec<f32> = map.density().collect();
    let at = |row: usize| density[row * map.cols() + 20];
    assert!(at(2) > at(0) && at(1) > at(0), "more in the middle");
}

#[test]
fn a_map_without_roads_is_refused() {
    assert_eq!(of_lanes(&lane("<tag k='subtype' v='crosswalk'/>")), Err(MapError::NoRoads));
}
