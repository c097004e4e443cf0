//! The content that is read from Lanelet2 maps, and the maps that are refused.

use lanes::{Coordinates, LaneMap, LaneMapError, Origin, SkippedKind};
use wire::AgentType;

/// Two lanes side by side, a successor of the first, a crosswalk and an island, in local coordinates.
///
/// ```text
///   3 ── 13 ── 23      y = 6       way 30: solid
///        lane 200
///   2 ── 12            y = 3       way 20: dashed
///   lane 100   110
///   1 ── 11 ── 21      y = 0       way 10, 11: solid
/// ```
fn site() -> String {
    let mut text = "<?xml version='1.0'?>\n<osm version='0.6'>\n".to_owned();
    let nodes = [
        (1, 0, 0),
        (2, 0, 3),
        (3, 0, 6),
        (11, 20, 0),
        (12, 20, 3),
        (13, 20, 6),
        (21, 40, 0),
        (22, 40, 3),
        (31, 10, -4),
        (32, 10, 10),
        (33, 12, -4),
        (34, 12, 10),
    ];
    for (id, x, y) in nodes {
        text += &format!(
            "<node id='{id}' lat='' lon=''><tag k='local_x' v='{x}'/><tag k='local_y' v='{y}'/></node>\n"
        );
    }
    let ways: [(i64, &[i64], &str); 8] = [
        (10, &[1, 11], "solid"),
        (20, &[2, 12], "dashed"),
        (30, &[3, 13], "solid"),
        (11, &[11, 21], "solid"),
        // Against the lane; the reader reverses these.
        (21, &[22, 12], "solid"),
        (41, &[31, 32], "solid"),
        (42, &[33, 34], "solid"),
        (50, &[31, 33, 34, 31], "solid"),
    ];
    for (id, nodes, subtype) in ways {
        text += &format!("<way id='{id}'>");
        nodes.iter().for_each(|node| text += &format!("<nd ref='{node}'/>"));
        text += &format!("<tag k='type' v='line_thin'/><tag k='subtype' v='{subtype}'/></way>\n");
    }
    let lanelet = |id: i64, left: i64, right: i64, tags: &str| {
        format!(
            "<relation id='{id}'><member type='way' role='left' ref='{left}'/>\
             <member type='way' role='right' ref='{right}'/>{tags}<tag k='type' v='lanelet'/></relation>\n"
        )
    };
    text += &lanelet(
        100,
        20,
        10,
        "<member type='relation' role='regulatory_element' ref='900'/><tag k='subtype' v='road'/>",
    );
    text += &lanelet(110, 21, 11, "<tag k='subtype' v='road'/><tag k='speed_limit' v='30 km/h'/>");
    text += &lanelet(200, 30, 20, "<tag k='subtype' v='road'/>");
    text += &lanelet(300, 41, 42, "<tag k='subtype' v='crosswalk'/>");
    text += "<relation id='400'><member type='way' role='outer' ref='50'/><tag k='type' v='multipolygon'/>\
             <tag k='subtype' v='keepout'/></relation>\n";
    text += "<relation id='900'><tag k='type' v='regulatory_element'/><tag k='subtype' v='speed_limit'/>\
             <tag k='sign_type' v='25mph'/></relation>\n</osm>\n";
    text
}

fn read(text: &str) -> Result<LaneMap, LaneMapError> {
    LaneMap::parse("site.osm", text.as_bytes(), Coordinates::Default)
}

#[test]
fn lanes_have_length_width_limit_and_users() {
    let map = read(&site()).expect("the site");
    let ids: Vec<i64> = map.lanes().iter().map(|lane| lane.id).collect();
    assert_eq!(ids, [100, 110, 200, 300, 300], "a crosswalk is used both ways");
    let lane = &map.lanes()[0];
    assert!((lane.length_m() - 20.0).abs() < 1e-3);
    assert!(lane.centre_m.iter().all(|[_, y]| (y - 1.5).abs() < 1e-5));
    assert!(lane.half_width_m.iter().all(|half| (half - 1.5).abs() < 1e-5));
    assert!(lane.users.contain(AgentType::Vehicle) && !lane.users.contain(AgentType::Pedestrian));
    assert!(map.lanes()[3].users.contain(AgentType::Pedestrian));
    let limits: Vec<_> = map.lanes().iter().map(|lane| lane.limit_mps.map(|v| (v * 3.6).round())).collect();
    assert_eq!(limits, [Some(40.0), Some(30.0), Some(50.0), None, None]);
    assert!(map.areas()[0].is_keepout && map.areas()[0].contains([11.5, 0.0]));
    assert!(!map.areas()[0].contains([9.0, 0.0]));
}

#[test]
fn lanes_follow_and_lie_beside_one_another() {
    let map = read(&site()).expect("the site");
    let lanes = map.lanes();
    assert_eq!(lanes[0].successors, [1]);
    assert!(lanes[1].successors.is_empty());
    assert_eq!(lanes[0].neighbours, [Some(2), None]);
    assert_eq!(lanes[2].neighbours, [None, Some(0)]);
    let solid = site().replace("'dashed'", "'solid'");
    assert_eq!(read(&solid).expect("the site").lanes()[0].neighbours, [None, None]);
}

#[test]
fn latitude_and_longitude_count_about_an_origin() {
    let text = site().replace("lat='' lon=''", "lat='49.0001' lon='8.4'");
    let origin = Coordinates::About(Origin::new(49.0, 8.4).expect("an origin"));
    // All nodes are at one place: no lane has an area, and the error names the first one.
    let error = LaneMap::parse("site.osm", text.as_bytes(), origin).expect_err("no area").to_string();
    assert!(error.contains("relation 100: role `left`: way 20: 1 different nodes"), "{error}");
}

#[test]
fn maps_without_a_usable_lane_are_refused() {
    let cases = [
        ("<osm version='0.6'>", "<odm version='0.6'>", "site.osm:"),
        ("</osm>", "", "site.osm:"),
        ("v='lanelet'", "v='lane'", "site.osm: no lanelet"),
        ("role='left'", "role='lift'", "site.osm:23: relation 100: 0 members of role `left`, expected 1 way"),
    ];
    for (from, to, expected) in cases {
        let error = read(&site().replace(from, to)).expect_err(to).to_string();
        assert!(error.starts_with(expected), "{error}\n{expected}");
    }
}

/// Edits of the site, the kind of content skipped as a result, the first fault, and the remaining lanelets.
const SKIPPED: [(&str, &str, SkippedKind, &str, &[i64]); 13] = [
    (
        "<nd ref='12'/><tag",
        "<nd ref='99'/><tag",
        SkippedKind::Lanelet,
        "relation 100: role `left`: way 20: node 99 is missing",
        &[110, 300, 300],
    ),
    (
        "<nd ref='12'/><tag",
        "<nd ref='x'/><tag",
        SkippedKind::Lanelet,
        "relation 100: role `left`: way 20: ref = \"x\": expected a whole number",
        &[110, 300, 300],
    ),
    (
        "<nd ref='12'/><tag",
        "<tag",
        SkippedKind::Lanelet,
        "relation 100: role `left`: way 20: 1 different nodes, at least 2 make a line",
        &[110, 300, 300],
    ),
    (
        "role='left' ref='20'",
        "role='left' ref='77'",
        SkippedKind::Lanelet,
        "relation 100: role `left`: way 77 is missing",
        &[110, 200, 300, 300],
    ),
    (
        "role='left' ref='20'",
        "role='lift' ref='20'",
        SkippedKind::Lanelet,
        "relation 100: 0 members of role `left`, expected 1 way",
        &[110, 200, 300, 300],
    ),
    (
        "role='left' ref='20'",
        "role='left' ref='10'",
        SkippedKind::Lanelet,
        "relation 100: ways 10 and 10 enclose no area",
        &[110, 200, 300, 300],
    ),
    (
        "<way id='11'>",
        "<way id='10'>",
        SkippedKind::Lanelet,
        "relation 100: role `right`: way 10 is there twice",
        &[200, 300, 300],
    ),
    ("<node id='23' ", "<node ", SkippedKind::Element, "node 0: no `id`", &[100, 110, 200, 300, 300]),
    (
        "ref='900'",
        "ref='901'",
        SkippedKind::Rule,
        "relation 100: relation 901 is missing",
        &[100, 110, 200, 300, 300],
    ),
    (
        "v='30 km/h'",
        "v='none'",
        SkippedKind::Limit,
        "relation 110: speed_limit = \"none\" is not a speed",
        &[100, 110, 200, 300, 300],
    ),
    (
        "v='25mph'",
        "v='de274'",
        SkippedKind::Limit,
        "relation 900: sign_type = \"de274\" is not a speed",
        &[100, 110, 200, 300, 300],
    ),
    (
        "<tag k='speed_limit'",
        "<tag k='one_way' v='maybe'/><tag k='participant:vehicle' v='only'/><tag k='speed_limit'",
        SkippedKind::Tag,
        "relation 110: participant:vehicle = \"only\": expected yes or no",
        &[100, 110, 200, 300, 300],
    ),
    (
        "role='outer' ref='50'",
        "role='outer' ref='51'",
        SkippedKind::Area,
        "relation 400: role `outer`: way 51 is missing",
        &[100, 110, 200, 300, 300],
    ),
];

#[test]
fn what_cannot_be_used_is_skipped_counted_and_named() {
    assert_eq!(read(&with_node_23()).expect("the site").skipped().warnings().count(), 0);
    for (from, to, kind, first, remaining) in SKIPPED {
        let text = with_node_23();
        assert!(text.contains(from), "{from}");
        let map = read(&text.replacen(from, to, 1)).expect(to);
        let ids: Vec<i64> = map.lanes().iter().map(|lane| lane.id).collect();
        assert_eq!(ids, remaining, "{to}");
        assert!(map.skipped().count(kind) >= 1, "{to}");
        let warnings: Vec<String> = map.skipped().warnings().collect();
        assert!(warnings.iter().any(|warning| warning.contains(first)), "{warnings:?}\n{first}");
    }
}

/// The site with an additional node that no lane needs.
fn with_node_23() -> String {
    site().replace("<way id='10'>", "<node id='23' lat='1' lon='1'/>\n<way id='10'>")
}

#[test]
fn limits_and_directions_that_are_skipped_are_the_usual_ones() {
    let text = site().replace("v='30 km/h'", "v='none'/><tag k='one_way' v='maybe'").replace("25mph", "fast");
    let map = read(&text).expect("the site");
    let limits: Vec<_> = map.lanes().iter().map(|lane| lane.limit_mps.map(|v| (v * 3.6).round())).collect();
    assert_eq!(limits, [Some(50.0), Some(50.0), Some(50.0), None, None]);
    assert!(map.lanes()[1].users.contain(AgentType::Vehicle));
}

#[test]
fn content_that_lanes_do_not_need_is_counted_whatever_it_is() {
    let mut extra = "<node id='900' lat='1' lon='1'><tag k='local_x' v='100000'/><tag k='local_y' v='nan'/></node>\n\
                     <node id='901'/><node id='901'/><way id='90'><nd ref='900'/></way><way id='91'><nd/></way>\n\
                     <relation id='910'><member type='area' ref='x'/><tag k='type' v='regulatory_element'/>\
                     <member type='way' role='refers' ref='12345'/></relation>\n<relation id='911'>"
        .to_owned();
    (0..10_050).for_each(|node| extra += &format!("<member type='node' ref='{node}' role='x'/>"));
    extra += "<tag k='type' v='site'/></relation>\n</osm>";
    let map = read(&site().replace("</osm>", &extra)).expect("the site");
    assert_eq!(map.lanes().len(), 5);
    assert_eq!(map.skipped().unneeded(), [2, 2, 2]);
    assert_eq!(read(&site()).expect("the site").skipped().unneeded(), [0, 0, 0]);
}

#[test]
fn nodes_of_lanes_without_a_position_are_refused() {
    let x = "<tag k='local_x' v='20'/><tag k='local_y' v='3'/>";
    let cases = [
        ("", "site.osm:7: node 12: no `local_x`, which other nodes of lanes have"),
        ("<tag k='local_y' v='3'/>", "site.osm:7: node 12: no `local_x`, which other nodes of lanes have"),
        ("<tag k='local_x' v='20'/>", "site.osm:7: node 12: no `local_y`, which other nodes of lanes have"),
        (
            "<tag k='local_x' v='20'/><tag k='local_y' v='NaN'/>",
            "node 12: local_y = \"NaN\": expected a number",
        ),
        ("<tag k='local_x' v='1e999'/><tag k='local_y' v='3'/>", "node 12: local_x = \"1e999\": expected"),
        ("<tag k='local_x' v='east'/><tag k='local_y' v='3'/>", "node 12: local_x = \"east\": expected"),
    ];
    for (tags, expected) in cases {
        assert!(site().contains(x));
        let error = read(&site().replace(x, tags)).expect_err(tags).to_string();
        assert!(error.contains(expected), "{error}\n{expected}");
    }
    let two = site().replace("k='local_x' v='20'", "k='x' v='20'");
    let error = read(&two).expect_err("three nodes").to_string();
    assert!(
        error.contains("node 11: no `local_x`")
            && error.ends_with("and 2 more nodes of lanes have no position")
    );
}

/// The site with different coordinates of all nodes: `place` maps the local coordinates.
fn moved(place: impl Fn(f64, f64) -> String) -> String {
    let text = site();
    let mut lines = text.lines().map(|line| {
        let value = |key: &str| {
            let rest = line.split_once(&format!("k='{key}' v='"))?.1;
            rest.split_once('\'')?.0.parse::<f64>().ok()
        };
        match (value("local_x"), value("local_y"), line.split_once(" lat")) {
            (Some(x), Some(y), Some((head, _))) => format!("{head} {}", place(x, y)),
            _ => line.to_owned(),
        }
    });
    lines.by_ref().collect::<Vec<_>>().join("\n")
}

/// The site with local tags and its corner at a given position of the map's own frame.
fn local_at([x0, y0]: [f64; 2]) -> String {
    moved(|x, y| format!("><tag k='local_x' v='{}'/><tag k='local_y' v='{}'/></node>", x0 + x, y0 + y))
}

fn read_with(text: &str, origin: &str) -> Result<LaneMap, LaneMapError> {
    LaneMap::parse("site.osm", text.as_bytes(), origin.parse().expect("an origin"))
}

#[test]
fn an_origin_in_metres_is_subtracted_before_rounding() {
    let plain = read(&site()).expect("the site");
    for (corner, origin) in [
        ([81_596.25, 50_194.5], "81596.25,50194.5m"),
        ([97_000.0, 96_000.0], "97000,96000m"),
        ([458_000.0, 5_428_000.0], "458000,5428000m"),
        ([-40_000.0, -70_000.0], "-40000,-70000m"),
    ] {
        let map = read_with(&local_at(corner), origin).expect("the site");
        for (lane, expected) in map.lanes().iter().zip(plain.lanes()) {
            assert_eq!(lane.bounds_m, expected.bounds_m);
            assert_eq!(lane.centre_m, expected.centre_m);
            assert_eq!(lane.successors, expected.successors);
        }
        // A difference of 1/8 mm from the origin is kept. f32 would lose it at these coordinates.
        let near = [corner[0] - 0.000_125, corner[1]];
        let map = read_with(&local_at(corner), &format!("{},{}m", near[0], near[1])).expect("the site");
        let shift_m = map.lanes()[0].bounds_m[1][0][0];
        assert!((shift_m - 0.000_125).abs() < 1e-6, "{shift_m}");
    }
}

#[test]
fn maps_out_of_reach_are_refused_with_a_fitting_origin() {
    for (corner, fitting) in [
        ([81_596.0, 50_194.0], "--lanes-origin 81000,50000m, or --origin 81000,50000 if"),
        ([-40_500.0, 10.0], "--lanes-origin -41000,0m"),
        ([458_100.0, 5_428_900.0], "--lanes-origin 458000,5428000m"),
    ] {
        let text = local_at(corner);
        let error = read(&text).expect_err("too far").to_string();
        assert!(error.contains("beyond ±32768 m of the origin") && error.contains(fitting), "{error}");
        let origin = fitting.split_once(' ').map(|(_, rest)| rest.split_once('m').expect("metres").0);
        let origin = format!("{}m", origin.expect("an origin"));
        assert_eq!(read_with(&text, &origin).expect("the named origin fits").lanes().len(), 5);
    }
    let north = |x: f64, y: f64| format!("lat='{}' lon='{}'/>", 49.012 + y / 111_000.0, 8.424 + x / 73_000.0);
    let error = read(&moved(north)).expect_err("too far").to_string();
    assert!(
        error.contains("node 2: at lat 49.012") && error.ends_with("--lanes-origin 49.01,8.42"),
        "{error}"
    );
    let map = read_with(&moved(north), "49.01,8.42").expect("the named origin fits");
    assert!((map.lanes()[0].length_m() - 20.0).abs() < 0.1);
}

#[test]
fn one_lanelet_out_of_reach_is_skipped() {
    let text = site().replace("k='local_x' v='40'", "k='local_x' v='99999'");
    let map = read(&text).expect("the other lanes");
    assert_eq!(map.lanes().iter().map(|lane| lane.id).collect::<Vec<_>>(), [100, 200, 300, 300]);
    let warnings: Vec<String> = map.skipped().warnings().collect();
    let [warning] = &warnings[..] else { panic!("{warnings:?}") };
    assert!(warning.ends_with("node 22: at 99999, 3, beyond ±32768 m of the origin"), "{warning}");
}

#[test]
fn a_map_in_degrees_less_metres_is_in_utm() {
    // The CN Tower is at 17T 630084 4833438.
    let text =
        moved(|x, y| format!("lat='{}' lon='{}'/>", 43.642_567 + y / 111_000.0, -79.387_139 + x / 80_700.0));
    let map = read_with(&text, "630084,4833438m").expect("the site");
    let [x, y] = map.lanes()[0].bounds_m[1][0];
    assert!(x.abs() < 1.0 && y.abs() < 1.0, "{x} {y}");
    // A map near 0, 0 stays there.
    let text =
        moved(|x, y| format!("lat='{}' lon='{}'/>", (y + 1000.0) / 110_600.0, (x + 1000.0) / 111_300.0));
    let [plain, less] = [read(&text), read_with(&text, "1000,1000m")].map(|map| map.expect("the site"));
    let [a, b] = [&plain, &less].map(|map| map.lanes()[0].centre_m[0]);
    assert!((a[0] - b[0] - 1000.0).abs() < 1e-3 && (a[1] - b[1] - 1000.0).abs() < 1e-3, "{a:?} {b:?}");
}

#[test]
fn an_origin_in_degrees_takes_precedence_over_local_tags() {
    let text = moved(|x, y| {
        let (lat, lon) = (35.688_55 + y / 110_950.0, 139.691_42 + x / 90_500.0);
        format!("lat='{lat}' lon='{lon}'><tag k='local_x' v='81596'/><tag k='local_y' v='50194'/></node>")
    });
    let map = read_with(&text, "35.68855,139.69142").expect("the site");
    let lane = &map.lanes()[0];
    assert!((lane.length_m() - 20.0).abs() < 0.1, "{}", lane.length_m());
    assert!(lane.centre_m[0].iter().all(|x| x.abs() < 3.0), "{:?}", lane.centre_m[0]);
}

#[test]
fn deleted_elements_do_not_count() {
    let text = site().replace("<relation id='200'>", "<relation id='200' action='delete'>");
    assert_eq!(read(&text).expect("the site").lanes().len(), 4);
}

#[test]
fn an_element_with_very_many_attributes_is_refused() {
    for (count, is_refused) in [(200, false), (200_000, true)] {
        let attributes: String = (0..count).map(|number| format!(" a{number}='='")).collect();
        let text = format!("<osm>\n<node{attributes}/></osm>");
        let error = LaneMap::parse("a.osm", text.as_bytes(), Coordinates::Default).unwrap_err().to_string();
        let is_named = error.starts_with("a.osm:2") && error.contains("more than 256 attributes");
        assert_eq!(is_named, is_refused, "{error}");
    }
}
