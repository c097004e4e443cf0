//! The lines of `--forecasts` give the figures of every table again.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on should panic")]

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use data::sets::Part;
use evaluator::{ForecastLines, InteractionPart, Options, Report, WeightsChoice, driving, tracking};
use serde_json::Value;

use crate::report;

/// Options for the validation part of the sets in a folder, by the shipped weights of each recipe.
fn options(data: &Path) -> Options {
    let weights = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/weights");
    Options {
        data: data.to_owned(),
        part: Part::Validation,
        weights: WeightsChoice { folder: weights, ..WeightsChoice::default() },
        threads: 2,
        ..Options::default()
    }
}

/// The result of an evaluation, and its lines.
fn with_lines<R>(options: Options, evaluate: impl FnOnce(&Options) -> R) -> (R, Vec<Value>) {
    let file = tempfile::NamedTempFile::new().unwrap();
    let lines = Arc::new(ForecastLines::to(file.reopen().unwrap()));
    let result = evaluate(&Options { lines: Some(lines.clone()), ..options });
    lines.finish().unwrap();
    let text = std::fs::read_to_string(file.path()).unwrap();
    (result, text.lines().map(|line| serde_json::from_str(line).unwrap()).collect())
}

fn write(path: PathBuf, text: &str) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, text).unwrap();
}

fn numbers(of: &Value) -> Vec<f64> {
    of.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

fn apart(a: &Value, b: &Value) -> f64 {
    let (a, b) = (numbers(a), numbers(b));
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Mean and final distance of a path from the truth. Both are written as f32.
fn errors(path: &Value, truth: &Value) -> [f64; 2] {
    let steps = path.as_array().unwrap().iter().zip(truth.as_array().unwrap());
    let apart = steps.map(|steps| {
        let [at, truth] = [steps.0, steps.1].map(|of| numbers(of).into_iter().map(|x| f64::from(x as f32)));
        let off: Vec<f64> = at.zip(truth).map(|(at, truth)| at - truth).collect();
        off[0].hypot(off[1])
    });
    let apart: Vec<f64> = apart.collect();
    [apart.iter().sum::<f64>() / apart.len() as f64, apart[apart.len() - 1]]
}

/// Compares all errors over the whole horizon with the lines of their parts. Returns the number of figures that
/// have lines.
fn check(report: &Report, lines: &[Value], is_of: impl Fn(&str, &str) -> bool) -> usize {
    let end_s = report.figures.iter().map(|figure| figure.horizon_s).fold(0.0, f64::max);
    let mut checked = 0;
    for figure in report.figures.iter().filter(|figure| figure.horizon_s == end_s) {
        let place = ["ADE, ", "FDE, "].iter().position(|name| figure.quantity.starts_with(name));
        let key = [("K = 1", "single_m"), ("minADE₂₀ / minFDE₂₀", "modes_m")];
        let key = key.into_iter().find(|(measure, _)| *measure == figure.measure);
        let (Some(place), Some((_, key))) = (place, key) else { continue };
        let counted = lines.iter().filter(|line| {
            let is_in = line["subsets"].as_array().unwrap().contains(&figure.subset.into());
            is_in && is_of(line["part"].as_str().unwrap(), &figure.part)
        });
        let error = |line: &Value| {
            let (of, truth) = (&line["forecasts"][figure.method][key], &line["truth_m"]);
            let least = match (of, key) {
                (Value::Null, _) => return None,
                (path, "single_m") => errors(path, truth)[place],
                (modes, _) => {
                    let modes = modes.as_array().unwrap().iter();
                    modes.map(|mode| errors(mode, truth)[place]).fold(f64::INFINITY, f64::min)
                }
            };
            let pixel_m = line["pixel_m"].as_f64().filter(|_| figure.quantity.ends_with("px"));
            Some(least / pixel_m.unwrap_or(1.0))
        };
        let errors: Vec<f64> = counted.filter_map(error).collect();
        if errors.is_empty() {
            continue;
        }
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        assert!((mean - figure.value).abs() < 1e-9 * mean.max(1.0), "{mean}: {figure:?}");
        assert_eq!(errors.len() as u64, figure.agents, "{figure:?}");
        checked += 1;
    }
    checked
}

/// Pedestrians in rows of (frame, identity, x, y), `step` frames apart.
fn walkers(frames: usize, step: usize) -> String {
    let mut rows = String::new();
    for (frame, id) in (0..frames).flat_map(|frame| (1..=3).map(move |id| (frame, id))) {
        let (t, speed) = (frame as f64 * 0.4, 0.8 + 0.2 * f64::from(id));
        let _ =
            writeln!(rows, "{}\t{id}\t{:.3}\t{:.3}", frame * step, speed * t, f64::from(id) + 0.1 * t.sin());
    }
    rows
}

/// Cars in INTERACTION's format: one turns, one drives straight on, one stands.
fn cars(seconds: usize) -> String {
    let mut rows = "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width\n".to_owned();
    for (frame, id) in (1..=10 * seconds).flat_map(|frame| (1..=3).map(move |id| (frame, id))) {
        let t = frame as f64 * 0.1;
        let (x, y, vx, vy, heading) = match id {
            1 => {
                let angle = 0.15 * t;
                (40.0 * angle.sin(), 40.0 - 40.0 * angle.cos(), 6.0 * angle.cos(), 6.0 * angle.sin(), angle)
            }
            2 => (8.0 * t, -6.0, 8.0, 0.0, 0.0),
            _ => (20.0, 12.0, 0.0, 0.0, 1.0),
        };
        let _ = writeln!(
            rows,
            "{id},{frame},{},car,{x:.4},{y:.4},{vx:.4},{vy:.4},{heading:.4},4.5,1.8",
            100 * frame
        );
    }
    rows
}

/// Writes recordings of two sites, one for each part of the set.
fn write_sites(root: &Path, seconds: usize) {
    for site in ["DR_USA_Roundabout_FT", "DR_USA_Intersection_GL"] {
        for number in 0..3 {
            let name = format!("interaction/recorded_trackfiles/{site}/vehicle_tracks_00{number}.csv");
            write(root.join(name), &cars(seconds + number));
        }
    }
}

#[test]
fn lines_of_recordings_give_their_figures() {
    let folder = tempfile::tempdir().unwrap();
    let path = report::traffic(folder.path());
    let [(one, lines), (_, same)] = [1, 3].map(|threads| {
        with_lines(report::options(folder.path(), None, threads), |options| report::evaluate(options, &path))
    });
    assert!(lines == same, "any number of threads writes the same");
    // ADE and FDE of 13 rows (anchors need a training part), for all agents and moving ones.
    assert_eq!(check(&one.unwrap(), &lines, |line, part| line == part), 2 * 13 * 2, "{} lines", lines.len());
}

#[test]
fn lines_of_eth_ucy_give_its_figures() {
    let root = tempfile::tempdir().unwrap();
    for fold in ["eth", "hotel", "univ", "zara1", "zara2"] {
        for part in ["train", "val"] {
            write(root.path().join(format!("eth_ucy/{fold}/{part}/a.txt")), &walkers(30, 10));
        }
    }
    let (report, lines) = with_lines(options(root.path()), |options| evaluator::eth_ucy(options, |_| ()));
    let checked = check(&report.unwrap(), &lines, |line, part| line == part || part == "all folds, pooled");
    // ADE and FDE of 14 rows, for five folds and all of them, under both rules.
    assert_eq!(checked, 2 * 14 * 6 * 2, "{} lines", lines.len());
}

#[test]
fn lines_of_sdd_give_its_figures_in_pixels_and_metres() {
    let root = tempfile::tempdir().unwrap();
    for scene in ["bookstore_0", "gates_0"] {
        write(root.path().join(format!("sdd/trajnet/train/{scene}.txt")), &walkers(20, 12));
    }
    let head = "File\tDataset\tNr\tVersion\tFeet\tInch\tMeters\tPixel X\tPixel Y\tPixel Dist\tAverage\tDiff\tRatio\n";
    let row =
        |scene: &str| format!("{scene}.jpg\tX\t0\tA\t60\t0\t18.288\t446\t112\t459.8\t461.2\t2.7\t0.0397\n");
    write(
        root.path().join("sdd/trajnet/H_SDD.txt"),
        &(head.to_owned() + &row("bookstore_0") + &row("gates_0")),
    );
    let (report, lines) = with_lines(options(root.path()), |options| evaluator::sdd(options, |_| ()));
    assert_eq!(check(&report.unwrap(), &lines, |line, part| line == part), 2 * 14 * 2);
}

#[test]
fn lines_of_interaction_give_its_figures() {
    let root = tempfile::tempdir().unwrap();
    write_sites(root.path(), 9);
    let parts = [InteractionPart::Seen, InteractionPart::HeldOut("FT".to_owned())];
    let (report, lines) =
        with_lines(options(root.path()), |options| evaluator::interaction(options, &parts, |_| ()));
    let is_of = |line: &str, part: &str| {
        let pooled = part.strip_prefix("held-out FT").filter(|rest| !rest.contains(" part"));
        line == part || pooled.is_some_and(|motion| line.starts_with("held-out FT") && line.ends_with(motion))
    };
    let checked = check(&report.unwrap(), &lines, is_of);
    // Two seen sites and two columns of the held-out one, all agents and moving ones, with two kinds of motion.
    assert!(checked >= 2 * 12 * 4 * 4, "{checked} figures");
}

#[test]
fn lines_of_driving_give_its_errors() {
    let folder = crate::driving::sources_of(&["one", "two"], 2, 6);
    let (page, lines) =
        with_lines(options(folder.path()), |options| driving::evaluate(options, |_| ()).unwrap().page());
    for cell in page.json["tables"][0]["rows"].as_array().unwrap() {
        let is_of = |line: &&Value| line["part"] == cell["source"] && line["type"] == cell["type"];
        let of_cell: Vec<&Value> = lines.iter().filter(is_of).collect();
        assert_eq!(cell["forecasts"], of_cell.len() as f64);
        for (method, name) in [("single best", "published"), ("constant velocity", "constant velocity")] {
            let ends =
                of_cell.iter().map(|line| errors(&line["forecasts"][name]["single_m"], &line["truth_m"])[1]);
            let mean = ends.sum::<f64>() / of_cell.len() as f64;
            let figure = cell[method]["FDE"].as_f64().unwrap();
            assert!((figure - mean).abs() < 1e-6, "{method}: {figure} {mean}");
        }
    }
    let straight = |line: &&Value| line["subsets"].as_array().unwrap().contains(&"straight".into());
    assert_eq!(lines.iter().filter(straight).count(), lines.len());
}

#[test]
fn lines_of_tracked_vehicles_give_their_errors() {
    let root = tempfile::tempdir().unwrap();
    write_sites(root.path(), 8);
    let (page, lines) = with_lines(options(root.path()), |options| {
        tracking::interaction(options, &[0.1], false, |_| ()).unwrap()
    });
    let mut checked = 0;
    for (table, key) in [(0, "position_m"), (1, "velocity_mps")] {
        for row in page.json["tables"][table]["rows"].as_array().unwrap() {
            let gaps_s = [("no gaps", 0.0), ("in gaps of 0.8 s", 0.8), ("in gaps of 1.6 s", 1.6)];
            for (column, gap_s) in gaps_s.into_iter().filter(|(column, _)| !row[column].is_null()) {
                let is_counted =
                    |line: &&Value| line["gap_s"] == gap_s && line["is_measured"] == (gap_s == 0.0);
                let of = |line: &Value| {
                    let track = &line["tracks"][row["method"].as_str().unwrap()];
                    apart(&track[key], &line["truth"][key])
                };
                let errors: Vec<f64> = lines.iter().filter(is_counted).map(of).collect();
                let mean = errors.iter().sum::<f64>() / errors.len() as f64;
                assert_eq!(row[column]["instants"], errors.len() as f64, "{row}");
                assert!((row[column]["MAE"].as_f64().unwrap() - mean).abs() < 1e-9, "{mean}: {row}");
                checked += 1;
            }
        }
    }
    assert!(checked >= 2 * 8 * 2, "{checked} figures");
}

#[test]
fn lines_of_tracks_in_gaps_give_their_errors() {
    let folder = crate::driving::sources_of(&["one"], 1, 12);
    let (page, lines) =
        with_lines(options(folder.path()), |options| driving::through_gaps(options, |_| ()).unwrap());
    let cells = page.json["tables"][0]["rows"].as_array().unwrap();
    assert!(!cells.is_empty());
    for cell in cells {
        let gap_s: f64 = cell["gap s"].as_str().unwrap().parse().unwrap();
        for prior in ["forecasts", "kinematic"] {
            let counted = lines.iter().filter(|line| line["gap_s"] == gap_s && line["type"] == cell["type"]);
            let square = |line: &Value| {
                apart(&line["tracks"][prior]["position_m"], &line["truth"]["position_m"]).powi(2)
            };
            let squares: Vec<f64> = counted.map(square).collect();
            assert_eq!(cell["positions"], squares.len() as f64);
            let rmse_m = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
            let figure = cell[format!("{prior} m")].as_f64().unwrap();
            assert!((figure - rmse_m).abs() < 1e-6, "{rmse_m}: {cell}");
        }
    }
}
