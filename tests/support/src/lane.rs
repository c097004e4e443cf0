//! A map of one lane.

/// A Lanelet2 map (OSM XML) of one lane to the east, 200 m long and 3.5 m wide. The lane starts at a point of
/// the local frame (m).
#[must_use]
pub fn lane([x0, y0]: [f64; 2]) -> String {
    let (mut nodes, mut ways) = (String::new(), String::new());
    for (side, across) in [(1, 1.75), (2, -1.75)] {
        ways += &format!("<way id='{side}'>");
        for place in 0..21 {
            let (id, x, y) = (100 * side + place, x0 + 10.0 * f64::from(place), y0 + across);
            nodes += &format!(
                "<node id='{id}' lat='' lon=''><tag k='local_x' v='{x}'/><tag k='local_y' v='{y}'/></node>\n"
            );
            ways += &format!("<nd ref='{id}'/>");
        }
        ways += "<tag k='type' v='line_thin'/></way>\n";
    }
    format!(
        "<osm>\n{nodes}{ways}<relation id='9'><member type='way' ref='1' role='left'/>\
         <member type='way' ref='2' role='right'/><tag k='type' v='lanelet'/><tag k='subtype' v='road'/>\
         </relation></osm>\n"
    )
}
