//! `verify` on the reference vectors of filters and tracking measures, and on folders with errors.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on should panic")]

use std::fs;
use std::path::{Path, PathBuf};

use verifier::{Comparison, VerifyError, verify};

/// A cell of a file, its new content, the vector that is then wrong, and the place in the vector.
type WrongCell = (&'static str, [usize; 2], &'static str, &'static str, &'static [usize]);

fn shared(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared").join(path)
}

fn copy_all(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        if path.is_file() {
            fs::copy(&path, to.join(path.file_name().unwrap())).unwrap();
        }
    }
}

/// A folder with the vectors that are stored beside the crates that they test.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let filters = shared("filters/tests/golden");
    copy_all(&filters, &folder.path().join("filters"));
    copy_all(&filters.join("unit"), &folder.path().join("unit"));
    let association = shared("association/tests/golden");
    copy_all(&association.join("assignment"), &folder.path().join("assignment"));
    copy_all(&association.join("unit"), &folder.path().join("unit"));
    copy_all(&shared("metrics/tests/golden/tracking"), &folder.path().join("metrics"));
    // The largest matrices are not among the copies.
    let assignment = folder.path().join("assignment");
    let index = fs::read_to_string(assignment.join("index.csv")).unwrap();
    let is_there = |line: &&str| {
        let file = line.split(',').nth(3).unwrap();
        file == "file" || assignment.join(file).exists()
    };
    fs::write(assignment.join("index.csv"), index.lines().filter(is_there).collect::<Vec<_>>().join("\n"))
        .unwrap();
    let gated = fs::read_to_string(assignment.join("gated.json")).unwrap();
    let mut problems: Vec<serde_json::Value> = serde_json::from_str(&gated).unwrap();
    problems.retain(|problem| assignment.join(problem["file"].as_str().unwrap()).exists());
    fs::write(assignment.join("gated.json"), serde_json::to_string(&problems).unwrap()).unwrap();
    folder
}

/// Replaces the first `from` in a file by `to`.
fn change(folder: &Path, file: &str, from: &str, to: &str) {
    let path = folder.join(file);
    let text = fs::read_to_string(&path).unwrap();
    assert!(text.contains(from), "{file} does not contain {from}");
    fs::write(path, text.replacen(from, to, 1)).unwrap();
}

/// Replaces a cell of a CSV file. Lines count from 0 at the header line.
fn change_cell(folder: &Path, file: &str, [line, column]: [usize; 2], to: &str) {
    let path = folder.join(file);
    let text = fs::read_to_string(&path).unwrap();
    let mut lines: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
    lines[line][column] = to;
    fs::write(path, lines.iter().map(|cells| cells.join(",")).collect::<Vec<_>>().join("\n")).unwrap();
}

fn off(folder: &Path) -> Vec<Comparison> {
    verify(folder).unwrap().into_iter().filter(|row| !row.agrees()).collect()
}

#[test]
fn every_number_is_reproduced() {
    let rows = verify(folder().path()).unwrap();
    for part in ["filters/", "assignment/", "metrics/", "unit/"] {
        let len = rows.iter().filter(|row| row.name.starts_with(part)).count();
        assert!(len >= 10, "{part}: {len} vectors");
    }
    for row in rows {
        assert!(row.agrees(), "{row:?}");
    }
}

#[test]
fn a_wrong_number_is_found_and_named() {
    let cases: [WrongCell; 6] = [
        ("filters/cv_kf.csv", [11, 3], "1.25", "filters/cv_kf.mean", &[10, 1]),
        ("filters/ekf_bic_posonly.csv", [40, 4], "3.5", "filters/ekf_bic_posonly.mean", &[39, 2]),
        ("filters/ca_kf.csv", [3, 8], "nan", "filters/ca_kf.covariance", &[2, 0]),
        ("filters/cv_kf.csv", [2, 16], "nan", "filters/cv_kf.nis", &[1, 0]),
        ("assignment/geo_3x5.csv", [1, 2], "-4000", "assignment/geo_3x5.cost", &[0]),
        ("assignment/index.csv", [1, 4], "1.5568", "assignment/geo_3x5.cost", &[0]),
    ];
    for (file, cell, to, name, worst) in cases {
        let folder = folder();
        change_cell(folder.path(), file, cell, to);
        let rows = off(folder.path());
        let [row] = rows.as_slice() else { panic!("{file}: {rows:?}") };
        assert_eq!((row.name.as_str(), row.worst.as_slice()), (name, worst), "{file}");
    }
    let cases = [
        (
            "metrics/mot_expected.json",
            "\"mota\": 0.7921146",
            "\"mota\": 0.7921246",
            "metrics/motmetrics.mota",
        ),
        ("metrics/mot_expected.json", "0.4623655913978", "0.4623695913978", "metrics/HOTA.DetA"),
        ("metrics/gospa_ospa.json", "\"gospa\": 0.32", "\"gospa\": 0.33", "metrics/gospa_ospa.gospa"),
        ("unit/jacobian.json", "0.09990804414327077", "0.09991804414327077", "unit/jacobian.J"),
        ("unit/pf_small.json", "11.529013889823265", "11.529013999823265", "unit/pf_small.ess"),
        ("unit/jpda.json", "0.3525726276471044", "0.3525736276471044", "unit/jpda.0.beta"),
    ];
    for (file, from, to, name) in cases {
        let folder = folder();
        change(folder.path(), file, from, to);
        let names: Vec<_> = off(folder.path()).into_iter().map(|row| row.name).collect();
        assert_eq!(names, [name], "{file}");
    }
}

/// A wrong measurement moves the track, so all later estimates of the filters differ.
#[test]
fn a_wrong_measurement_is_found_by_every_filter() {
    let folder = folder();
    change_cell(folder.path(), "filters/meas.csv", [6, 4], "50.0");
    let rows = off(folder.path());
    for run in ["cv_kf", "ca_kf", "ekf_bic_heading", "ekf_bic_posonly"] {
        let of_run = rows.iter().filter(|row| row.name.starts_with(&format!("filters/{run}.")));
        assert!(of_run.count() >= 2, "{run}: {rows:?}");
    }
}

#[test]
fn parts_of_a_folder_are_enough() {
    let folder = folder();
    for part in ["filters", "assignment", "metrics"] {
        fs::remove_dir_all(folder.path().join(part)).unwrap();
    }
    fs::remove_file(folder.path().join("unit/jpda.json")).unwrap();
    let rows = verify(folder.path()).unwrap();
    assert!(rows.iter().all(|row| row.name.starts_with("unit/") && row.agrees()), "{rows:?}");
}

#[test]
fn errors_of_broken_files_contain_name_and_line() {
    let broken: [(&str, [usize; 2], &str, &str); 6] = [
        ("filters/cv_kf.csv", [5, 3], "east", "cv_kf.csv: line 6: \"east\" is not a number"),
        ("filters/cv_kf.csv", [7, 1], "77", "cv_kf.csv: line 8: track 0, tick 77, where track 0, tick 6"),
        ("filters/meas.csv", [4, 1], "9", "meas.csv: line 5: tick 9 of track 0 where 3 comes next"),
        ("assignment/geo_6x6.csv", [2, 1], "1,2", "geo_6x6.csv: line 3: 7 cells where the first row has 6"),
        ("assignment/index.csv", [2, 3], "other.csv", "other.csv: there is no such file"),
        ("metrics/gt.csv", [3, 2], "inf", "frame 2: truth 0: position (inf, 0) is not finite"),
    ];
    for (file, cell, to, message) in broken {
        let folder = folder();
        change_cell(folder.path(), file, cell, to);
        let error = verify(folder.path()).unwrap_err();
        assert!(matches!(error, VerifyError::Malformed { .. }), "{error}");
        assert!(error.to_string().contains(message), "{error}");
    }
    let broken = [
        ("filters/parameters.json", "\"dt_s\": 0.08", "\"dt_s\": 8", "dt_s 8 is not above 0"),
        ("metrics/mot_expected.json", "max(0,1-d/2.0)", "exp(-d)", "similarity \"exp(-d)\""),
        (
            "metrics/mot_expected.json",
            "\"mota\"",
            "\"nota\"",
            "motmetrics, nota: nothing computes this figure",
        ),
        ("unit/jpda.json", "\"PD\": 0.9", "\"PD\": 1.0", "jpda.json: case 0"),
        ("unit/pf_small.json", "ESS<N/2", "ESS<N", "pf_small.json: model"),
        ("unit/sample_prior.json", "\"tau\": 5", "\"tau\": 55", "sample_prior.json: tau 55"),
    ];
    for (file, from, to, message) in broken {
        let folder = folder();
        change(folder.path(), file, from, to);
        let error = verify(folder.path()).unwrap_err().to_string();
        assert!(error.contains(message), "{error}");
    }
}

#[test]
fn files_that_nothing_computes_are_refused() {
    let folder = folder();
    fs::write(folder.path().join("filters/ctrv.csv"), "track,k\n").unwrap();
    let error = verify(folder.path()).unwrap_err().to_string();
    assert!(error.contains("ctrv.csv: nothing computes its numbers"), "{error}");

    let empty = tempfile::tempdir().unwrap();
    let error = verify(empty.path()).unwrap_err();
    assert!(matches!(error, VerifyError::NoVectors { .. }), "{error}");
    assert!(error.to_string().contains("scene.json") && error.to_string().contains("assignment"), "{error}");
}
