//! End-to-end evaluations on recordings that the tests write.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on should panic")]

use crate::support::weights;
use std::path::{Path, PathBuf};

use data::{GeneratedScene, OpenOptions, SceneOptions};
use evaluator::{Cut, EvaluateError, Evaluation, Figure, Options, Report, WeightsChoice};

pub fn options(folder: &Path, weights: Option<PathBuf>, threads: usize) -> Options {
    let weights = WeightsChoice { file: weights, folder: folder.to_owned(), ..WeightsChoice::default() };
    Options { data: folder.to_owned(), weights, threads, ..Options::default() }
}

/// Vehicles that drive straight at a constant speed, each on its own line, for `steps` tenths of a second.
pub fn straight(folder: &Path, steps: usize) -> PathBuf {
    let mut text = "stamp_s,id,type,x_m,y_m,heading_rad,speed_mps,length_m,width_m\n".to_owned();
    for step in 0..steps {
        for (id, speed) in [(1, 5.0), (2, 8.0)] {
            let seconds = step as f64 * 0.1;
            let (x, y) = (speed * seconds, 10.0 * f64::from(id));
            text += &format!("{seconds:.1},{id},vehicle,{x:.4},{y:.1},0,{speed},4.5,1.8\n");
        }
    }
    let path = folder.join("straight.csv");
    std::fs::write(&path, text).unwrap();
    path
}

/// The same vehicles for 16 s at this frame rate. Frames are up to 4 ms off their grid.
fn straight_at(folder: &Path, hertz: f64, has_motion: bool) -> PathBuf {
    let mut text = "stamp_s,id,type,x_m,y_m,heading_rad,speed_mps\n".to_owned();
    for frame in 0..(16.0 * hertz) as usize {
        for (id, speed) in [(1, 5.0), (2, 8.0)] {
            let seconds = frame as f64 / hertz + 0.002 * f64::from(frame as u32 % 3);
            let motion = if has_motion { format!("0,{speed}") } else { ",".to_owned() };
            text += &format!("{seconds:.9},{id},vehicle,{},{id}0,{motion}\n", speed * seconds);
        }
    }
    let path = folder.join(format!("straight_{hertz}.csv"));
    std::fs::write(&path, text).unwrap();
    path
}

/// A vehicle that stands for `steps` tenths of a second.
pub fn parked(folder: &Path, steps: usize) -> PathBuf {
    let row = |step: usize| format!("{:.1},1,vehicle,3,4,0,0,4.5,1.8\n", step as f64 * 0.1);
    let head = "stamp_s,id,type,x_m,y_m,heading_rad,speed_mps,length_m,width_m\n";
    let path = folder.join(format!("parked_{steps}.csv"));
    std::fs::write(&path, head.to_owned() + &(0..steps).map(row).collect::<String>()).unwrap();
    path
}

/// Generated traffic with all agent types.
pub fn traffic(folder: &Path) -> PathBuf {
    let options = SceneOptions { agents: 10, identities: true, clutter_mean: 0.0, ..SceneOptions::default() };
    let scene = GeneratedScene::new(options);
    let mut text = "stamp_s,id,type,x_m,y_m\n".to_owned();
    for frame in scene.unwrap().recording(200).frames {
        for seen in frame.detections.iter().filter(|seen| seen.has(wire::detection_flags::HAS_ID)) {
            let agent_type = seen.agent_type().unwrap().name();
            let stamp_s = frame.stamp_ns as f64 * 1e-9;
            text += &format!("{stamp_s:.2},{},{agent_type},{},{}\n", seen.id, seen.x_m, seen.y_m);
        }
    }
    let path = folder.join("traffic.csv");
    std::fs::write(&path, text).unwrap();
    path
}

pub fn evaluate(options: &Options, path: &Path) -> Result<Report, EvaluateError> {
    evaluate_all(options, &[path.to_owned()])
}

fn evaluate_all(options: &Options, paths: &[PathBuf]) -> Result<Report, EvaluateError> {
    let evaluation = Evaluation::new(options, false)?;
    Ok(evaluation.recordings(paths, &OpenOptions::default(), |_| ())?.report())
}

/// A figure of all agents at the whole horizon.
fn figure(report: &Report, method: &str, measure: &str, quantity: &str) -> Figure {
    let wanted = |figure: &&Figure| {
        (figure.method, figure.measure, &figure.quantity[..]) == (method, measure, quantity)
            && figure.subset == "all"
            && figure.horizon_s > 4.5
    };
    report.figures.iter().find(wanted).unwrap_or_else(|| panic!("no {quantity} of {method}")).clone()
}

#[test]
fn constant_velocity_predicts_straight_motion_exactly() {
    let folder = tempfile::tempdir().unwrap();
    let path = straight(folder.path(), 120);
    let report = evaluate(&options(folder.path(), None, 2), &path).unwrap();
    for method in ["constant velocity", "constant acceleration", "CTRV", "CTRA, decaying"] {
        for quantity in ["ADE, m", "FDE, m"] {
            let error = figure(&report, method, "K = 1", quantity);
            assert!(error.value < 2e-3, "{error:?}");
        }
    }
    // The brief report has one row per type that is present.
    let brief = report.brief().unwrap();
    let rows: Vec<&str> = brief.lines().filter(|line| line.starts_with("| ")).skip(1).collect();
    assert!(rows.len() == 2 && brief.lines().count() <= 15, "{brief}");
    for (row, name) in rows.iter().zip(["all", "vehicle"]) {
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        assert_eq!((cells[1], cells[2]), (name, "22"), "{brief}");
        let published = figure(&report, "ours, online retrieval, evidence", "K = 1", "FDE, m").value;
        let shown: f64 = cells[3].rsplit(" / ").next().unwrap().parse().unwrap();
        assert!((shown - published).abs() < 2e-3, "{brief}");
    }
    // Eleven windows, at 2.8 to 6.8 s, with two vehicles each.
    assert_eq!(figure(&report, "ours", "K = 1", "ADE, m").agents, 22);
    assert_eq!(figure(&report, "ours", "", "collision rate, recorded futures, %").value, 0.0);
    assert_eq!(figure(&report, "ours", "", "forecasts that violate a limit, %").value, 0.0);
    let sampled = figure(&report, "CVM-S", "minADE₂₀ / minFDE₂₀", "FDE, m").value;
    assert!(sampled > 0.0 && sampled < 8.0 * 4.8, "{sampled}");
}

#[test]
fn straight_motion_is_predicted_exactly_from_any_rate() {
    let folder = tempfile::tempdir().unwrap();
    // A window of 8 + 12 steps of 0.4 s can begin in the first 8.4 s of 16 s.
    for (hertz, agents) in [(2.0, 34), (2.5, 42), (3.0, 50), (10.0, 42), (23.98, 40), (25.0, 42), (29.97, 42)]
    {
        for has_motion in [true, false] {
            let path = straight_at(folder.path(), hertz, has_motion);
            let report = evaluate(&options(folder.path(), None, 2), &path).unwrap();
            let error = figure(&report, "constant velocity", "K = 1", "FDE, m");
            assert!(error.value < 5e-3, "{hertz} Hz: {error:?}");
            let found = i64::try_from(error.agents).unwrap();
            assert!((agents - 2..=agents + 2).contains(&found), "{hertz} Hz: {found} agents, about {agents}");
            assert_eq!(report.warnings.as_slice(), &[] as &[String]);
        }
    }
}

#[test]
fn figures_do_not_depend_on_the_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let path = traffic(folder.path());
    let [one, three] = [1, 3].map(|threads| evaluate(&options(folder.path(), None, threads), &path).unwrap());
    assert!(one.figures.len() > 100);
    assert_eq!(one.csv(), three.csv());
    assert_eq!(one.markdown(), three.markdown());
}

#[test]
fn every_table_names_the_source_of_its_modes() {
    let folder = tempfile::tempdir().unwrap();
    let report = evaluate(&options(folder.path(), None, 2), &traffic(folder.path())).unwrap();
    let markdown = report.markdown();
    let tables: Vec<&str> = markdown.split("## ").skip(1).collect();
    assert!(tables.len() >= 8);
    for table in tables {
        assert!(table.contains("20 of 20 learned latent points, none selected"), "{table}");
    }
    let rows = report.csv();
    let columns = rows.lines().next().unwrap().split(',').count();
    assert_eq!(columns, 11);
    assert_eq!(report.json()["figures"].as_array().unwrap().len(), report.figures.len());
}

/// Our rows of one training are unchanged next to the rows of another training, and name their training.
#[test]
fn another_training_gets_rows_of_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let (path, other) = (traffic(folder.path()), folder.path().join("other.safetensors"));
    let halved =
        |_: &str, _: &mut Vec<usize>, values: &mut Vec<f32>| values.iter_mut().for_each(|x| *x *= 0.5);
    std::fs::write(&other, weights::changed(halved, |_| ())).unwrap();
    let mut report = evaluate(&options(folder.path(), None, 2), &path).unwrap();
    let other = evaluate(&options(folder.path(), Some(other), 2), &path).unwrap();
    // The cells after the method's name in our row of minADE₂₀ / minFDE₂₀.
    let row = |markdown: &str, method: &str| {
        let mut rows = markdown.lines().map(|line| line.split('|').map(str::trim).collect::<Vec<_>>());
        let found = rows.find(|row| row.get(1..3) == Some(&["minADE₂₀ / minFDE₂₀", method]));
        found.map(|row| row[3..].join(" ")).unwrap()
    };
    let [ours, theirs] = [&report, &other].map(|report| row(&report.markdown(), "ours"));
    assert_ne!(ours, theirs);
    report.add_beside(std::slice::from_ref(&other));
    let name = &other.provenance[0].sha256[..8];
    for markdown in [report.markdown(), report.summary()] {
        assert_eq!(row(&markdown, "ours"), ours);
        assert_eq!(row(&markdown, "ours, seed 1"), ours);
        assert_eq!(row(&markdown, &format!("ours, {name}")), theirs);
    }
}

#[test]
fn min_errors_are_at_most_joint_and_top_1_errors() {
    let folder = tempfile::tempdir().unwrap();
    let report = evaluate(&options(folder.path(), None, 2), &traffic(folder.path())).unwrap();
    for quantity in ["ADE, m", "FDE, m"] {
        let of = |measure| figure(&report, "ours", measure, quantity).value;
        assert!(of("minADE₂₀ / minFDE₂₀") <= of("joint minADE₂₀ / minFDE₂₀"));
        assert!(of("minADE₂₀ / minFDE₂₀") <= of("joint, by rank"));
        assert!(of("minADE₂₀ / minFDE₂₀") <= of("top-1"));
    }
}

#[test]
fn missing_weights_name_the_file_and_its_recipe() {
    let folder = tempfile::tempdir().unwrap();
    let error = evaluator::sdd(&options(folder.path(), None, 1), |_| ()).unwrap_err().to_string();
    assert!(error.contains("sdd.safetensors") && error.contains("stgdat train --recipe sdd"), "{error}");
}

#[test]
fn a_model_of_other_steps_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("short.safetensors");
    std::fs::write(&path, weights::changed(|_, _, _| (), |config| config.history_len = 5)).unwrap();
    let error = evaluator::sdd(&options(folder.path(), Some(path), 1), |_| ()).unwrap_err();
    assert!(matches!(error, EvaluateError::Steps { .. }), "{error}");
    assert!(error.to_string().contains("5 + 12 steps of 0.4 s"), "{error}");
}

#[test]
fn recordings_without_a_complete_agent_are_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let options = options(folder.path(), None, 2);
    let [whole, short] = [straight(folder.path(), 120), parked(folder.path(), 40)];
    let of = |paths: &[PathBuf]| evaluate_all(&options, paths);
    let alone = evaluate(&options, &whole).unwrap();
    for paths in [[whole.clone(), short.clone()], [short.clone(), whole]] {
        let report = of(&paths).unwrap();
        assert_eq!(report.csv(), alone.csv(), "the others are evaluated as without it");
        let name = format!("{}/parked_40", folder.path().file_name().unwrap().display());
        let line = format!("{name}: no agent is present over 20 steps of 0.4 s");
        assert_eq!(report.left_out, std::slice::from_ref(&line));
        assert_eq!(report.json()["left_out"][0], line);
        for text in [report.markdown(), report.summary()] {
            assert!(text.contains(&format!("Left out:\n\n* {line}\n")), "{text}");
        }
        assert_eq!(report.provenance.len(), 1);
    }
    assert!(alone.left_out.is_empty() && !alone.markdown().contains("Left out"));
    let error = of(&[short.clone(), parked(folder.path(), 41)]).unwrap_err();
    assert!(matches!(error, EvaluateError::NoWindows { .. }), "{error}");
    assert!(
        error.to_string().contains("parked_40, ") && error.to_string().contains("parked_41: "),
        "{error}"
    );
}

#[test]
fn a_recording_without_moving_agents_has_no_table_of_them() {
    let folder = tempfile::tempdir().unwrap();
    let options = options(folder.path(), None, 2);
    let stands = parked(folder.path(), 120);
    let report = evaluate(&options, &stands).unwrap();
    assert_eq!(report.left_out, ["moving agents: there are none"]);
    assert!(report.figures.iter().all(|figure| figure.subset == "all"));
    assert_eq!(figure(&report, "constant velocity", "K = 1", "FDE, m").value, 0.0);
    assert_eq!(figure(&report, "ours", "K = 1", "FDE, m").agents, 11);
    // Together with a recording that has moving agents, its column of moving agents is empty.
    let moves = straight(folder.path(), 120);
    let report = evaluate_all(&options, &[stands, moves]).unwrap();
    assert!(report.left_out.is_empty());
    let markdown = report.markdown();
    let table = markdown.split("Errors: moving agents").nth(1).unwrap();
    let row = table.lines().find(|line| line.contains("| K = 1") && line.contains("| ours ")).unwrap();
    let cells: Vec<&str> = row.split('|').map(str::trim).collect();
    assert_eq!((cells[3], cells[4] == cells[5]), ("-", true), "{row}");
}

#[test]
fn a_recording_that_is_too_short_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = straight(folder.path(), 40);
    let error = evaluate(&options(folder.path(), None, 1), &path).unwrap_err();
    assert!(matches!(error, EvaluateError::NoWindows { .. }), "{error}");
    let steps = Cut::of(nn::Weights::onboard().config());
    assert!(error.to_string().contains(&format!("{} steps", steps.history_len + steps.horizon_len)));
}
