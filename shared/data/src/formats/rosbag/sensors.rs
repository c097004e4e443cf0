//! Topics as sensors: each topic of a bag may come from another detector.

use std::collections::BTreeMap;
use std::sync::Arc;

use wire::SENSORS_MAX;

/// The topics that are played, as they were chosen or else sorted; none if there is only one.
pub(super) fn sensors(
    topics: &BTreeMap<(usize, Arc<str>), usize>,
    chosen: &[String],
    is_played: impl Fn(usize, &str) -> bool,
) -> Vec<Arc<str>> {
    let played = topics.keys().filter(|(kind, topic)| is_played(*kind, topic)).map(|(_, topic)| topic);
    let mut played: Vec<Arc<str>> = played.cloned().collect();
    played.sort_by_key(|topic| (chosen.iter().position(|chosen| **chosen == **topic), Arc::clone(topic)));
    played.dedup();
    if played.len() > 1 { played } else { Vec::new() }
}

/// The number of the sensor whose topic is at this place among several. It is 0 for a single topic, and beyond the
/// largest number.
#[must_use]
pub fn sensor_of(place: Option<usize>) -> u8 {
    let number = place.map_or(0, |place| place + 1);
    if number <= SENSORS_MAX { number as u8 } else { 0 }
}
