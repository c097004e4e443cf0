//! The bridge's own part of `/diagnostics`: sentences for a monitor, during silence too.

use interop::cdr::Byte;
use interop::messages::{DiagnosticArray, DiagnosticStatus, Header, KeyValue, PredictedObjects, Time};

use crate::output::Published;
use crate::ticks::Counts;

/// Time without a tick, or without a message, that is silence; longer for slow sensors.
pub const SILENCE_NS: u64 = 1_000_000_000;
/// Levels of a status.
const OK: Byte = Byte(0);
const WARN: Byte = Byte(1);
const ERROR: Byte = Byte(2);

/// The connections of a node, as its diagnostics show them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Link {
    /// Each topic with the nodes on the other side.
    pub connections: Vec<(String, String)>,
    /// What is almost right for topics without a match.
    pub near_misses: Vec<String>,
}

/// The newest tick that was published.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Pulse {
    /// Release of the newest tick with input on `CLOCK_MONOTONIC`.
    pub input_ns: u64,
    /// Stamp of the newest tick, and when it was published on `CLOCK_MONOTONIC`.
    pub stamp_ns: i64,
    /// The same.
    pub published_ns: u64,
    /// Time between the newest two ticks.
    pub interval_ns: u64,
    /// Whether the tracks of the tick are predicted, because no detections came for it.
    pub is_predicted: bool,
}

impl Pulse {
    /// Time after the newest tick from which frames are sent without a tick. The source has then had time to have
    /// the tracks predicted.
    #[must_use]
    pub fn silence_ns(&self) -> u64 {
        silence_ns(self.interval_ns) * 3 / 2
    }
}

/// Time without a message that is silence, at this interval of the messages.
fn silence_ns(interval_ns: u64) -> u64 {
    SILENCE_NS.max(interval_ns.saturating_mul(5) / 2)
}

/// `NO INPUT for 3.1 s`.
#[must_use]
pub fn no_input(age_ns: u64) -> String {
    format!("NO INPUT for {:.1} s", age_ns as f64 / 1e9)
}

/// States in the status of a tick, the first of its diagnostics, that there is no input.
pub fn mark_silent(diagnostics: &mut DiagnosticArray, age_ns: u64) {
    if let Some(tick) = diagnostics.status.first_mut() {
        (tick.level, tick.message) = (ERROR, format!("{}: the tracks are predicted", no_input(age_ns)));
    }
}

/// The messages of a moment without a tick: explicitly no objects, and the state. No objects before the first
/// tick, because the clock of the stamps is unknown. `simulated_ns` is the time if it is simulated.
#[must_use]
pub fn silent(
    pulse: Option<&Pulse>,
    simulated_ns: Option<i64>,
    frame: &str,
    now_ns: u64,
    of_bridge: DiagnosticStatus,
) -> (Option<PredictedObjects>, DiagnosticArray) {
    let (stamp_ns, message) = match pulse {
        None => (realtime_ns(), "WAITING for input: no tick so far".to_owned()),
        Some(pulse) => {
            let after_ns = now_ns.saturating_sub(pulse.published_ns);
            (
                pulse.stamp_ns.saturating_add_unsigned(after_ns),
                no_input(now_ns.saturating_sub(pulse.input_ns)),
            )
        }
    };
    let header = header(simulated_ns.unwrap_or(stamp_ns), frame);
    let tick = status("stgdat: tick", ERROR, message, Vec::new());
    let diagnostics = DiagnosticArray { header: header.clone(), status: vec![tick, of_bridge] };
    (pulse.map(|_| PredictedObjects { header, objects: Vec::new() }), diagnostics)
}

/// The diagnostics of the source. `age_ns` is the age of the newest message.
#[must_use]
pub fn of_input(
    counts: &Counts,
    unread: u64,
    age_ns: Option<u64>,
    interval_ns: u64,
    link: &Link,
    header: Header,
) -> DiagnosticArray {
    let silence_ns = silence_ns(interval_ns);
    let Counts { messages, unplaced, dropped, other, refused, not_finite, unknown } = *counts;
    let (level, message) = match (age_ns, link.near_misses.first()) {
        (None, Some(near_miss)) => (ERROR, format!("WAITING for input: {near_miss}")),
        (None, None) => (ERROR, "WAITING for input: no message so far".to_owned()),
        (Some(age_ns), Some(near_miss)) if age_ns >= silence_ns => {
            (ERROR, format!("{}: {near_miss}", no_input(age_ns)))
        }
        (Some(age_ns), None) if age_ns >= silence_ns => (ERROR, no_input(age_ns)),
        _ if unplaced > 0 || refused > 0 || not_finite > 0 => (WARN, counts.to_string()),
        _ => (OK, "messages arrive".to_owned()),
    };
    let values = [
        ("messages", messages),
        ("messages without a transform", unplaced),
        ("messages dropped", dropped + unread),
        ("objects of other classes", other),
        ("objects with positions that are not numbers", not_finite),
        ("objects with impossible values", refused),
        ("values that count as unknown", unknown),
    ];
    let status = status("stgdat: ros2 input", level, message, with_link(&values, link));
    DiagnosticArray { header, status: vec![status] }
}

/// The diagnostics of the output, of which `left_out` objects are too old now.
#[must_use]
pub fn of_output(published: &Published, left_out: u64, link: &Link) -> DiagnosticStatus {
    let Published { sent, dropped, too_old, unpaired, since_stamp } = *published;
    let values = [
        ("published", sent),
        ("dropped", dropped),
        ("without tracks", unpaired),
        ("left out now", left_out),
        ("left out so far", too_old),
    ];
    let (level, message) = match link.near_misses.first() {
        _ if left_out > 0 => (WARN, "objects are left out: their forecasts are too old".to_owned()),
        Some(near_miss) => (WARN, near_miss.clone()),
        None => (OK, "messages are published".to_owned()),
    };
    let mut values = with_link(&values, link);
    let times = since_stamp.into_iter().flat_map(|times| ["p50", "p99", "max"].into_iter().zip(times.us()));
    values.extend(times.map(|(name, time_us)| KeyValue {
        key: format!("{name} since the stamp, ms"),
        value: format!("{:.1}", time_us as f64 / 1e3),
    }));
    status("stgdat: ros2", level, message, values)
}

fn with_link(counts: &[(&str, u64)], link: &Link) -> Vec<KeyValue> {
    let counts = counts.iter().map(|(key, count)| ((*key).to_owned(), count.to_string()));
    let all = counts.chain(link.connections.iter().cloned());
    all.map(|(key, value)| KeyValue { key, value }).collect()
}

fn status(name: &str, level: Byte, message: String, values: Vec<KeyValue>) -> DiagnosticStatus {
    DiagnosticStatus { level, name: name.to_owned(), message, values, ..DiagnosticStatus::default() }
}

/// A header of now.
#[must_use]
pub fn header_now(simulated_ns: Option<i64>, frame: &str) -> Header {
    header(simulated_ns.unwrap_or_else(realtime_ns), frame)
}

fn header(stamp_ns: i64, frame: &str) -> Header {
    let sec = i32::try_from(stamp_ns.div_euclid(1_000_000_000)).unwrap_or(i32::MAX);
    let nanosec = stamp_ns.rem_euclid(1_000_000_000) as u32;
    Header { stamp: Time { sec, nanosec }, frame_id: frame.to_owned() }
}

/// Unix time.
pub(crate) fn realtime_ns() -> i64 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    since.map_or(0, |since| i64::try_from(since.as_nanos()).unwrap_or(i64::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::since_stamp::Times;

    const S: u64 = 1_000_000_000;

    #[test]
    fn silence_is_an_explicit_empty_frame_and_a_sentence() {
        let of_bridge = || of_output(&Published::default(), 0, &Link::default());
        let pulse = Pulse {
            input_ns: 4 * S,
            stamp_ns: -500_000_000,
            published_ns: 5 * S,
            interval_ns: S / 10,
            is_predicted: true,
        };
        let (predicted, diagnostics) = silent(Some(&pulse), None, "map", 7 * S, of_bridge());
        let predicted = predicted.expect("an empty frame");
        assert_eq!((predicted.header.stamp.sec, predicted.header.stamp.nanosec), (1, 500_000_000));
        assert!(predicted.objects.is_empty());
        let tick = &diagnostics.status[0];
        assert_eq!((tick.level.0, tick.message.as_str()), (2, "NO INPUT for 3.0 s"));
        let (predicted, diagnostics) = silent(None, Some(5), "map", 7 * S, of_bridge());
        assert_eq!((predicted, diagnostics.header.stamp.nanosec), (None, 5));
        assert!(diagnostics.status[0].message.starts_with("WAITING for input"), "{diagnostics:?}");
    }

    #[test]
    fn the_time_since_the_stamp_has_its_values() {
        let values = |since_stamp| {
            let of = of_output(&Published { since_stamp, ..Published::default() }, 0, &Link::default());
            of.values
                .into_iter()
                .filter(|value| value.key.contains("stamp"))
                .map(|value| value.value)
                .collect::<Vec<_>>()
        };
        assert!(values(None).is_empty());
        let times = Times { p50_us: 21_250, p99_us: 40_000, max_us: 90_000 };
        assert_eq!(values(Some(times)), ["21.2", "40.0", "90.0"]);
    }

    #[test]
    fn the_input_is_waiting_silent_or_there_and_names_near_misses() {
        let link = Link { near_misses: vec!["nobody".to_owned()], ..Link::default() };
        let of = |age_ns, link: &Link, counts: &Counts| {
            let diagnostics = of_input(counts, 0, age_ns, S / 10, link, Header::default());
            (diagnostics.status[0].level.0, diagnostics.status[0].message.clone())
        };
        let (none, counts) = (Link::default(), Counts::default());
        assert_eq!(of(None, &link, &counts), (2, "WAITING for input: nobody".to_owned()));
        assert_eq!(of(Some(3 * S), &none, &counts), (2, "NO INPUT for 3.0 s".to_owned()));
        assert_eq!(of(Some(S / 10), &none, &counts), (0, "messages arrive".to_owned()));
        let (level, message) = of(Some(0), &none, &Counts { not_finite: 3, messages: 5, ..counts });
        assert!(level == 1 && message.contains("3 whose positions are not numbers"), "{message}");
    }
}
