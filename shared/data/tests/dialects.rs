//! Headers of the project's own format, written as by spreadsheets and other tools.

use data::{Format, Input, ReadError, Recording, Role, parse};

const PLAIN: &str = "stamp_s,id,type,x_m,y_m,heading_rad\n\
                     0.0,7,vehicle,1.5,-2.25,0.5\n0.1,7,vehicle,2.5,-2.25,0.5\n0.1,8,pedestrian,3,4,\n";

fn read(text: &str) -> Result<Recording, ReadError> {
    let input = Input::new(Role::Rows, "mine.csv", text);
    let format = Format::detect(&input)?;
    assert_eq!(format, Format::Csv, "{text}");
    parse(format, &[input])
}

#[test]
fn separators_quotes_capitals_and_synonyms_are_read() {
    let expected = read(PLAIN).unwrap().frames;
    assert_eq!((expected.len(), expected[1].detections.len()), (2, 2));
    let header = "stamp_s,id,type,x_m,y_m,heading_rad";
    let renamed = |names: &str| PLAIN.replace(header, names);
    let quoted =
        |line: &str| line.split(',').map(|value| format!("\"{value}\"")).collect::<Vec<_>>().join(",");
    for text in [
        PLAIN.replace(',', ";"),
        PLAIN.replace(',', "\t"),
        PLAIN.replace(',', " ; "),
        PLAIN.replace('\n', "\r\n"),
        format!("\u{feff}{PLAIN}"),
        format!("\u{feff}{}", PLAIN.lines().map(quoted).collect::<Vec<_>>().join("\r\n")),
        renamed("Stamp_s,ID,Type,X_M,Y_m,Heading_rad"),
        renamed(" stamp_s , id , type , x_m , y_m , heading_rad "),
        renamed("timestamp_s,track_id,class,x_m,y_m,yaw_rad"),
        PLAIN.replace("vehicle", "Vehicle"),
    ] {
        assert_eq!(read(&text).map(|recording| recording.frames).unwrap(), expected, "{text}");
    }
}

#[test]
fn an_ambiguous_name_is_answered_with_the_column_that_is_meant() {
    for (from, to, message) in [
        ("x_m", "X", "mine.csv:1:17: header = \"X\": column 4 is \"X\": did you mean x_m?"),
        ("stamp_s", "timestamp", "column 1 is \"timestamp\": did you mean stamp_s?"),
        ("stamp_s", "timestamp_ms", "did you mean stamp_s?"),
        ("heading_rad", "heading_deg", "column 6 is \"heading_deg\": did you mean heading_rad?"),
        ("heading_rad", "colour", "no such column; known are stamp_s,id"),
    ] {
        for mark in [",", ";", "\t"] {
            let error = read(&PLAIN.replace(from, to).replace(',', mark)).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
    }
    let error = read("t;x;y\n0;1;2\n").unwrap_err().to_string();
    assert!(error.contains("column 1 is \"t\": did you mean stamp_s?"), "{error}");
    let error = read("stamp_s;type;x_m;y_m\n0,1;vehicle;1,5;2\n").unwrap_err().to_string();
    assert!(error.contains("mine.csv:2:1: stamp_s = \"0,1\": a comma in a value"), "{error}");
}
