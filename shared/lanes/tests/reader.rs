//! What is read of Lanelet2 maps, and which maps are refused.

use lanes::{Coordinates, LaneMap, LaneMapError, Origin};
use wire::AgentType;

/// Two lanes side by side, one that follows the first, a crosswalk, and an island; in local coordinates.
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
        // Against the lane, which the reader turns round.
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
    assert_eq!(lanes[0].beside, [Some(2), None]);
    assert_eq!(lanes[2].beside, [None, Some(0)]);
    let solid = site().replace("'dashed'", "'solid'");
    assert_eq!(read(&solid).expect("the site").lanes()[0].beside, [None, None]);
}

#[test]
fn latitude_and_longitude_count_about_an_origin() {
    let text = site().replace("lat='' lon=''", "lat='49.0001' lon='8.4'");
    let origin = Coordinates::About(Origin::new(49.0, 8.4).expect("an origin"));
    // All nodes at one place: no lane has an area, and the first is named.
    let error = LaneMap::parse("site.osm", text.as_bytes(), origin).expect_err("no area").to_string();
    assert!(error.contains("relation 100: role `left`: way 20: 1 different nodes"), "{error}");
}

#[test]
fn broken_elements_are_named() {
    let cases = [
        ("<nd ref='12'/><tag", "<nd ref='99'/><tag", "relation 100: role `left`: way 20: node 99 is missing"),
        ("<nd ref='12'/><tag", "<nd ref='x'/><tag", "way 20: ref = \"x\": expected a whole number"),
        ("role='left' ref='20'", "role='left' ref='21'", ""),
        ("role='left' ref='20'", "role='left' ref='77'", "relation 100: role `left`: way 77 is missing"),
        (
            "role='left' ref='20'",
            "role='lift' ref='20'",
            "relation 100: 0 members of role `left`, expected 1 way",
        ),
        ("role='left' ref='20'", "role='left' ref='10'", "relation 100: ways 10 and 10 enclose no area"),
        ("ref='900'", "ref='901'", "relation 100: role `regulatory_element`: relation 901 is missing"),
        (
            "v='30 km/h'",
            "v='quick'",
            "relation 110: speed_limit = \"quick\": expected a speed such as 50 km/h",
        ),
        ("k='local_x' v='20'", "k='local_x' v='nan'", "node 11: local_x = \"nan\": expected a number"),
        ("k='local_x' v='20'", "k='local_x' v='99999'", "node 11: at 99999 m, at most"),
        ("<node id='2' ", "<node id='1' ", "node 1: a second one of this number"),
        ("<node id='2' ", "<node ", "node 0: no `id`"),
        ("<osm version='0.6'>", "<odm version='0.6'>", "site.osm:"),
        ("</osm>", "", "site.osm:"),
        ("v='lanelet'", "v='lane'", "site.osm: no lanelet"),
    ];
    for (from, to, expected) in cases {
        let text = site();
        assert!(text.contains(from), "{from}");
        let text = if from.contains("lanelet") { text.replace(from, to) } else { text.replacen(from, to, 1) };
        match read(&text) {
            Err(error) => assert!(error.to_string().contains(expected), "{error}\n{expected}"),
            Ok(_) => assert_eq!(expected, "", "{to}"),
        }
    }
    let error =
        read(&site().replacen("role='left' ref='20'", "role='left' ref='77'", 1)).expect_err("no way");
    assert_eq!(error.to_string(), "site.osm:23: relation 100: role `left`: way 77 is missing");
}

#[test]
fn deleted_elements_do_not_count() {
    let text = site().replace("<relation id='200'>", "<relation id='200' action='delete'>");
    assert_eq!(read(&text).expect("the site").lanes().len(), 4);
}
