//! When the input arrived: silence, silent types and a slow detector.
//!
//! The absence of input is a state with a name and an age. [`Arrivals`] knows when the source has released ticks,
//! from the headers of the forecasts and from the source's heartbeats. Predicted ticks are no input.
//!
//! 1. **Silence.** No tick for the limit, and for 2.5 usual intervals, so that a slow sensor is not silent.
//! 2. **A silent type.** Ticks arrive, but for that time none in which the sensor looked for a type that it
//!    looked for before ([`Header::observed_types`]).
//! 3. **A slow detector.** The last eight intervals are on average three times as long as usual. The usual
//!    interval follows slowly, within minutes.

use serde::{Deserialize, Serialize};
use wire::{AGENT_TYPES, AgentType, Header, StampSource, flags};

use crate::distribution::ms;

/// Time without a tick that is silence, unless an option states another.
pub const SILENCE_NS: u64 = 1_000_000_000;
/// Number of usual intervals that silence lasts at least, in halves.
const INTERVALS_HALVES: u64 = 5;
/// Number of newest intervals whose mean is the present interval.
const NEWEST: usize = 8;
/// A detector is slow if the present interval is this many times the usual one.
const SLOW: u64 = 3;
/// Number of ticks from which the usual interval is known.
const SETTLED: u64 = 32;
/// Longest first interval of a slow sensor. A longer one is silence.
const FIRST_MAX_NS: u64 = 10_000_000_000;
/// Number of intervals over which the usual interval is a mean.
const USUAL: u64 = 1_024;

/// Times of the input.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct Arrivals {
    limit_ns: u64,
    /// Release of the newest tick, and of the newest tick for each type.
    newest_ns: Option<u64>,
    of_type_ns: [Option<u64>; AGENT_TYPES.len()],
    /// The usual interval, from `count` ones.
    usual_ns: u64,
    count: u64,
    intervals_ns: [u64; NEWEST],
    /// Silences that have ended.
    silences: u64,
    silent_ns: u64,
    longest_ns: u64,
    /// Whether ticks follow real time, and whether a gap can't be one of a recording.
    is_timed: bool,
    is_live: bool,
    /// Number of the newest tick.
    newest_seq: u64,
}

impl Default for Arrivals {
    fn default() -> Self {
        Self {
            limit_ns: SILENCE_NS,
            newest_ns: None,
            of_type_ns: [None; AGENT_TYPES.len()],
            usual_ns: 0,
            count: 0,
            intervals_ns: [0; NEWEST],
            silences: 0,
            silent_ns: 0,
            longest_ns: 0,
            is_timed: false,
            is_live: false,
            newest_seq: 0,
        }
    }
}

/// The state of the input at a moment.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct InputStatus {
    /// `NO INPUT for 3.1 s`, or what else is wrong; `None` if the input arrives as usual.
    pub state: Option<String>,
    /// Whether no input arrives.
    pub is_silent: bool,
    /// Whether the source is a sensor, and not a recording with gaps of its own.
    pub is_live: bool,
    /// Age of the newest tick.
    pub age_s: Option<f64>,
    /// Present rate of the ticks.
    pub rate_hz: Option<f64>,
    /// Usual rate of the ticks.
    pub usual_hz: Option<f64>,
}

impl InputStatus {
    /// The state without its figures.
    #[must_use]
    pub fn kind(&self) -> Option<&str> {
        let state = self.state.as_deref()?;
        Some(state.split_once(" for ").or_else(|| state.split_once(':')).map_or(state, |(kind, _)| kind))
    }
}

/// Times without input in a report.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Silences {
    /// Number of times.
    pub count: u64,
    /// All of them together.
    pub total_s: f64,
    /// The longest one.
    pub longest_s: f64,
}

impl Silences {
    /// A reason of a verdict; `None` without silence.
    pub(crate) fn reason(&self) -> Option<String> {
        let Self { count, total_s, longest_s } = self;
        match count {
            0 => None,
            1 => Some(format!("no input for {total_s:.1} s")),
            _ => Some(format!("no input: {count} times, {total_s:.1} s in all, {longest_s:.1} s at most")),
        }
    }
}

impl Arrivals {
    pub fn new(limit_ns: u64) -> Self {
        Self { limit_ns, ..Self::default() }
    }

    /// The same times with another limit, after a restart.
    pub const fn with_limit(self, limit_ns: u64) -> Self {
        Self { limit_ns, ..self }
    }

    /// Adds a tick, whatever became of it.
    pub fn tick(&mut self, header: &Header) {
        if header.has(flags::PREDICTED) {
            return;
        }
        let played = [StampSource::Recording, StampSource::Generated].map(|source| source as u32);
        self.is_timed = !header.has(flags::LOCKSTEP);
        self.is_live = self.is_timed && !played.contains(&header.stamp_source);
        for of in AGENT_TYPES.into_iter().filter(|of| header.observed_types & of.bit() != 0) {
            let newest = &mut self.of_type_ns[of.index()];
            *newest = (*newest).max(Some(header.released_ns));
        }
        self.newest_seq = header.seq;
        let before_ns = self.newest_ns.replace(header.released_ns);
        let Some(interval_ns) = before_ns.map(|before_ns| header.released_ns.saturating_sub(before_ns))
        else {
            return;
        };
        // The first interval shows the rate of a slow sensor.
        let is_first = self.count == 0 && interval_ns <= FIRST_MAX_NS;
        if !is_first && interval_ns >= self.silence_ns() {
            self.end_silence(interval_ns);
            return;
        }
        self.intervals_ns.rotate_left(1);
        self.intervals_ns[NEWEST - 1] = interval_ns;
        // A slow phase is not usual.
        if self.count < SETTLED || interval_ns < 2 * self.usual_ns {
            self.count += 1;
            let weight = self.count.min(USUAL);
            self.usual_ns = (self.usual_ns * (weight - 1) + interval_ns) / weight;
        }
    }

    /// States that no tick follows.
    pub const fn end(&mut self) {
        self.newest_ns = None;
    }

    /// Adds a heartbeat of the source, which has sent the ticks up to `seq`. A new tick is input even if no forecasts
    /// follow.
    pub fn source(&mut self, seq: u64, sent_ns: u64) {
        let Some(newest_ns) = self.newest_ns.filter(|_| seq > self.newest_seq) else { return };
        let silent_ns = sent_ns.saturating_sub(newest_ns);
        if silent_ns >= self.silence_ns() {
            self.end_silence(silent_ns);
            (self.newest_ns, self.newest_seq) = (Some(sent_ns), seq);
        }
    }

    fn end_silence(&mut self, silent_ns: u64) {
        if self.is_live {
            self.silences += 1;
            self.silent_ns += silent_ns;
            self.longest_ns = self.longest_ns.max(silent_ns);
        }
    }

    /// Time without a tick that is silence.
    fn silence_ns(&self) -> u64 {
        self.limit_ns.max(self.usual_ns.saturating_mul(INTERVALS_HALVES) / 2)
    }

    /// The state at a time on `CLOCK_MONOTONIC`.
    pub fn status(&self, now_ns: u64) -> InputStatus {
        let Some(newest_ns) = self.newest_ns.filter(|_| self.is_timed) else { return InputStatus::default() };
        let age_ns = now_ns.saturating_sub(newest_ns);
        let is_silent = age_ns >= self.silence_ns();
        let known = self.intervals_ns.iter().filter(|ns| **ns > 0);
        let (sum_ns, count) = (known.clone().sum::<u64>(), known.count() as u64);
        // An interval that has not ended counts as soon as it is the longest.
        let present_ns = sum_ns.checked_div(count).map_or(0, |mean_ns| mean_ns.max(age_ns));
        let hertz = |ns: u64| (ns > 0).then(|| (1e11 / ns as f64).round() / 1e2);
        let (rate_hz, usual_hz) =
            (if is_silent { Some(0.0) } else { hertz(present_ns) }, hertz(self.usual_ns));
        let state = if is_silent {
            Some(format!("NO INPUT for {:.1} s", ms(age_ns) / 1e3))
        } else {
            self.silent_types(now_ns).or_else(|| {
                let is_slow = self.count >= SETTLED && sum_ns / count.max(1) >= SLOW * self.usual_ns;
                let (now_hz, usual_hz) = (rate_hz?, usual_hz?);
                is_slow.then(|| format!("SLOW INPUT: {now_hz:.1} Hz, usually {usual_hz:.1} Hz"))
            })
        };
        let age_s = Some((ms(age_ns)).round() / 1e3);
        InputStatus { state, is_silent, is_live: self.is_live, age_s, rate_hz, usual_hz }
    }

    /// The types that the sensor no longer looks for.
    fn silent_types(&self, now_ns: u64) -> Option<String> {
        let silence_ns = self.silence_ns();
        let silent = |of: &AgentType| {
            self.of_type_ns[of.index()].is_some_and(|seen_ns| {
                let newest_ns = self.newest_ns.unwrap_or(seen_ns);
                newest_ns > seen_ns && now_ns.saturating_sub(seen_ns) >= silence_ns
            })
        };
        let silent: Vec<AgentType> = AGENT_TYPES.into_iter().filter(silent).collect();
        let longest_ns = silent.iter().filter_map(|of| self.of_type_ns[of.index()]).min()?;
        let names: Vec<&str> = silent.iter().map(|of| of.name()).collect();
        let age_s = ms(now_ns.saturating_sub(longest_ns)) / 1e3;
        Some(format!("NO INPUT of type {} for {age_s:.1} s", names.join(", ")))
    }

    /// The silences so far, with the one that has not ended at `now_ns`, if that is known.
    pub fn report(&self, now_ns: Option<u64>) -> Silences {
        let mut sums = *self;
        if let (Some(newest_ns), Some(now_ns)) = (self.newest_ns, now_ns)
            && now_ns.saturating_sub(newest_ns) >= self.silence_ns()
        {
            sums.end_silence(now_ns - newest_ns);
        }
        let seconds = |ns: u64| (ns as f64 / 1e8).round() / 1e1;
        Silences {
            count: sums.silences,
            total_s: seconds(sums.silent_ns),
            longest_s: seconds(sums.longest_ns),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn header(at_ms: u64, types: &[AgentType]) -> Header {
        let observed_types = types.iter().fold(0, |bits, of| bits | of.bit());
        let stamp_source = StampSource::SensorClock as u32;
        Header { released_ns: at_ms * MS, observed_types, stamp_source, ..Header::new(1, at_ms, 0) }
    }

    fn after(ticks: u64, interval_ms: u64) -> Arrivals {
        let mut arrivals = Arrivals::default();
        (1..=ticks).for_each(|tick| arrivals.tick(&header(tick * interval_ms, &AGENT_TYPES)));
        arrivals
    }

    fn state(arrivals: &Arrivals, at_ms: u64) -> Option<String> {
        arrivals.status(at_ms * MS).state
    }

    #[test]
    fn silence_begins_after_the_limit_and_ends_with_the_next_tick() {
        let mut arrivals = after(50, 100);
        assert_eq!(state(&arrivals, 5_999), None);
        assert_eq!(state(&arrivals, 8_100).as_deref(), Some("NO INPUT for 3.1 s"));
        assert_eq!(arrivals.report(Some(8_100 * MS)).reason().as_deref(), Some("no input for 3.1 s"));
        // A predicted tick is no input.
        arrivals.tick(&Header { flags: flags::PREDICTED, ..header(8_200, &AGENT_TYPES) });
        assert!(arrivals.status(8_200 * MS).is_silent);
        arrivals.tick(&header(35_000, &AGENT_TYPES));
        assert_eq!(state(&arrivals, 35_100), None);
        let silences = Silences { count: 1, total_s: 30.0, longest_s: 30.0 };
        assert_eq!(arrivals.report(Some(35_100 * MS)), silences);
    }

    #[test]
    fn a_slow_sensor_is_not_silent_and_a_recording_has_gaps_of_its_own() {
        assert_eq!(state(&after(20, 2_000), 44_900), None);
        assert_eq!(state(&after(20, 2_000), 45_100).as_deref(), Some("NO INPUT for 5.1 s"));
        let mut arrivals = after(20, 100);
        let recorded = StampSource::Recording as u32;
        arrivals.tick(&Header { stamp_source: recorded, ..header(2_100, &AGENT_TYPES) });
        arrivals.tick(&Header { stamp_source: recorded, ..header(9_000, &AGENT_TYPES) });
        assert_eq!(arrivals.report(None), Silences::default());
    }

    #[test]
    fn frames_of_the_source_are_input_even_without_forecasts() {
        let mut arrivals = after(50, 100);
        // The number of these ticks is their time.
        arrivals.source(5_000, 7_000 * MS);
        assert!(arrivals.status(7_000 * MS).is_silent);
        arrivals.source(5_001, 7_080 * MS);
        assert!(!arrivals.status(7_100 * MS).is_silent);
    }

    #[test]
    fn a_silent_type_is_named() {
        let mut arrivals = after(50, 100);
        let vehicles = [AgentType::Vehicle, AgentType::Cyclist];
        (51..=70).for_each(|tick| arrivals.tick(&header(tick * 100, &vehicles)));
        assert_eq!(state(&arrivals, 7_000).as_deref(), Some("NO INPUT of type pedestrian for 2.0 s"));
        // Two sensors in turn.
        let mut arrivals = Arrivals::default();
        for tick in 0..100 {
            let of = if tick % 2 == 0 { AgentType::Vehicle } else { AgentType::Pedestrian };
            arrivals.tick(&header(tick * 100, &[of]));
            assert_eq!(state(&arrivals, tick * 100 + 50), None);
        }
    }

    #[test]
    fn a_rate_that_falls_to_a_fifth_is_slow_input() {
        let mut arrivals = after(100, 100);
        (1..=3).for_each(|tick| arrivals.tick(&header(10_000 + tick * 500, &AGENT_TYPES)));
        assert_eq!(state(&arrivals, 11_600), None, "a hiccup");
        (4..=8).for_each(|tick| arrivals.tick(&header(10_000 + tick * 500, &AGENT_TYPES)));
        let slow = state(&arrivals, 14_100).unwrap();
        assert!(slow.starts_with("SLOW INPUT: 2.0 Hz, usually 10.0 Hz"), "{slow}");
    }
}
