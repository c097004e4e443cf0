//! Files of a KITTI sequence that are read besides the named one.

use std::fs;
use std::path::Path;

use data::{Format, ReadError, Recording, open};
use tempfile::TempDir;
use wire::AgentType;

use crate::bad_input::{CALIBRATION, CARS, EGO_MOTION, LABELS};

/// Creates a folder with these files.
fn folder(files: &[(&str, &str)]) -> TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (path, text) in files {
        let path = folder.path().join(path);
        fs::create_dir_all(path.parent().expect("it is in a folder")).expect("a folder can be made");
        fs::write(path, text).expect("a file can be written");
    }
    folder
}

/// Numbers of detected cars, pedestrians and cyclists, and of true agents.
fn counts(recording: &Recording) -> [usize; 4] {
    let detections = || recording.frames.iter().flat_map(|frame| &frame.detections);
    let of = |kind: AgentType| detections().filter(|d| d.agent_type == kind as u32).count();
    let truth = recording.frames.iter().map(|frame| frame.truth.len()).sum();
    [of(AgentType::Vehicle), of(AgentType::Pedestrian), of(AgentType::Cyclist), truth]
}

fn read(folder: &TempDir, path: &str) -> Result<[usize; 4], ReadError> {
    open(&folder.path().join(path), None).map(|recording| counts(&recording))
}

/// `len` rows of a class.
fn rows(kind: &str, len: usize) -> String {
    CARS.replacen("0,2,", &format!("0,{kind},"), 1).repeat(len)
}

#[test]
fn the_named_file_is_read_with_the_classes_of_its_own_naming() {
    let [cars, more, pedestrians, cyclists] = [rows("2", 1), rows("2", 3), rows("1", 2), rows("3", 4)];
    let folder = folder(&[
        ("calib/0012.txt", CALIBRATION),
        ("oxts/0012.txt", EGO_MOTION),
        ("detection/pointrcnn_Car_val/0012.txt", &cars),
        ("detection/pointrcnn_Pedestrian_val/0012.txt", &pedestrians),
        ("detection/Car/0012.txt", &more),
        ("detection/Cyclist/0012.txt", &cyclists),
        ("detection/mine/0012.txt", &pedestrians),
        ("lower/car/0012.txt", &cars),
        ("lower/cyclist/0012.txt", &cyclists),
        ("lower/Pedestrian/0012.txt", &pedestrians),
    ]);
    for (path, expected) in [
        ("detection/pointrcnn_Car_val/0012.txt", [1, 2, 0, 0]),
        ("detection/pointrcnn_Pedestrian_val/0012.txt", [1, 2, 0, 0]),
        ("detection/Car/0012.txt", [3, 0, 4, 0]),
        ("detection/Cyclist/0012.txt", [3, 0, 4, 0]),
        // The folder's name contains no class, so only the file is read.
        ("detection/mine/0012.txt", [0, 2, 0, 0]),
        ("lower/cyclist/0012.txt", [1, 0, 4, 0]),
    ] {
        assert_eq!(read(&folder, path).unwrap(), expected, "{path}");
    }
    let wrong = folder.path().join("detection/Car/0013.txt");
    fs::write(&wrong, rows("1", 1)).unwrap();
    fs::copy(folder.path().join("calib/0012.txt"), folder.path().join("calib/0013.txt")).unwrap();
    fs::copy(folder.path().join("oxts/0012.txt"), folder.path().join("oxts/0013.txt")).unwrap();
    let error = open(&wrong, None).unwrap_err().to_string();
    assert!(error.contains("Car/0013.txt:1:3") && error.contains("expected 2"), "{error}");
}

#[test]
fn the_folders_of_kitti_itself_are_found() {
    let cars = rows("2", 1);
    let folder = folder(&[
        ("training/calib/0012.txt", CALIBRATION),
        ("training/oxts/0012.txt", EGO_MOTION),
        ("training/label_02/0012.txt", LABELS),
        ("testing/calib/0012.txt", CALIBRATION),
        ("testing/oxts/0012.txt", EGO_MOTION),
        ("detection/pointrcnn_Car_val/0012.txt", &cars),
        ("detection/pointrcnn_Car_test/0012.txt", &cars),
        ("results/mine/data/0012.txt", LABELS),
    ]);
    for (path, expected) in [
        ("training/label_02/0012.txt", [1, 0, 0, 1]),
        ("detection/pointrcnn_Car_val/0012.txt", [1, 0, 0, 1]),
        ("detection/pointrcnn_Car_test/0012.txt", [1, 0, 0, 0]),
        ("results/mine/data/0012.txt", [1, 0, 0, 1]),
    ] {
        assert_eq!(read(&folder, path).unwrap(), expected, "{path}");
    }
    fs::remove_file(folder.path().join("training/oxts/0012.txt")).unwrap();
    let error = read(&folder, "training/label_02/0012.txt").unwrap_err().to_string();
    assert!(error.contains("label_02/0012.txt") && error.contains("oxts"), "{error}");
}

/// Other formats: a named file is never replaced by another one.
#[test]
fn a_pedestrian_file_named_alone_is_read_alone() {
    let vehicles = "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width\n\
        1,1,100,car,1.0,2.0,0.1,0.2,0.5,4.5,1.8\n";
    let pedestrians = "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy\n\
        P1,1,100,pedestrian/bicycle,5.0,6.0,0.1,0.2\nP2,1,100,pedestrian/bicycle,7.0,6.0,0.1,0.2\n";
    let folder = folder(&[("vehicle_tracks_000.csv", vehicles), ("pedestrian_tracks_000.csv", pedestrians)]);
    let counts = |name: &str| {
        let recording = open(Path::new(&folder.path().join(name)), Some(Format::Interaction)).unwrap();
        counts(&recording)[..3].to_vec()
    };
    assert_eq!(counts("vehicle_tracks_000.csv"), [1, 2, 0]);
    assert_eq!(counts("pedestrian_tracks_000.csv"), [0, 2, 0]);
}
