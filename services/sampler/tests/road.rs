use lanes::{Coordinates, LaneMap};

/// A lane of 4 m along the x axis, which the agents are on.
pub fn road() -> LaneMap {
    let node = |id: u8, x: f32, y: f32| {
        format!("<node id='{id}'><tag k='local_x' v='{x}'/><tag k='local_y' v='{y}'/></node>")
    };
    let nodes = node(1, -9.0, 2.5) + &node(2, 200.0, 2.5) + &node(3, -9.0, -1.5) + &node(4, 200.0, -1.5);
    let text = format!(
        "<osm>{nodes}<way id='5'><nd ref='1'/><nd ref='2'/></way><way id='6'><nd ref='3'/><nd ref='4'/></way>\
         <relation id='7'><member type='way' role='left' ref='5'/><member type='way' role='right' ref='6'/>\
         <tag k='type' v='lanelet'/></relation></osm>"
    );
    LaneMap::parse("road.osm", text.as_bytes(), Coordinates::Default).expect("a good map")
}
