use std::borrow::Cow;
use std::fmt;
use std::str::FromStr;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Field of view of a sensor: a sector of the ground about the ego's heading. As text `WIDTH,RANGE`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct FieldOfView {
    /// Its width, within (0, 360].
    pub width_deg: f64,
    /// Its radius, within (0, 1000].
    pub range_m: f64,
}

/// How a field of view is written.
const EXPECTED: &str = "WIDTH,RANGE, up to 360 degrees and 1000 m, as in 90,80";

/// A text that is not a field of view.
#[derive(Debug, Error, PartialEq, Eq)]
#[error("no field of view \"{0}\"")]
pub struct UnknownFieldOfView(String);

impl FromStr for FieldOfView {
    type Err = UnknownFieldOfView;

    fn from_str(text: &str) -> Result<Self, UnknownFieldOfView> {
        let number = |text: &str, most: f64| {
            let number = text.trim().parse::<f64>().ok()?;
            (number > 0.0 && number <= most).then_some(number)
        };
        let sector = text.split_once(',').and_then(|(width, range)| {
            Some(Self { width_deg: number(width, 360.0)?, range_m: number(range, 1000.0)? })
        });
        sector.ok_or_else(|| UnknownFieldOfView(text.to_owned()))
    }
}

impl fmt::Display for FieldOfView {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{},{}", self.width_deg, self.range_m)
    }
}

impl TryFrom<String> for FieldOfView {
    type Error = UnknownFieldOfView;

    fn try_from(text: String) -> Result<Self, UnknownFieldOfView> {
        text.parse()
    }
}

impl From<FieldOfView> for String {
    fn from(fov: FieldOfView) -> Self {
        fov.to_string()
    }
}

impl JsonSchema for FieldOfView {
    fn schema_name() -> Cow<'static, str> {
        "FieldOfView".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": "string", "expected": EXPECTED })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sector_is_written_as_width_and_range() {
        let fov = FieldOfView { width_deg: 81.0, range_m: 70.5 };
        assert_eq!("81, 70.5".parse(), Ok(fov));
        assert_eq!(fov.to_string().parse(), Ok(fov));
        for wrong in ["", "90", "0,80", "400,80", "90,nan", "90,-1", "90,80,2"] {
            assert_eq!(FieldOfView::from_str(wrong), Err(UnknownFieldOfView(wrong.into())));
        }
    }
}
