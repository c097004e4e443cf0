//! The readers and windows on the real recordings, if they are available.

use std::path::{Path, PathBuf};

use data::formats::kitti::Annotations;
use data::sets::{DataSet, Fold, Part};
use data::{Format, Recording, WindowOptions, open, windows};
use testing::{public_recording, recordings_folder};
use wire::{AgentType, Detection, detection_flags};

/// The folder of the recordings, if it exists.
fn recordings() -> Option<PathBuf> {
    public_recording("eth_ucy").map(|_| recordings_folder())
}

fn read(path: &Path) -> Recording {
    open(path, None).unwrap_or_else(|error| panic!("{error}"))
}

fn files(set: DataSet, root: &Path, part: Part) -> Vec<PathBuf> {
    set.files(root, part).unwrap_or_else(|error| panic!("{error}"))
}

/// Asserts the invariants of every recording.
fn assert_sound(recording: &Recording) {
    assert!(!recording.frames.is_empty(), "{}", recording.name);
    let is_generated = recording.name.starts_with("generated/");
    assert_eq!(recording.sha256.len(), if is_generated { 0 } else { 64 });
    assert!(recording.interval_ns > 0);
    assert!(recording.frames.is_sorted_by(|a, b| a.stamp_ns < b.stamp_ns), "{}", recording.name);
    for frame in &recording.frames {
        for detection in &frame.detections {
            detection.check().unwrap_or_else(|error| panic!("{}: {error}", recording.name));
            assert!(frame.observed_types & (1 << detection.agent_type) != 0, "{}", recording.name);
            // Published recordings have one stamp per frame, so no two frames are joined.
            assert_eq!(detection.offset_ns, 0, "{}", recording.name);
        }
    }
}

fn row_count(recording: &Recording) -> usize {
    recording.frames.iter().map(|frame| frame.detections.len()).sum()
}

/// Numbers of windows and of pedestrians in them, counted as in the literature: present at all 20 steps,
/// alone or not.
fn eth_ucy_counts(root: &Path, fold: Fold) -> [usize; 4] {
    let options = WindowOptions::new(8, 12, 400_000_000);
    let mut counts = [0; 4];
    for file in files(DataSet::EthUcyFold(fold), root, Part::Test) {
        for window in windows(&read(&file), &options) {
            let pedestrians = window.agents.iter().filter(|agent| agent.is_complete()).count();
            if pedestrians > 1 {
                counts[0] += 1;
                counts[1] += pedestrians;
            }
            counts[2] += usize::from(pedestrians > 0);
            counts[3] += pedestrians;
        }
    }
    counts
}

#[test]
fn eth_ucy_has_the_window_counts_of_the_literature() {
    let Some(root) = recordings() else { return };
    assert_eq!(eth_ucy_counts(&root, Fold::Eth), [70, 181, 253, 364]);
    assert_eq!(eth_ucy_counts(&root, Fold::Hotel), [301, 1_053, 445, 1_197]);
    assert_eq!(eth_ucy_counts(&root, Fold::Univ)[..2], [947, 24_334]);
    assert_eq!(eth_ucy_counts(&root, Fold::Zara1), [602, 2_253, 705, 2_356]);
    assert_eq!(eth_ucy_counts(&root, Fold::Zara2), [921, 5_833, 998, 5_910]);
}

#[test]
fn obsmat_has_the_frames_of_the_eth_scene() {
    let Some(root) = recordings() else { return };
    let path = root.join("eth_ucy/obsmat/eth_0.4s.txt");
    let recording = read(&path);
    assert_sound(&recording);
    assert_eq!(row_count(&recording), 8_908);
    assert_eq!(recording.frames[0].stamp_ns, 52_000_000_000);
    assert_eq!(recording.frames[1].stamp_ns, 52_400_000_000);
}

#[test]
fn every_format_is_detected_and_read_whole() {
    let Some(root) = recordings() else { return };
    let cases = [
        ("eth_ucy/raw/students003.txt", Format::EthUcy, 17_953),
        ("eth_ucy/hotel/train/biwi_eth_train.txt", Format::EthUcy, 3_666),
        ("eth_ucy/obsmat/eth_0.4s.txt", Format::Obsmat, 8_908),
        ("sdd/trajnet/test/coupa_0.txt", Format::SddTrajnet, 6_460),
        ("sdd/raw/hyang/video7/annotations.txt", Format::SddRaw, 14_637),
        (
            "interaction/recorded_trackfiles/DR_USA_Roundabout_SR/vehicle_tracks_000.csv",
            Format::Interaction,
            43_189 + 1_052,
        ),
        ("vci_dut/intersection_01_traj_veh_filtered.csv", Format::VciDut, 290 + 1_750),
        ("vci_dut/intersection_01_traj_ped_filtered.csv", Format::VciDut, 290 + 1_750),
        ("kitti_tracking/detection/Cyclist/0000.txt", Format::KittiDetections, 1_054 + 259 + 525),
        ("kitti_tracking/label/0000.txt", Format::KittiLabels, 711),
    ];
    for (file, format, expected) in cases {
        let path = root.join(file);
        let recording = read(&path);
        assert_sound(&recording);
        assert_eq!(row_count(&recording), expected, "{file}");
        let named = open(&path, Some(format)).unwrap();
        assert!(named == recording, "{file} is not read as {format}");
    }
}

#[test]
fn interaction_as_published_has_pedestrians_in_every_frame() {
    let Some(site) = public_recording("interaction_as_published/DR_USA_Intersection_EP0") else { return };
    let alone = read(&site.join("pedestrian_tracks_000.csv"));
    let merged = read(&site.join("vehicle_tracks_000.csv"));
    let is_pedestrian = |detection: &&Detection| detection.id >= 1_000_000_000;
    for recording in [&alone, &merged] {
        assert_sound(recording);
        assert_eq!(recording.interval_ns, 100_000_000);
        let pedestrians = recording.frames.iter().flat_map(|frame| &frame.detections).filter(is_pedestrian);
        assert_eq!(pedestrians.clone().count(), 3_958);
        assert!(pedestrians.clone().all(|pedestrian| pedestrian.has(detection_flags::HAS_SPEED)));
        // No agent of this recording rides a cycle: the fastest running median is 2.1 m/s.
        assert!(pedestrians.clone().all(|row| row.agent_type == AgentType::Pedestrian as u32));
    }
    assert!(merged.frames.iter().all(|frame| frame.observed_types.count_ones() == 3));
    assert!(alone.frames.iter().all(|frame| frame.observed_types.count_ones() == 2));
    // The file's velocities agree with its positions.
    let [given, differences] = [data::tracks(&alone), data::tracks_from_positions(&alone)];
    for (given, differences) in given.iter().zip(&differences) {
        for ((_, given), (_, difference)) in given.states.iter().zip(&differences.states).skip(1) {
            let off_mps = [0, 1].map(|axis| given.velocity_mps[axis] - difference.velocity_mps[axis]);
            assert!(off_mps[0].hypot(off_mps[1]) < 0.5, "{given:?} {difference:?}");
        }
    }
}

#[test]
fn every_file_of_every_part_is_read() {
    let Some(root) = recordings() else { return };
    let parts = [
        (DataSet::EthUcy, [8, 8, 0]),
        (DataSet::SddTrajnet, [15, 15, 17]),
        (DataSet::SddRaw, [4, 7, 0]),
        (DataSet::Interaction, [43, 14, 14]),
        (DataSet::VciDut, [10, 2, 0]),
        (DataSet::KittiLabels, [8, 3, 0]),
        (DataSet::KittiDetections, [8, 3, 0]),
        (DataSet::Driving, [60, 11, 0]),
        (DataSet::Ngsim, [18, 3, 0]),
        (DataSet::Generated, [40, 4, 0]),
        (DataSet::Womd, [0, 161, 0]),
    ];
    for (set, expected) in parts {
        for (part, file_count) in [Part::Train, Part::Validation, Part::Test].into_iter().zip(expected) {
            let files = files(set, &root, part);
            assert_eq!(files.len(), file_count, "{} {}", set.name(), part.name());
            for file in files {
                assert_sound(&set.open(&file).unwrap_or_else(|error| panic!("{error}")));
            }
        }
    }
}

#[test]
fn parked_cars_of_kitti_stand_still_in_the_world() {
    let Some(root) = recordings() else { return };
    // Tracks of 5 to 20 s that the moving car passes. The remaining variance is noise of the labels.
    for (sequence, id) in [("0002", 18), ("0002", 19), ("0010", 7), ("0010", 18), ("0010", 19), ("0020", 42)]
    {
        let recording = read(&root.join(format!("kitti_tracking/label/{sequence}.txt")));
        let tracks = data::tracks(&recording);
        let states = &tracks.iter().find(|track| track.id == id).expect("is in the labels").states;
        for axis in [0, 1] {
            let coordinates = || states.iter().map(|(_, state)| state.position_m[axis]);
            let mean_m = coordinates().sum::<f32>() / states.len() as f32;
            let variance_m2 =
                coordinates().map(|x_m| (x_m - mean_m).powi(2)).sum::<f32>() / states.len() as f32;
            assert!(variance_m2.sqrt() < 0.1, "{sequence} {id}: {} m", variance_m2.sqrt());
        }
    }
}

#[test]
fn kitti_annotations_cover_their_own_labels() {
    let Some(root) = recordings() else { return };
    for file in files(DataSet::KittiDetections, &root, Part::Train) {
        let annotations = Annotations::open(&file).unwrap_or_else(|error| panic!("{error}"));
        let (mut covered, mut labelled) = (0, 0);
        for (index, (frame, seen)) in annotations.frames().iter().zip(read(&file).frames).enumerate() {
            let [ego_x, ego_y] = seen.ego.position_m.map(f64::from);
            // Farther objects are below the minimum height in the image.
            let near = |[x, y]: [f64; 2]| (x - ego_x).hypot(y - ego_y) < 40.0;
            for object in frame.objects.iter().filter(|object| object.counts && near(object.position_m)) {
                labelled += 1;
                covered += usize::from(annotations.covers(index, object.agent_type, object.position_m));
            }
        }
        assert!(10 * covered >= 9 * labelled && labelled > 100, "{file:?}: {covered} of {labelled}");
        assert!(!annotations.covers(0, wire::AgentType::Vehicle, [1e4, 1e4]), "{file:?}");
    }
}

#[test]
fn confident_detections_of_kitti_match_their_labels() {
    let Some(root) = recordings() else { return };
    for file in files(DataSet::KittiDetections, &root, Part::Train) {
        let recording = read(&file);
        let mut misses_m = Vec::new();
        for frame in &recording.frames {
            for detection in frame.detections.iter().filter(|detection| detection.score > 5.0) {
                let miss_m =
                    |truth: &wire::Truth| (truth.x_m - detection.x_m).hypot(truth.y_m - detection.y_m);
                misses_m.push(frame.truth.iter().map(miss_m).fold(f32::INFINITY, f32::min));
            }
        }
        misses_m.sort_by(f32::total_cmp);
        let median_m = misses_m[misses_m.len() / 2];
        assert!(median_m < 0.3, "{}: {median_m} m", recording.name);
    }
}

#[test]
fn stanford_drone_has_a_pixel_scale() {
    let Some(root) = recordings() else { return };
    for part in [Part::Train, Part::Test] {
        for file in files(DataSet::SddTrajnet, &root, part) {
            assert!(read(&file).pixel_m.is_some_and(|pixel_m| (0.02..0.06).contains(&pixel_m)));
        }
    }
    let lost = read(&root.join("sdd/raw/hyang/video7/annotations.txt")).left_out;
    assert_eq!((lost[0].reason.as_str(), lost[0].row_count), ("lost = 1", 18_534 - 14_637));
}

#[test]
fn cyclists_are_classified_among_pedestrians() {
    let Some(root) = recordings() else { return };
    let mut track_count = [0; 3];
    for part in [Part::Train, Part::Validation, Part::Test] {
        for file in files(DataSet::Interaction, &root, part) {
            for track in data::tracks(&read(&file)).iter().filter(|track| track.id >= 1_000_000_000) {
                track_count[track.reported_at(i64::MAX).agent_type.index()] += 1;
            }
        }
    }
    assert_eq!(track_count, [0, 10, 235]);
}
