use std::fmt;
use std::str::FromStr;

use thiserror::Error;

/// The rate of a file's frame numbers in frames per second, to the millionth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct FrameRate {
    microhertz: u64,
}

/// A rate outside the valid range.
#[derive(Clone, Debug, Error, PartialEq)]
#[error(
    "no frame rate \"{0}\": expected frames a second from {min} to {max}, as in 29.97",
    min = FrameRate::MIN_HZ,
    max = FrameRate::MAX_HZ
)]
pub struct UnknownFrameRate(pub String);

/// One second in nanoseconds times one hertz in microhertz.
const NS_MICROHERTZ: i128 = 1_000_000_000_000_000;

impl FrameRate {
    /// Lowest rate, Hz.
    pub const MIN_HZ: f64 = 0.1;
    /// Highest rate, Hz.
    pub const MAX_HZ: f64 = 1_000.0;

    /// The rate of `centihertz` frames in 100 s.
    pub(crate) const fn of_centihertz(centihertz: u64) -> Self {
        Self { microhertz: centihertz * 10_000 }
    }

    /// The rate of `hertz` frames per second.
    ///
    /// # Errors
    /// [`UnknownFrameRate`] if `hertz` is not within [`FrameRate::MIN_HZ`] and [`FrameRate::MAX_HZ`].
    pub fn new(hertz: f64) -> Result<Self, UnknownFrameRate> {
        if !(Self::MIN_HZ..=Self::MAX_HZ).contains(&hertz) {
            return Err(UnknownFrameRate(hertz.to_string()));
        }
        Ok(Self { microhertz: (hertz * 1e6).round() as u64 })
    }

    /// Frames per second.
    pub fn hertz(self) -> f64 {
        self.microhertz as f64 / 1e6
    }

    /// The time of a frame, rounded to the nanosecond; `None` if it does not fit.
    #[must_use]
    pub fn stamp_ns(self, frame: i64) -> Option<i64> {
        let microhertz = i128::from(self.microhertz);
        i64::try_from((i128::from(frame) * NS_MICROHERTZ + microhertz / 2).div_euclid(microhertz)).ok()
    }

    /// The duration of `frames` frames, rounded down to the nanosecond.
    #[must_use]
    pub fn interval_ns(self, frames: u32) -> u64 {
        (i128::from(frames) * NS_MICROHERTZ / i128::from(self.microhertz)) as u64
    }
}

impl fmt::Display for FrameRate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.hertz().fmt(f)
    }
}

impl FromStr for FrameRate {
    type Err = UnknownFrameRate;

    fn from_str(text: &str) -> Result<Self, UnknownFrameRate> {
        let unknown = || UnknownFrameRate(text.to_owned());
        Self::new(text.trim().parse().map_err(|_| unknown())?).map_err(|_| unknown())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_are_rounded_to_the_nanosecond_and_intervals_down() {
        let ntsc: FrameRate = "29.97".parse().unwrap();
        assert_eq!(ntsc.stamp_ns(2_997), Some(100_000_000_000));
        assert_eq!((ntsc.stamp_ns(1), ntsc.interval_ns(1)), (Some(33_366_700), 33_366_700));
        let campus = FrameRate::of_centihertz(2_398);
        assert_eq!((campus.stamp_ns(1), campus.interval_ns(1)), (Some(41_701_418), 41_701_417));
        assert_eq!(FrameRate::new(25.0).unwrap().interval_ns(10), 400_000_000);
        assert_eq!(FrameRate::new(0.1).unwrap().stamp_ns(i64::MAX / 2), None);
    }

    #[test]
    fn rates_are_written_as_they_were_given_and_refused_beyond_the_limits() {
        for text in ["29.97", "23.98", "25", "0.1", "1000"] {
            assert_eq!(text.parse::<FrameRate>().unwrap().to_string(), text);
        }
        for text in ["", "0", "-25", "nan", "inf", "1000.1", "fast"] {
            let error = text.parse::<FrameRate>().unwrap_err().to_string();
            assert!(error.starts_with(&format!("no frame rate \"{text}\": expected")), "{error}");
        }
    }
}
