//! Programs in Python: a sampler in Python gives the same moments as the built-in one.

use std::path::Path;
use std::sync::OnceLock;

use serde_json::Value;
use testing::Scratch;

use crate::started::{piped, run_well, stderr, stdout};

/// The folder of the examples.
pub const EXAMPLES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/examples");

/// A Python with iceoryx2 and numpy: STGDAT_PYTHON, or else a virtual environment that is created once.
/// `None`, with a printed note, if there is no Python or its packages are not available.
pub fn python() -> Option<String> {
    static PYTHON: OnceLock<Option<String>> = OnceLock::new();
    PYTHON.get_or_init(find).clone()
}

fn find() -> Option<String> {
    if let Ok(python) = std::env::var("STGDAT_PYTHON") {
        let found = piped(&python).args(["-c", "import iceoryx2, numpy"]).output();
        let found = found.unwrap_or_else(|error| panic!("STGDAT_PYTHON={python}: {error}"));
        assert!(found.status.success(), "STGDAT_PYTHON={python}: {}", stderr(&found));
        return Some(python);
    }
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("python");
    let script = format!("{EXAMPLES}/venv.sh");
    match piped("sh").arg(script).arg(&folder).output() {
        Ok(made) if made.status.success() => Some(folder.join("bin/python").display().to_string()),
        Ok(made) => {
            testing::skip(format_args!(
                "no Python with iceoryx2 and numpy: {}{}",
                stdout(&made).trim_end(),
                stderr(&made).trim_end()
            ));
            None
        }
        Err(error) => {
            testing::skip(format_args!("no shell: {error}"));
            None
        }
    }
}

/// The moments of a forecast at its steps, from a line of JSON.
struct Moments {
    probability: Vec<f64>,
    /// [mode][step] = [x, y].
    modes_m: Vec<Vec<Vec<f64>>>,
    /// [step] = [x, y].
    mean_m: Vec<Vec<f64>>,
    /// [step] = [xx, xy, yy].
    covariance_m2: Vec<Vec<f64>>,
}

/// The learned forecasts of a file, by tick and track.
fn learned(text: &[u8]) -> Vec<((u64, u64), Moments)> {
    let field = |agent: &Value, name: &str| agent[name].clone();
    let mut all = Vec::new();
    for line in String::from_utf8_lossy(text).lines() {
        let tick: Value = serde_json::from_str(line).expect("JSON");
        for agent in tick["agents"].as_array().expect("agents").iter().filter(|of| of["quality"] == "learned")
        {
            let key = (tick["seq"].as_u64().expect("a tick"), agent["id"].as_u64().expect("a track"));
            let moments = Moments {
                probability: serde_json::from_value(field(agent, "probability")).expect("numbers"),
                modes_m: serde_json::from_value(field(agent, "modes_m")).expect("numbers"),
                mean_m: serde_json::from_value(field(agent, "mean_m")).expect("numbers"),
                covariance_m2: serde_json::from_value(field(agent, "covariance_m2")).expect("numbers"),
            };
            all.push((key, moments));
        }
    }
    all
}

impl Moments {
    /// The variance within the modes at a step along an axis: the mixture's variance minus the variance of
    /// its means.
    fn within(&self, step: usize, axis: usize) -> f64 {
        let modes = self.probability.iter().zip(&self.modes_m);
        let between: f64 =
            modes.map(|(p, mode)| p * (mode[step][axis] - self.mean_m[step][axis]).powi(2)).sum();
        (self.covariance_m2[step][2 * axis] - between).max(0.0)
    }
}

const RUST_PARTICLES: f64 = 32.0;
const PYTHON_PARTICLES: f64 = 96.0;

#[test]
fn a_sampler_in_python_gives_the_moments_of_the_built_in_one() {
    let Some(python) = python() else { return };
    let scratch = Scratch::new("python-sampler");
    let particles = PYTHON_PARTICLES.to_string();
    let program = format!("{EXAMPLES}/sampler.py");
    let in_python = scratch.pipeline_with("sampler", &[&python, &program, &particles]);
    let (forecasts, report) = (scratch.path("forecasts.jsonl"), scratch.path("report.json"));
    // Without forecasts as a prior, both runs have the same tracks and therefore the same controls.
    let shared = [
        "run",
        "--ticks",
        "30",
        "--agents",
        "6",
        "--speed",
        "max",
        "--quiet",
        "--set",
        "tracker.prior=kinematic",
        "--forecasts",
        &forecasts,
        "--report",
        &report,
    ];
    let rust = RUST_PARTICLES.to_string();
    let particles = format!("sampler.particles={rust}");
    let of_rust =
        ["sampler.retrieval=false", "sampler.evidence=false", "sampler.propagation=monte-carlo", &particles];
    run_well(&[&shared[..], &of_rust.map(|option| ["--set", option]).concat()].concat());
    let built_in = learned(&scratch.read("forecasts.jsonl"));
    run_well(&[&shared[..], &["--pipeline", &in_python]].concat());
    let own = learned(&scratch.read("forecasts.jsonl"));

    assert!(built_in.len() > 60, "{} learned forecasts", built_in.len());
    assert!(
        built_in.iter().map(|(key, _)| key).eq(own.iter().map(|(key, _)| key)),
        "the same tracks are forecast"
    );
    // The means differ by their Monte Carlo errors. The squared differences, in units of the expected
    // variance, average 1. The variances within the modes agree on average.
    let (mut squares, mut len, mut ratio) = (0.0, 0.0, 0.0);
    for ((_, a), (_, b)) in built_in.iter().zip(&own) {
        let modes: f64 = a.probability.iter().map(|p| p * p).sum();
        for step in 0..a.mean_m.len() {
            for axis in 0..2 {
                let variance = 0.5 * (a.within(step, axis) + b.within(step, axis));
                if variance > 1e-4 {
                    let expected = variance * modes * (1.0 / RUST_PARTICLES + 1.0 / PYTHON_PARTICLES);
                    squares += (a.mean_m[step][axis] - b.mean_m[step][axis]).powi(2) / expected;
                    ratio += (b.within(step, axis) / a.within(step, axis)).ln();
                    len += 1.0;
                }
            }
        }
    }
    // The variance of n particles about their own mean is too small by the factor (n − 1) / n.
    let bias = ((PYTHON_PARTICLES - 1.0) / PYTHON_PARTICLES) / ((RUST_PARTICLES - 1.0) / RUST_PARTICLES);
    let (mean_square, ratio) = (squares / len, (ratio / len).exp() / bias);
    println!(
        "{len} positions: mean squared error {mean_square:.3} of what is expected, variances {ratio:.3}"
    );
    assert!((0.7..1.4).contains(&mean_square), "{mean_square}");
    assert!((0.95..1.05).contains(&ratio), "{ratio}");

    let report: Value = serde_json::from_slice(&scratch.read("report.json")).expect("JSON");
    let stages = report["stages"].as_array().expect("stages");
    let sampler = stages.iter().find(|stage| stage["name"] == "sampler").expect("the sampler has a row");
    assert_eq!(
        (&sampler["ticks"], sampler["compute_ms"]["p50"].as_f64() > Some(0.0)),
        (&30.into(), true),
        "{sampler:#}"
    );
}
