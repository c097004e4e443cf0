//! Forecasts of vehicles on a map of lanes.

use serde::{Deserialize, Serialize};
use wire::Forecast;

use crate::input::DOUBT;

/// Share of the forecasts along lanes below which the map is doubtful.
const SHARE_MIN: f64 = 0.02;
/// Smallest number of forecasts for a doubt.
const FORECASTS_MIN: u64 = 10;

/// Forecasts of vehicles by their place on a map of lanes. The counts are 0 without a map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct LaneCounts {
    /// Number of forecasts along lanes.
    pub along: u64,
    /// Number of forecasts of moving vehicles that are on no lane.
    pub off: u64,
}

impl LaneCounts {
    /// Counts forecasts.
    pub fn add(&mut self, forecasts: &[Forecast]) {
        let count = |lanes: u32| forecasts.iter().filter(|forecast| forecast.lanes == lanes).count() as u64;
        self.along += count(Forecast::ALONG_LANES);
        self.off += count(Forecast::OFF_LANES);
    }

    /// The counts in words; `None` if there are none.
    #[must_use]
    pub fn line(&self) -> Option<String> {
        let Self { along, off } = self;
        (along + off > 0)
            .then(|| format!("{along} forecasts along lanes, {off} of moving vehicles that are on no lane"))
    }

    /// The doubt as a reason of a verdict.
    #[must_use]
    pub fn reason(&self) -> Option<String> {
        self.doubt().map(|doubt| format!("{DOUBT}{doubt}"))
    }

    /// Why the map probably belongs to another place; `None` if vehicles are on its lanes.
    #[must_use]
    pub fn doubt(&self) -> Option<String> {
        let Self { along, off } = *self;
        let is_doubtful = along + off >= FORECASTS_MIN && (along as f64) < SHARE_MIN * (along + off) as f64;
        is_doubtful.then(|| {
            let found = match along {
                0 => "no vehicle has been on a lane of the map".to_owned(),
                _ => format!("{along} of {} forecasts of vehicles are on a lane of the map", along + off),
            };
            format!(
                "{found}: check that --lanes is the map of this place, and in the frame of the detections \
                 (--lanes-origin, --origin)"
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;

    use super::*;

    fn counts(along: usize, off: usize) -> LaneCounts {
        let of = |lanes: u32| Forecast { lanes, ..Forecast::zeroed() };
        let [along, off] = [(along, Forecast::ALONG_LANES), (off, Forecast::OFF_LANES)]
            .map(|(count, lanes)| std::iter::repeat_with(move || of(lanes)).take(count));
        let forecasts: Vec<Forecast> = along.chain(off).chain([of(0)]).collect();
        let mut counts = LaneCounts::default();
        counts.add(&forecasts);
        counts
    }

    #[test]
    fn a_map_that_no_vehicle_touches_is_doubted() {
        let found = counts(0, 150);
        assert_eq!(found, LaneCounts { along: 0, off: 150 });
        assert_eq!(
            found.line().as_deref(),
            Some("0 forecasts along lanes, 150 of moving vehicles that are on no lane")
        );
        assert!(
            found.doubt().is_some_and(|doubt| doubt.starts_with("no vehicle has been on a lane of the map"))
        );
        let few = counts(2, 148).doubt();
        assert!(few.is_some_and(|doubt| doubt.starts_with("2 of 150 forecasts of vehicles are on a lane")));
    }

    #[test]
    fn a_map_with_traffic_is_not_doubted() {
        for (along, off) in [(0, 0), (0, 9), (150, 0), (3, 147), (10, 90)] {
            assert_eq!(counts(along, off).doubt(), None, "{along} {off}");
        }
        assert_eq!(counts(0, 0).line(), None);
    }
}
