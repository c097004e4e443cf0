#![expect(clippy::unwrap_used, reason = "a test that can't write its files has failed")]

use std::fmt::Write as _;
use std::path::Path;

use evaluator::driving::{evaluate, sources, under_noise};
use evaluator::fleet::{Learned, learn, outcomes, priors};
use evaluator::{EvaluateError, MapChoice, Noise, Options, Page};
use evidence::Prior;
use scene::AgentType;

/// A 30 s recording at 10 Hz: vehicles in separate lanes, each at a constant speed.
fn steady(path: &Path, agents: u64) {
    let mut rows = String::from("stamp_s,id,type,x_m,y_m,heading_rad,speed_mps,length_m,width_m\n");
    for tick in 0..300 {
        let stamp_s = f64::from(tick) / 10.0;
        for agent in 1..=agents {
            let (speed, y) = (8.0 + agent as f64, 4.0 * agent as f64);
            let x = speed * stamp_s;
            writeln!(rows, "{stamp_s:.2},{agent},vehicle,{x:.3},{y:.3},0.0,{speed:.2},4.5,1.8")
                .expect("a string takes what is written");
        }
    }
    std::fs::write(path, rows).expect("the recording is written");
}

fn options(folder: &Path, evidence: bool) -> Options {
    let (data, map) = (folder.to_owned(), MapChoice::None);
    Options { data, map, evidence, threads: 2, ..Options::default() }
}

/// A folder of sources with this number of recordings of this number of agents.
pub fn sources_of(names: &[&str], files: usize, agents: u64) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in names {
        let source = folder.path().join("driving").join(name);
        std::fs::create_dir_all(&source).unwrap();
        (0..files).for_each(|file| steady(&source.join(format!("{file}.csv")), agents));
    }
    folder
}

#[test]
fn steady_vehicles_are_no_further_than_constant_velocity_has_them() {
    let folder = sources_of(&["one", "two"], 2, 6);
    let report = evaluate(&options(folder.path(), true), |_| ()).unwrap();
    let page = report.page();
    let cells = &page.json["tables"][0]["rows"];
    for cell in cells.as_array().unwrap() {
        let ade_m = |method: &str| cell[method]["ADE"].as_f64().unwrap();
        assert!(ade_m("constant velocity") < 0.1, "{cell}");
        assert!(ade_m("single best") < 0.3, "{cell}");
        assert!(ade_m("best of 20") < 0.5, "{cell}");
        // 6 agents in 2 recordings, with about 25 s of forecasts, one every 0.4 s.
        assert!((500.0..900.0).contains(&cell["forecasts"].as_f64().unwrap()), "{cell}");
    }
    assert_eq!(cells.as_array().unwrap().len(), 2);
    assert!(page.markdown.contains("| one "), "{}", page.markdown);
    let priors = report.priors(2);
    assert!(priors.sources.keys().eq(["one", "two"]) && priors.pattern_without.keys().eq(["one", "two"]));
    // The recordings contain vehicles only.
    let [of_vehicles, of_cyclists] =
        [AgentType::Vehicle, AgentType::Cyclist].map(|agent_type| priors.pattern[agent_type.index()]);
    let default = Prior::default().0[0].map(|context| context.pattern);
    assert!(of_vehicles != default && of_cyclists == default);
    assert!(priors == report.priors(1), "any number of threads makes the same");
    // The recordings contain no pedestrians, so their prior is the one that the source began with.
    let began_with_nothing = Options { priors: false, ..options(folder.path(), true) };
    let nothing = evaluate(&began_with_nothing, |_| ()).unwrap().priors(2);
    let of_pedestrians =
        |prior: &Prior| prior.0[AgentType::Pedestrian.index()].map(|context| context.deviation_m);
    assert!(of_pedestrians(&nothing.sources["one"]) == of_pedestrians(&Prior::default()));
    assert!(of_pedestrians(&priors.sources["one"]) != of_pedestrians(&Prior::default()));
}

#[test]
fn any_number_of_threads_makes_the_same_report() {
    let folder = sources_of(&["one", "two"], 1, 8);
    let csv =
        |threads| evaluate(&Options { threads, ..options(folder.path(), true) }, |_| ()).unwrap().page().csv;
    assert_eq!(csv(1), csv(2));
}

#[test]
fn a_sensor_without_errors_changes_no_figure_and_one_with_errors_does() {
    let folder = sources_of(&["one"], 1, 6);
    let report =
        |noise: Noise| evaluate(&Options { noise, ..options(folder.path(), true) }, |_| ()).unwrap().page();
    let clean = report(Noise::default());
    let other_seed = report(Noise { seed: 9, lag_s: 0.3, ..Noise::default() });
    assert_eq!((&clean.csv, &clean.markdown), (&other_seed.csv, &other_seed.markdown));
    let noisy = Noise { sigma_m: 0.3, positions_only: true, ..Noise::default() };
    let forecasts = |page: &Page| {
        let cell = &page.json["tables"][0]["rows"][0];
        (cell["forecasts"].as_f64().unwrap(), cell["constant velocity"]["FDE"].as_f64().unwrap())
    };
    let (count, clean_m) = forecasts(&clean);
    for without_ids in [false, true] {
        let report = report(Noise { without_ids, ..noisy });
        let (noisy_count, noisy_m) = forecasts(&report);
        assert!((noisy_count - count).abs() * 20.0 < count, "{noisy_count} forecasts, {count} without noise");
        assert!(noisy_m > clean_m + 1.0, "{noisy_m} m, {clean_m} m without noise");
        let expected =
            if without_ids { "--noise 0.3 --no-ids --positions" } else { "--noise 0.3 --positions" };
        assert!(report.markdown.contains(expected));
    }
}

#[test]
fn the_truth_has_no_noise() {
    let folder = sources_of(&["one"], 1, 3);
    let options = Options { evidence: false, ..options(folder.path(), true) };
    let report = under_noise(&options, 1, |_| ()).unwrap();
    let rows = report.json["tables"][0]["rows"].as_array().unwrap();
    let number = |row: &serde_json::Value, column: &str| row[column].as_f64().unwrap();
    assert!((number(&rows[0], "FDE / clean") - 1.0).abs() < 1e-9);
    for row in rows {
        // Constant velocity from the true state is exact, except that the recording rounds to 1 mm.
        let steady_m = number(row, "FDE") / number(row, "FDE / true CV");
        assert!(steady_m < 0.05, "{steady_m} m: {row}");
    }
    let of = |noise: &str| {
        let is_row = |row: &&serde_json::Value| {
            row["noise"] == noise && row["fields"] == "positions" && row["detections"] == "ids"
        };
        number(rows.iter().find(is_row).unwrap(), "FDE")
    };
    assert!(of("0.3 m") > 1.1 * of("0.05 m"), "{} m, {} m", of("0.3 m"), of("0.05 m"));
}

#[test]
fn a_missing_folder_and_an_unknown_source_are_named() {
    let folder = sources_of(&["one"], 0, 0);
    let missing = evaluate(&options(&folder.path().join("none"), true), |_| ()).err().unwrap();
    assert!(
        matches!(&missing, EvaluateError::Unusable { of, .. } if of.ends_with("none/driving")),
        "{missing}"
    );
    let unknown = sources(&folder.path().join("driving"), &["three".to_owned()]).unwrap_err().to_string();
    assert!(unknown.contains("three") && unknown.contains("one"), "{unknown}");
}

#[test]
fn fast_sources_are_also_shown_at_twice_their_scale() {
    let folder = sources_of(&["mona"], 1, 1);
    let names: Vec<(String, f32)> = sources(&folder.path().join("driving"), &[])
        .unwrap()
        .into_iter()
        .map(|source| (source.name, source.scale))
        .collect();
    assert_eq!(names, [("mona".to_owned(), 1.0), ("mona ×2".to_owned(), 2.0)]);
}

/// The run of a recording with default options.
fn run() -> run::Run {
    run::Run { lockstep: true, ..run::Run::default() }
}

#[test]
fn outcomes_have_a_row_per_agent_and_tick_with_the_errors_that_the_recording_shows() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.csv");
    steady(&path, 4);
    let weights = nn::Weights::onboard();
    let play = || outcomes(data::open(&path, None).unwrap(), &run(), weights.config(), None).unwrap().0.rows;
    let rows = play();
    assert!((1_100..=1_200).contains(&rows.len()), "{} rows of 4 agents in 300 ticks", rows.len());
    assert!(rows == play(), "the same bytes twice");
    let horizon_ns = (weights.config().horizon_len as u64 * weights.config().step_ns()).cast_signed();
    let end_ns = 29_900_000_000;
    for row in &rows {
        assert_eq!(row.errors.is_some(), row.stamp_ns + horizon_ns <= end_ns, "{row:?}");
        assert!(row.contact.is_none(), "each vehicle has its own lane: {row:?}");
    }
    let matured: Vec<_> = rows.iter().filter_map(|row| row.errors).collect();
    let mean_m = matured.iter().map(|errors| errors.steady.ade_m).sum::<f64>() / matured.len() as f64;
    assert!(mean_m < 0.1, "{mean_m}");
}

#[test]
fn learned_evidence_merges_to_priors_that_a_sampler_takes() {
    let folder = tempfile::tempdir().unwrap();
    let weights = nn::Weights::onboard();
    let learned = |agents: u64| {
        let path = folder.path().join(format!("{agents}.csv"));
        steady(&path, agents);
        learn(data::open(&path, None).unwrap(), &run(), weights.config()).unwrap()
    };
    let recordings = [learned(5), learned(6)];
    let texts = recordings.each_ref().map(|of| serde_json::to_string(of).unwrap());
    let again: Vec<Learned> = texts.iter().map(|text| serde_json::from_str(text).unwrap()).collect();
    let merged = priors(&[("road".to_owned(), recordings.to_vec())].into());
    assert_eq!(priors(&[("road".to_owned(), again)].into()).to_json(), merged.to_json());
    assert!(merged.sources.keys().eq(["road"]));
    assert!(merged.all() != Prior::default(), "vehicles at 9 to 14 m/s were seen");
    assert!(evidence::Priors::from_json(&merged.to_json()).is_ok());
}
