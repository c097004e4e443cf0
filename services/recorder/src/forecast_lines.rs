//! Forecasts as JSON lines: `stgdat predict --out FILE` and `stgdat run --forecasts FILE`.
//!
//! There is one line per tick in time order, even if the tick has no agents. Lines contain no clock, run id
//! or incarnation, so the same recording, seed and weights give the same bytes. Version 2:
//!
//! | field | meaning |
//! |---|---|
//! | `version` | [`FORECASTS_VERSION`] |
//! | `seq` | number of the tick, from 0 |
//! | `stamp_ns` | time of validity on the recording's clock |
//! | `step_s` | Δt: step k of a forecast is at stamp + (k + 1) Δt |
//! | `agents` | one object per track, in the order of the frame |
//!
//! | field of an agent | meaning |
//! |---|---|
//! | `id` | the track, never reused within a run (64 bits) |
//! | `source_id` | the agent's identity in the recording; 0 if it has none (64 bits) |
//! | `type` | `vehicle`, `cyclist`, `pedestrian` |
//! | `quality` | `learned`, `held` (from an earlier tick), `kinematic` (constant control) |
//! | `cause` | why the forecast is held or kinematic: `late`, `rejected`, `missing`, `young`, `outdone`, `shed`, or `number 17` of a newer version; otherwise `none` |
//! | `experts` | weights of the experts that have any, by name; empty without a blend |
//! | `out_of_distribution` | how far the agent moves from what the network was trained on; from 0.25 on the network adds less than half |
//! | `age_s` | age of a held forecast; otherwise 0 |
//! | `prior` | prior of the track's state: `learned`, `held` (a forecast older than Δt), `kinematic` |
//! | `prior_age_s` | age of the forecast that is the prior; otherwise 0 |
//! | `x_m`, `y_m` | position at the stamp, own frame |
//! | `vx_mps`, `vy_mps` | velocity at the stamp, world frame |
//! | `heading_rad` | heading at the stamp, counter-clockwise from +x |
//! | `length_m`, `width_m` | extent along and across the heading; 0 if unknown |
//! | `probability` | probability of each mode; the sum is 1 |
//! | `modes_m` | \[mode\]\[step\] = \[x, y\], own frame |
//! | `best_m` | \[step\] = \[x, y\]: the single best forecast |
//! | `mean_m` | \[step\] = \[x, y\]: mean of the mixture of all modes |
//! | `covariance_m2` | \[step\] = \[xx, xy, yy\] of the mixture |
//! | `conflicts` | probable conflicts, each with `other_id` (the track), `probability`, `if_nobody_reacts` and `in_s`; left out if there are none, or the sampler was not asked for them |
//!
//! Positions are in the recording's own frame, because the run's origin (`--origin`) is added again. Without
//! an origin this is the world frame.
//!
//! Numbers are rounded to four decimals (0.1 mm, well below the resolution of f32 at the edge of the world
//! frame). Probabilities and covariances are rounded to six decimals.

use std::borrow::Cow;
use std::io::{self, Write};
use std::path::Path;

use serde::{Serialize, Serializer};
use wire::{
    AgentType, CONFLICTS_MAX, Cause, Expert, Forecast, ForeseenConflict, HORIZON_MAX, Header, MODES_MAX,
    Quality, WorldOrigin,
};

use crate::whole_file::WholeFile;

/// Version of the lines' fields.
pub const FORECASTS_VERSION: u32 = 2;

/// Writes one line per tick. The file is named `NAME.partial` until it is finished. Pipes and devices are
/// written directly.
#[derive(Debug)]
pub struct ForecastWriter {
    file: WholeFile,
    origin: WorldOrigin,
}

impl ForecastWriter {
    /// Starts a file. It will replace a file of this name. `origin` is the world frame's origin in the
    /// recording's own frame.
    ///
    /// # Errors
    /// The error of the file system.
    pub fn create(path: &Path, origin: WorldOrigin) -> io::Result<Self> {
        Ok(Self { file: WholeFile::create_resumable(path)?, origin })
    }

    /// Continues the file of a recorder that was killed.
    ///
    /// # Errors
    /// The error of the file system.
    pub fn resume(path: &Path, origin: WorldOrigin) -> io::Result<Self> {
        Ok(Self { file: WholeFile::resume(path)?, origin })
    }

    /// Writes the buffered data, so that it outlives this process.
    ///
    /// # Errors
    /// The error of the file system, such as a full disk.
    pub fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }

    /// Writes the forecasts of a tick. Warm-up and END frames have no line.
    ///
    /// # Errors
    /// The error of the file system, such as a full disk.
    pub fn write(&mut self, header: &Header, forecasts: &[Forecast]) -> io::Result<()> {
        if header.is_tick() {
            write_forecast_line(&mut self.file, header, forecasts, self.origin)
        } else {
            Ok(())
        }
    }

    /// Writes the buffered data and gives the file its name.
    ///
    /// # Errors
    /// The error of the file system, such as a full disk.
    pub fn finish(self) -> io::Result<()> {
        self.file.finish()
    }
}

/// Writes the forecasts of a tick as one line.
///
/// # Errors
/// The error of the output.
pub fn write_forecast_line(
    output: &mut impl Write,
    header: &Header,
    forecasts: &[Forecast],
    origin: WorldOrigin,
) -> io::Result<()> {
    let horizon_len = (header.counts.horizon_len as usize).min(HORIZON_MAX);
    let line = Line {
        version: FORECASTS_VERSION,
        seq: header.seq,
        stamp_ns: header.stamp_ns,
        step_s: header.step_ns as f64 / 1e9,
        agents: Each(forecasts, |forecast| Agent::of(forecast, horizon_len, origin)),
    };
    serde_json::to_writer(&mut *output, &line)?;
    output.write_all(b"\n")
}

#[derive(Serialize)]
struct Line<A> {
    version: u32,
    seq: u64,
    stamp_ns: i64,
    step_s: f64,
    agents: A,
}

#[derive(Serialize)]
struct Agent<'a> {
    id: u64,
    source_id: u64,
    r#type: &'static str,
    quality: &'static str,
    cause: Cow<'static, str>,
    experts: Experts<'a>,
    out_of_distribution: Rounded<4>,
    age_s: f64,
    prior: &'static str,
    prior_age_s: f64,
    x_m: Rounded<4, f64>,
    y_m: Rounded<4, f64>,
    vx_mps: Rounded<4>,
    vy_mps: Rounded<4>,
    heading_rad: Rounded<4>,
    length_m: Rounded<4>,
    width_m: Rounded<4>,
    probability: Numbers<'a, 6>,
    modes_m: Modes<'a>,
    best_m: Points<'a>,
    mean_m: Points<'a>,
    covariance_m2: Rows<'a, 3, 6>,
    #[serde(skip_serializing_if = "Conflicts::is_empty")]
    conflicts: Conflicts<'a>,
}

impl<'a> Agent<'a> {
    fn of(forecast: &'a Forecast, horizon_len: usize, origin: WorldOrigin) -> Self {
        let modes_len = (forecast.modes_len as usize).min(MODES_MAX);
        let [x_m, y_m] = origin.own_m([forecast.x_m, forecast.y_m]);
        let points = |points_m: &'a [[f32; 2]; HORIZON_MAX]| Points(&points_m[..horizon_len], origin);
        Self {
            id: forecast.id,
            source_id: forecast.source_id,
            r#type: AgentType::try_from(forecast.agent_type).map_or("unknown", AgentType::name),
            quality: quality_name(forecast.quality),
            cause: Cause::name_of(forecast.cause),
            experts: Experts(forecast),
            out_of_distribution: Rounded(forecast.out_of_distribution),
            age_s: forecast.age_ns as f64 / 1e9,
            prior: quality_name(forecast.prior),
            prior_age_s: forecast.prior_age_ns as f64 / 1e9,
            x_m: Rounded(x_m),
            y_m: Rounded(y_m),
            vx_mps: Rounded(forecast.vx_mps),
            vy_mps: Rounded(forecast.vy_mps),
            heading_rad: Rounded(forecast.heading_rad),
            length_m: Rounded(forecast.length_m),
            width_m: Rounded(forecast.width_m),
            probability: Numbers(&forecast.probability[..modes_len]),
            modes_m: Modes { modes: &forecast.modes[..modes_len], horizon_len, origin },
            best_m: points(&forecast.best),
            mean_m: points(&forecast.mean),
            covariance_m2: Rows(&forecast.covariance[..horizon_len]),
            conflicts: Conflicts(&forecast.conflicts[..(forecast.conflicts_len as usize).min(CONFLICTS_MAX)]),
        }
    }
}

/// The conflicts of an agent.
struct Conflicts<'a>(&'a [ForeseenConflict]);

impl Conflicts<'_> {
    const fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

impl Serialize for Conflicts<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Conflict {
            other_id: u64,
            probability: Rounded<4>,
            if_nobody_reacts: Rounded<4>,
            in_s: Rounded<4>,
        }
        let conflict = |of: &ForeseenConflict| Conflict {
            other_id: of.other_id,
            probability: Rounded(of.probability),
            if_nobody_reacts: Rounded(of.if_nobody_reacts),
            in_s: Rounded(of.in_s),
        };
        serializer.collect_seq(self.0.iter().map(conflict))
    }
}

/// Weights of a forecast's experts by name, without those that are 0.
struct Experts<'a>(&'a Forecast);

impl Serialize for Experts<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Self(forecast) = self;
        let agent_type = AgentType::try_from(forecast.agent_type).ok();
        let weighted = Expert::ALL.iter().filter_map(|expert| {
            let weight = *forecast.expert_weights.get(*expert as usize).filter(|weight| **weight > 0.0)?;
            let name = agent_type.map_or(expert.name(), |of| expert.name_for(of));
            Some((name, Rounded::<4>(weight)))
        });
        serializer.collect_map(weighted)
    }
}

fn quality_name(number: u32) -> &'static str {
    Quality::try_from(number).map_or("unknown", Quality::name)
}

/// A number with `DECIMALS` decimals.
struct Rounded<const DECIMALS: i32, T = f32>(T);

impl<const DECIMALS: i32, T: Copy + Into<f64>> Serialize for Rounded<DECIMALS, T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let scale = 10_f64.powi(DECIMALS);
        // The quotient is the f64 nearest to the decimal number, so its shortest form is this number. Adding
        // 0 turns -0 into 0.
        serializer.serialize_f64((self.0.into() * scale).round() / scale + 0.0)
    }
}

/// A list whose items are created while it is written.
struct Each<'a, T, F>(&'a [T], F);

impl<'a, T, U: Serialize, F: Fn(&'a T) -> U> Serialize for Each<'a, T, F> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.0.iter().map(&self.1))
    }
}

/// A list of numbers.
struct Numbers<'a, const DECIMALS: i32>(&'a [f32]);

impl<const DECIMALS: i32> Serialize for Numbers<'_, DECIMALS> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.0.iter().map(|&x| Rounded::<DECIMALS>(x)))
    }
}

/// A list of rows with `WIDTH` numbers each.
struct Rows<'a, const WIDTH: usize, const DECIMALS: i32>(&'a [[f32; WIDTH]]);

impl<const WIDTH: usize, const DECIMALS: i32> Serialize for Rows<'_, WIDTH, DECIMALS> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.0.iter().map(|row| Numbers::<DECIMALS>(row)))
    }
}

/// Positions in the world frame, written in the recording's own frame.
struct Points<'a>(&'a [[f32; 2]], WorldOrigin);

impl Serialize for Points<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let own = |&point_m: &[f32; 2]| self.1.own_m(point_m).map(Rounded::<4, f64>);
        serializer.collect_seq(self.0.iter().map(own))
    }
}

/// The trajectories of all modes.
struct Modes<'a> {
    modes: &'a [[[f32; 2]; HORIZON_MAX]],
    horizon_len: usize,
    origin: WorldOrigin,
}

impl Serialize for Modes<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.modes.iter().map(|mode| Points(&mode[..self.horizon_len], self.origin)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use wire::{Counts, flags};

    fn header(agents_len: u32) -> Header {
        let counts = Counts { agents_len, horizon_len: 2, ..Counts::default() };
        Header { counts, step_ns: 400_000_000, released_ns: 77, ..Header::new(99, 5, 1_200_000_000) }
    }

    fn forecast() -> Forecast {
        let mut forecast = Forecast {
            id: 7,
            source_id: 3,
            age_ns: 80_000_000,
            agent_type: 2,
            quality: Quality::Held as u32,
            cause: Cause::Late as u32,
            prior: Quality::Held as u32,
            prior_age_ns: 480_000_000,
            modes_len: 2,
            x_m: 1.234_56,
            y_m: -0.000_01,
            vx_mps: 0.1,
            heading_rad: std::f32::consts::PI,
            ..Forecast::zeroed()
        };
        forecast.probability[..2].copy_from_slice(&[0.75, 0.25]);
        forecast.modes[1][1] = [10.0, 20.125];
        forecast.best[0] = [1.0 / 3.0, 1e4];
        forecast.covariance[1] = [1e-5, 0.0, 2.0];
        forecast
    }

    fn line(header: &Header, forecasts: &[Forecast]) -> String {
        let mut bytes = Vec::new();
        write_forecast_line(&mut bytes, header, forecasts, WorldOrigin::default()).unwrap();
        String::from_utf8(bytes).unwrap()
    }

    #[test]
    fn a_line_has_the_documented_fields() {
        insta::assert_snapshot!(line(&header(1), &[forecast()]));
    }

    #[test]
    fn conflicts_are_written_if_there_are_any() {
        let mut of = forecast();
        of.conflicts[0] = ForeseenConflict {
            other_id: 9,
            probability: 0.123_456,
            if_nobody_reacts: 0.75,
            in_s: 2.5,
            reserved: 0,
        };
        of.conflicts_len = 1;
        let line = line(&header(1), &[of, forecast()]);
        assert_eq!(line.matches("conflicts").count(), 1, "{line}");
        assert!(
            line.contains(
                r#","conflicts":[{"other_id":9,"probability":0.1235,"if_nobody_reacts":0.75,"in_s":2.5}]}"#
            ),
            "{line}"
        );
    }

    #[test]
    fn the_cause_of_a_newer_version_is_a_number() {
        let line = line(&header(1), &[Forecast { cause: 17, ..forecast() }]);
        assert!(line.contains("\"quality\":\"held\",\"cause\":\"number 17\""), "{line}");
    }

    #[test]
    fn lines_do_not_depend_on_run_clock_or_hops() {
        let mut other = Header { run_id: 1, released_ns: 1, interval_ns: 5, ..header(1) };
        other.push_hop(wire::Hop { stage: 7, incarnation: 2, sent_ns: 9, ..wire::Hop::default() });
        assert_eq!(line(&other, &[forecast()]), line(&header(1), &[forecast()]));
    }

    #[test]
    fn positions_are_in_the_frame_of_the_recording() {
        let origin: WorldOrigin = "81000,5428000.5".parse().unwrap();
        let mut bytes = Vec::new();
        write_forecast_line(&mut bytes, &header(1), &[forecast()], origin).unwrap();
        let line: serde_json::Value = serde_json::from_slice(&bytes).unwrap();
        let agent = &line["agents"][0];
        assert_eq!((&agent["x_m"], &agent["y_m"]), (&81_001.234_6.into(), &5_428_000.5.into()));
        assert_eq!(agent["modes_m"][1][1], serde_json::json!([81_010.0, 5_428_020.625]));
        assert_eq!(agent["best_m"][0], serde_json::json!([81_000.333_3, 5_438_000.5]));
        assert_eq!(agent["vx_mps"], 0.1);
        assert_eq!(agent["covariance_m2"][1], serde_json::json!([1e-5, 0.0, 2.0]));
    }

    #[test]
    fn only_ticks_have_lines_and_the_file_is_complete() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("f.jsonl");
        let mut writer = ForecastWriter::create(&path, WorldOrigin::default()).unwrap();
        writer.write(&Header { flags: flags::WARM_UP, ..header(0) }, &[]).unwrap();
        writer.write(&header(0), &[]).unwrap();
        writer.write(&header(1), &[forecast()]).unwrap();
        writer.write(&Header { flags: flags::END, ..header(0) }, &[]).unwrap();
        writer.finish().unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert_eq!(text.lines().count(), 2);
        assert!(text.ends_with("}\n"));
        for line in text.lines() {
            let value: serde_json::Value = serde_json::from_str(line).unwrap();
            assert_eq!(value["version"], FORECASTS_VERSION);
        }
    }

    #[test]
    fn a_full_disk_is_an_error() {
        let mut writer = ForecastWriter::create(Path::new("/dev/full"), WorldOrigin::default()).unwrap();
        let outcome = (0..100).try_for_each(|_| writer.write(&header(1), &[forecast()]));
        assert!(outcome.and_then(|()| writer.finish()).is_err());
    }
}
