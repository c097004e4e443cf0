//! States of recordings, merged in several ways.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on should panic")]

use std::path::PathBuf;

use data::OpenOptions;
use evaluator::{Evaluation, State};

use crate::report::{options, parked, straight, traffic};

/// Recordings of several kinds: all types, vehicles, standing, too short, and two that can't be read.
fn recordings(folder: &std::path::Path) -> Vec<PathBuf> {
    let broken = folder.join("broken.csv");
    std::fs::write(&broken, "stamp_s,id,type,x_m,y_m\n0.0,1,car,1,2\n").unwrap();
    let empty = folder.join("empty.csv");
    std::fs::write(&empty, "").unwrap();
    vec![straight(folder, 120), traffic(folder), parked(folder, 120), parked(folder, 40), broken, empty]
}

#[test]
fn states_of_single_files_merge_to_the_tables_of_all_files() {
    let folder = tempfile::tempdir().unwrap();
    let paths = recordings(folder.path());
    let evaluation = Evaluation::new(&options(folder.path(), None, 2), false).unwrap();
    let whole = evaluation.recordings(&paths, &OpenOptions::default(), |_| ()).unwrap();
    let (mut states, mut failures) = (Vec::new(), Vec::new());
    for path in &paths {
        let name = path.display().to_string();
        match evaluation.recording(path, OpenOptions::default()) {
            Ok(state) => states.push((name, state.to_bytes())),
            Err(why) => failures.push((name, why.to_string())),
        }
    }
    assert_eq!((states.len(), failures.len()), (4, 2));
    states.reverse();
    let read = states.iter().map(|(name, bytes)| Ok((name.clone(), State::from_bytes(name, bytes)?)));
    let mut merged = State::merged(read).unwrap();
    failures.iter().for_each(|(name, why)| merged.add_failure(name, why));
    assert!(merged.to_bytes() == whole.to_bytes());
    let [merged, whole] = [merged, whole].map(|state| state.report());
    assert_eq!(merged.text(), whole.text());
    assert_eq!(merged.markdown(), whole.markdown());
    assert_eq!(merged.csv(), whole.csv());
    assert_eq!(merged.json(), whole.json());
    assert_eq!(merged.warnings, whole.warnings);
}

#[test]
fn a_file_that_fails_is_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let paths = recordings(folder.path());
    let evaluation = Evaluation::new(&options(folder.path(), None, 2), false).unwrap();
    let of = |paths: &[PathBuf]| evaluation.recordings(paths, &OpenOptions::default(), |_| ());
    let report = of(&paths).unwrap().report();
    let [broken, empty] = &report.failed[..] else { panic!("{:?}", report.failed) };
    assert!(broken.contains("broken.csv:2:") && broken.contains("car"), "{broken}");
    assert!(empty.contains("empty.csv"), "{empty}");
    assert!(report.text().contains(&format!("\nFailed: {broken}\n")), "{}", report.text());
    assert_eq!(report.json()["failed"].as_array().unwrap().len(), 2);
    // The others are evaluated as without it.
    assert_eq!(of(&paths[..4]).unwrap().report().csv(), report.csv());
    // Nothing but failures is an error, which names the first one.
    let error = of(&paths[4..]).unwrap_err().to_string();
    assert!(error.contains("broken.csv:2:"), "{error}");
}

#[test]
fn doubts_are_counted_over_recordings() {
    let folder = tempfile::tempdir().unwrap();
    let row =
        |step: usize, heading: f64| format!("{:.1},1,vehicle,{},0,{heading},5\n", step as f64 * 0.1, step);
    let write = |name: &str, heading: f64| {
        let path = folder.path().join(name);
        let text: String = (0..120).map(|step| row(step, heading)).collect();
        std::fs::write(&path, "stamp_s,id,type,x_m,y_m,heading_rad,speed_mps\n".to_owned() + &text).unwrap();
        path
    };
    let paths = [write("a.csv", 3.0), write("b.csv", 3.0), straight(folder.path(), 120)];
    let evaluation = Evaluation::new(&options(folder.path(), None, 2), false).unwrap();
    let report = evaluation.recordings(&paths, &OpenOptions::default(), |_| ()).unwrap().report();
    assert!(report.warnings.len() >= 2, "{:?}", report.warnings);
    let counts: Vec<u64> = report.doubts.values().map(|count| count.recordings).collect();
    assert!(counts.contains(&2), "{:?}", report.doubts);
    assert!(report.doubts.values().all(|count| count.rows > 0 && count.of >= count.rows));
    assert!(report.text().contains("\nDoubt: "), "{}", report.text());
}
