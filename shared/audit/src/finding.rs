use std::fmt;

use serde::{Deserialize, Serialize};
use wire::AgentType;

use crate::doubt::Doubt;
use crate::headings::{Convention, Reading};
use crate::speeds::{Unit, usual_mps};
use crate::tally::{Place, Tally};

/// Share of the rows above which a finding makes the input doubtful.
pub const DOUBT_SHARE: f64 = 0.01;
/// Longest time between two detections of an agent: the horizon of a forecast.
pub(crate) const INTERVAL_MAX_S: f64 = 4.8;

/// Figures of a finding.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Detail {
    None,
    Heading(Option<Reading>),
    Reported {
        agent_type: AgentType,
        ratio: f64,
        unit: Option<Unit>,
        frame_rate: Option<f64>,
    },
    Speeds {
        agent_type: AgentType,
        speeds_mps: [f64; 2],
        frame_rate: Option<f64>,
    },
    Length {
        length_m: f64,
    },
    Interval {
        interval_s: f64,
    },
    /// Paths that are too fast for a type.
    TooFast {
        agent_type: AgentType,
        speed_mps: f64,
    },
    /// All stamps are whole seconds.
    WholeStamps,
    /// A number that stands for "unknown".
    Unknown {
        value: f64,
    },
}

/// A fault of the input and its rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Finding {
    /// The kind.
    pub doubt: Doubt,
    /// Number of rows that it concerns.
    pub rows: u64,
    /// Number of examined rows.
    pub of: u64,
    /// The first row that it concerns.
    pub first: Option<Place>,
    pub(crate) detail: Detail,
}

/// A finding as data for reports.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Found {
    /// Name of the kind: [`Doubt::name`].
    pub kind: String,
    /// The observation and the remedy, in one sentence.
    pub sentence: String,
    /// Number of rows that it concerns; `None` if only the kind is known.
    pub rows: Option<u64>,
    /// Number of examined rows.
    pub of: Option<u64>,
    /// `rows` divided by `of`.
    pub share: Option<f64>,
    /// The first row that it concerns: `FILE:LINE` of a recording, or `tick N` of a run.
    pub first: Option<String>,
    /// Whether the share makes the input doubtful.
    pub doubtful: bool,
}

impl Finding {
    pub(crate) const fn new(doubt: Doubt, tally: Tally, of: u64, detail: Detail) -> Self {
        Self { doubt, rows: tally.rows, of, first: tally.first, detail }
    }

    /// The share of the examined rows.
    pub fn share(&self) -> f64 {
        self.rows as f64 / self.of.max(1) as f64
    }

    /// Whether it makes the input doubtful.
    pub fn is_doubt(&self) -> bool {
        self.share() > DOUBT_SHARE
    }

    /// Converts the finding to data. `place` names the first row.
    #[must_use]
    pub fn found(&self, place: impl FnOnce(Place) -> String) -> Found {
        Found {
            kind: self.doubt.name().to_owned(),
            sentence: self.to_string(),
            rows: Some(self.rows),
            of: Some(self.of),
            share: Some((self.share() * 1e4).round() / 1e4),
            first: self.first.map(place),
            doubtful: self.is_doubt(),
        }
    }
}

impl Found {
    /// A doubt for which only the kind is known.
    #[must_use]
    pub fn of_kind(doubt: Doubt) -> Self {
        Self {
            kind: doubt.name().to_owned(),
            sentence: format!("{}: {}", doubt.observation(), doubt.remedy()),
            doubtful: true,
            ..Self::default()
        }
    }
}

/// The sentence with rows, share and first row.
impl fmt::Display for Found {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.sentence)?;
        let (Some(rows), Some(of), Some(share)) = (self.rows, self.of, self.share) else { return Ok(()) };
        write!(f, " ({rows} of {of} rows, {:.1} %", share * 100.0)?;
        self.first.as_ref().map_or(Ok(()), |first| write!(f, "; first: {first}"))?;
        f.write_str(")")
    }
}

/// The agents of a type, in words.
pub(crate) const fn plural(agent_type: AgentType) -> &'static str {
    match agent_type {
        AgentType::Vehicle => "vehicles",
        AgentType::Cyclist => "cyclists",
        AgentType::Pedestrian => "pedestrians",
    }
}

/// The observation and the remedy, in one sentence.
impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (observation, remedy) = (self.doubt.observation(), self.doubt.remedy());
        match self.detail {
            Detail::Heading(Some(Reading { degrees: true, convention })) => {
                write!(f, "{observation}{}: {remedy}", convention.words())?;
                match convention.remedy() {
                    "" => Ok(()),
                    further => write!(f, ", then {further}"),
                }
            }
            Detail::Heading(Some(Reading { convention, .. }))
                if self.doubt == Doubt::HeadingsTurned || convention == Convention::FromWest =>
            {
                write!(f, "headings look{}: {}", convention.words(), convention.remedy())
            }
            Detail::Reported { agent_type, ratio, unit, frame_rate } => {
                let plural = plural(agent_type);
                match (unit, frame_rate) {
                    (Some(Unit::FeetPerSecond), _) => {
                        write!(f, "speeds of {plural} look like feet a second: multiply them by 0.3048")
                    }
                    (Some(Unit::InFeet), _) => {
                        write!(f, "positions of {plural} look like feet: {remedy}")
                    }
                    (Some(Unit::Kmh | Unit::Mph), _) => write!(f, "{observation} ({plural}): {remedy}"),
                    (None, Some(rate)) => {
                        let fitting_hz = rate / ratio;
                        write!(
                            f,
                            "the positions of {plural} move {ratio:.2} times as fast as their reported speeds: \
                             at {fitting_hz:.2} frames a second instead of {rate} they agree (--fps)"
                        )
                    }
                    (None, None) => write!(
                        f,
                        "the positions of {plural} move {ratio:.2} times as fast as their reported speeds: \
                         write both in metres and seconds"
                    ),
                }
            }
            Detail::Speeds { agent_type, speeds_mps: [median_mps, high_mps], frame_rate } => {
                let [least_mps, most_mps, most_high_mps] = usual_mps(agent_type);
                write!(
                    f,
                    "{} that move have a median speed of {median_mps:.1} m/s and a 95th percentile of \
                     {high_mps:.1} m/s; usual are {least_mps} to {most_mps} m/s and up to {most_high_mps} \
                     m/s: ",
                    plural(agent_type)
                )?;
                match frame_rate {
                    Some(rate) => write!(f, "is it {rate} frames a second (--fps), are positions in metres")?,
                    None => f.write_str("are positions in metres, times in seconds")?,
                }
                f.write_str(", and is the type right?")
            }
            Detail::Length { length_m } => {
                write!(f, "vehicles are {length_m:.1} long at the median, as in feet: {remedy}")
            }
            Detail::Unknown { value } => {
                let column = if self.doubt == Doubt::SpeedsDiffer { "speeds" } else { "headings" };
                write!(
                    f,
                    "{column} are {value} while agents move otherwise: leave the column empty if it is unknown"
                )
            }
            Detail::TooFast { agent_type, speed_mps } => write!(
                f,
                "{0} move at {speed_mps:.1} m/s, faster than {0} can: are positions in metres, times in seconds, and is \
                 the type right?",
                plural(agent_type)
            ),
            Detail::Interval { interval_s } if self.doubt == Doubt::SeenTwice => {
                write!(
                    f,
                    "agents take the same paths again {interval_s:.1} s later, as if two sensors with different clocks \
                     saw them: {remedy}"
                )
            }
            Detail::Interval { interval_s } if self.doubt == Doubt::IdentitiesChange => {
                write!(f, "{observation}, every {interval_s:.1} s on average: {remedy}")
            }
            Detail::Interval { interval_s } if self.doubt == Doubt::Sparse => {
                write!(f, "{observation}, {interval_s:.1} s: {remedy}")
            }
            Detail::Interval { interval_s } => interval(f, self.doubt, interval_s),
            Detail::WholeStamps => write!(
                f,
                "{observation}, and all stamps are whole seconds: write the fractions of the seconds, and each object once"
            ),
            Detail::None if self.doubt == Doubt::Outliers && 3 * self.rows > self.of => {
                write!(f, "many {observation}: are positions in metres, and stamps in seconds?")
            }
            Detail::None | Detail::Heading(_) => write!(f, "{observation}: {remedy}"),
        }
    }
}

/// The sentence about stamps, if an agent's detections have this interval.
fn interval(f: &mut fmt::Formatter<'_>, doubt: Doubt, interval_s: f64) -> fmt::Result {
    if doubt == Doubt::StampsAreFrames {
        return write!(
            f,
            "stamps are whole numbers {interval_s:.0} apart, as frame numbers and seconds without fractions are: \
             divide them by the frames a second, or write the fractions"
        );
    }
    if interval_s < 1.0 {
        return write!(
            f,
            "an agent's detections are {:.6} ms apart: write stamps in seconds (in nanoseconds on the wire)",
            interval_s * 1e3
        );
    }
    // For sensors from 0.5 to 50 Hz.
    let units = [("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9)];
    let unit = units.into_iter().find(|(_, per_s)| (0.02..=2.0).contains(&(interval_s / per_s)));
    write!(
        f,
        "an agent's detections are {interval_s:.0} s apart, beyond the horizon of {INTERVAL_MAX_S} s: "
    )?;
    match unit {
        Some((name, per_s)) => write!(f, "stamps look like {name}, divide them by {per_s:.0}"),
        None => f.write_str("write stamps in seconds"),
    }
}
