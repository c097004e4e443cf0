//! The options that choose a noisy sensor.

use clap::Args;
use evaluator::{Noise, SEED};

use console::failure::Failure;

/// The sets whose evaluation takes these options.
pub const SETS: [&str; 3] = ["driving", "interaction", "eth-ucy"];
/// Greatest standard deviation of a position, m.
const SIGMA_MAX_M: f64 = 10.0;
/// Greatest standard deviation of a heading, degrees.
const HEADING_MAX_DEG: f64 = 90.0;
/// Greatest share of missing detections.
const DROP_MAX: f64 = 0.95;
/// Greatest time constant of noise, s.
const LAG_MAX_S: f64 = 60.0;

/// Errors of a sensor.
#[derive(Clone, Debug, Args)]
pub struct NoiseArguments {
    /// Add noise to the positions of the detections in `driving`, `interaction` and `eth-ucy`: standard
    /// deviation per axis, m. Reported speeds get the same standard deviation in m/s. Forecasts are compared
    /// with the recording without noise
    #[arg(long, value_name = "M", allow_negative_numbers = true)]
    noise: Option<f64>,
    /// Add noise to reported headings: standard deviation, degrees
    #[arg(long, value_name = "DEGREES", allow_negative_numbers = true)]
    noise_heading: Option<f64>,
    /// Drop this share of the detections at random
    #[arg(long, value_name = "SHARE", allow_negative_numbers = true)]
    drop: Option<f64>,
    /// Give detections no identities. Tracks are matched with the nearest agent of their type within 2 m
    #[arg(long)]
    no_ids: bool,
    /// Let noise last from frame to frame with this time constant, s; its standard deviation stays the same
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    lag: Option<f64>,
    /// Let detections report the standard deviation of their positions
    #[arg(long)]
    sigma: bool,
}

impl NoiseArguments {
    /// The names of the given options.
    pub fn given(&self) -> impl Iterator<Item = &'static str> {
        let options = [
            ("--noise", self.noise.is_some()),
            ("--noise-heading", self.noise_heading.is_some()),
            ("--drop", self.drop.is_some()),
            ("--no-ids", self.no_ids),
            ("--lag", self.lag.is_some()),
            ("--sigma", self.sigma),
        ];
        options.into_iter().filter(|(_, is_given)| *is_given).map(|(name, _)| name)
    }

    /// The sensor. With `positions_only` its detections have neither headings nor speeds.
    ///
    /// # Errors
    /// [`Failure::Usage`] names an option that is out of its range or has no effect.
    pub fn sensor(&self, positions_only: bool) -> Result<Noise, Failure> {
        let noise = Noise {
            sigma_m: within("--noise", self.noise, SIGMA_MAX_M)?,
            heading_rad: within("--noise-heading", self.noise_heading, HEADING_MAX_DEG)?.to_radians(),
            drop_share: within("--drop", self.drop, DROP_MAX)?,
            without_ids: self.no_ids,
            lag_s: within("--lag", self.lag, LAG_MAX_S)?,
            reports_sigma: self.sigma,
            positions_only,
            seed: SEED,
        };
        let is_noisy = noise.sigma_m > 0.0;
        let unused = if positions_only && noise.heading_rad > 0.0 {
            Some("--noise-heading is for detections with headings, not for --positions")
        } else if noise.reports_sigma && !is_noisy {
            Some("--sigma needs --noise")
        } else if noise.lag_s > 0.0 && !is_noisy && noise.heading_rad == 0.0 {
            Some("--lag needs --noise or --noise-heading")
        } else {
            None
        };
        unused.map_or(Ok(noise), |why| Err(Failure::Usage(why.to_owned())))
    }
}

/// The value of an option, 0 if it is not given.
fn within(option: &str, value: Option<f64>, most: f64) -> Result<f64, Failure> {
    match value {
        None => Ok(0.0),
        Some(value) if (0.0..=most).contains(&value) => Ok(value),
        Some(value) => Err(Failure::Usage(format!("{option} {value}: expected a number from 0 to {most}"))),
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        noise: NoiseArguments,
    }

    fn sensor(arguments: &[&str]) -> Result<Noise, Failure> {
        let line = std::iter::once(&"evaluate").chain(arguments);
        Line::try_parse_from(line).expect("the arguments parse").noise.sensor(false)
    }

    #[test]
    fn without_options_the_sensor_changes_nothing() {
        assert!(sensor(&[]).unwrap().is_none());
        assert!(sensor(&["--noise", "0"]).unwrap().is_none());
    }

    #[test]
    fn a_sensor_names_its_own_options() {
        let line = "--noise 0.1 --lag 0.3 --noise-heading 2 --drop 0.25 --no-ids --sigma";
        let arguments: Vec<&str> = line.split(' ').collect();
        let noise = sensor(&arguments).unwrap();
        assert_eq!(noise.arguments(), format!(" {line}"));
        assert!((noise.heading_rad - 2.0_f64.to_radians()).abs() < 1e-12);
    }

    #[test]
    fn options_out_of_range_or_without_effect_are_refused() {
        for (line, why) in [
            ("--noise -0.1", "--noise"),
            ("--noise NaN", "--noise"),
            ("--drop 1", "--drop"),
            ("--noise-heading 180", "--noise-heading"),
            ("--sigma", "--sigma needs"),
            ("--lag 0.3", "--lag needs"),
        ] {
            let refused = sensor(&line.split(' ').collect::<Vec<_>>()).unwrap_err().to_string();
            assert!(refused.contains(why), "{line}: {refused}");
        }
    }
}
