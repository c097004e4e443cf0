use std::path::Path;

use association::Candidate;
use association::assignment::Assigner;
use data::formats::kitti::{AnnotatedFrame, Annotations};
use data::{Format, Recording};
use metrics::tracking::{Frame, Object};
use std::error::Error;
use wire::{AgentType, Detection};

use super::{Counts, GATE_M};
use crate::error::EvaluateError;

/// The classes, in the order of the tables.
pub(crate) const CLASSES: [AgentType; 3] = [AgentType::Vehicle, AgentType::Pedestrian, AgentType::Cyclist];
pub(crate) type ByClass<T> = [T; CLASSES.len()];
/// Candidate score thresholds, on the detectors' own scale. A detection with score 0 is as likely false as
/// true.
pub(crate) const LEAST_SCORES: [f32; 8] = [-1.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0];

/// The evaluated properties of a track in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PublishedTrack {
    /// The track's identity.
    pub id: u64,
    /// The estimated type.
    pub agent_type: AgentType,
    /// Position in the world frame.
    pub position_m: [f64; 2],
}

/// The tracks of each frame of a recording.
pub type Published = Vec<Vec<PublishedTrack>>;

/// Makes tracks from a recording. Fails with the reason if it can't.
pub type MakeTracks<'a> =
    Box<dyn Fn(&Recording) -> Result<Published, Box<dyn Error + Send + Sync>> + Sync + 'a>;

/// A tracker to evaluate.
pub struct Contender<'a> {
    /// The name in tables.
    pub name: &'static str,
    /// The tracker.
    pub track: MakeTracks<'a>,
}

/// A sequence with its labels.
pub(crate) struct Sequence {
    recording: Recording,
    annotations: Annotations,
}

/// KITTI's name of a class.
pub(crate) const fn class_name(agent_type: AgentType) -> &'static str {
    match agent_type {
        AgentType::Vehicle => "car",
        AgentType::Pedestrian => "pedestrian",
        AgentType::Cyclist => "cyclist",
    }
}

impl Sequence {
    /// Reads the detectors' output at `path` and its labels.
    pub(crate) fn open(path: &Path) -> Result<Self, EvaluateError> {
        let recording = data::open(path, Some(Format::KittiDetections))?;
        Ok(Self { recording, annotations: Annotations::open(path)? })
    }

    /// Evaluates a contender's tracks for each class. The contender gets the detections with at least these
    /// scores. Also returns what counts in each frame.
    pub(crate) fn evaluate(
        &self,
        contender: &Contender<'_>,
        least_scores: ByClass<f32>,
    ) -> Result<ByClass<(Counts, Vec<Frame>)>, EvaluateError> {
        let of = format!("{}: the tracker \"{}\"", self.recording.name, contender.name);
        let failed = |source| EvaluateError::Unusable { of: of.clone(), source };
        let published = (contender.track)(&self.with_scores(least_scores)).map_err(failed)?;
        let mut evaluated: ByClass<(Counts, Vec<Frame>)> = Default::default();
        for (of_class, agent_type) in evaluated.iter_mut().zip(CLASSES) {
            let frames = self.annotations.frames().iter().enumerate().map(|(index, annotated)| {
                let tracks = published.get(index).map_or(&[][..], Vec::as_slice);
                self.frame(index, annotated, tracks, agent_type)
            });
            let frames: Vec<Frame> = frames.collect::<Result<_, _>>().map_err(|e| failed(e.into()))?;
            *of_class = (Counts::of(&frames).map_err(|error| failed(error.into()))?, frames);
        }
        Ok(evaluated)
    }

    /// Name of the recording.
    pub(crate) fn name(&self) -> &str {
        &self.recording.name
    }

    /// The recording without detections of lower scores.
    fn with_scores(&self, least_scores: ByClass<f32>) -> Recording {
        let mut recording = self.recording.clone();
        for frame in &mut recording.frames {
            frame.detections.retain(|detection: &Detection| {
                let class = CLASSES.iter().position(|&class| class as u32 == detection.agent_type);
                class.is_some_and(|class| detection.score >= least_scores[class])
            });
        }
        recording
    }

    /// The truths and tracks of a class that count in a frame.
    ///
    /// Optional objects do not count, nor do tracks that are matched with one. An unmatched track is false
    /// only if its object would have been labelled.
    fn frame(
        &self,
        index: usize,
        annotated: &AnnotatedFrame,
        tracks: &[PublishedTrack],
        agent_type: AgentType,
    ) -> Result<Frame, metrics::tracking::TrackingError> {
        let objects: Vec<_> =
            annotated.objects.iter().filter(|object| object.agent_type == agent_type).collect();
        let tracks: Vec<_> = tracks.iter().filter(|track| track.agent_type == agent_type).collect();
        let positions_m: Vec<[f64; 2]> = objects.iter().map(|object| object.position_m).collect();
        let matched = matches(&tracks, &positions_m);
        let counts = tracks.iter().zip(&matched).filter(|(track, matched)| match matched {
            Some(object) => objects[*object as usize].counts,
            None => self.annotations.covers(index, agent_type, track.position_m),
        });
        let truths = objects.iter().filter(|object| object.counts);
        let truths: Vec<Object> =
            truths.map(|object| Object { id: object.id, position_m: object.position_m }).collect();
        let tracks: Vec<Object> =
            counts.map(|(track, _)| Object { id: track.id, position_m: track.position_m }).collect();
        Frame::new(&truths, &tracks)
    }
}

/// The object of each track. The assignment maximises the sum of the gate minus the distance over all pairs.
fn matches(tracks: &[&PublishedTrack], objects_m: &[[f64; 2]]) -> Vec<Option<u32>> {
    let distance_m = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    let mut candidates = Vec::new();
    for (track, t) in tracks.iter().zip(0..) {
        for (&object_m, o) in objects_m.iter().zip(0..) {
            let cost = distance_m(track.position_m, object_m);
            candidates.push(Candidate { track: t, detection: o, cost });
        }
    }
    let mut matched = vec![None; tracks.len()];
    Assigner::default().solve(&mut candidates, objects_m.len(), GATE_M, &mut matched);
    matched
}

#[cfg(test)]
mod tests {
    use super::super::KittiMeasure;
    use super::*;

    const CALIBRATION: &str = "P2: 721.5 0 609.5 44.8 0 721.5 172.8 0.2 0 0 1 0.003\nR_rect 1 0 0 0 1 0 0 0 1\n\
        Tr_velo_cam 0 -1 0 0 0 0 -1 -0.08 1 0 0 -0.27\nTr_imu_velo 1 0 0 -0.81 0 1 0 0.32 0 0 1 -0.8\n";
    const EGO_MOTION: &str = "49.0 8.4 112.8 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0.1 0.1 4 10 4 4 0\n";
    /// A car 20 m ahead, a van to its right, and a region without labels at the left of the image.
    const LABELS: &str = "0 0 Car 0 0 0 500 100 600 200 1.5 1.8 4.2 0 1.65 20 0\n\
        0 1 Van 0 0 0 700 100 800 200 2 1.8 4.2 5 1.65 25 0\n\
        0 -1 DontCare -1 -1 -10 0 100 200 300 -1000 -1000 -1000 -10 -1 -1 -1\n";
    const DETECTIONS: &str = "0,2,500,100,600,200,5.5,1.5,1.8,4.2,0,1.65,20,0,0\n\
        0,2,300,100,400,200,0.5,1.5,1.8,4.2,-3,1.65,20,0,0\n";

    fn sequence() -> Sequence {
        let root = tempfile::tempdir().unwrap();
        let files =
            [("calib", CALIBRATION), ("oxts", EGO_MOTION), ("label", LABELS), ("detection/Car", DETECTIONS)];
        for (folder, text) in files {
            std::fs::create_dir_all(root.path().join(folder)).unwrap();
            std::fs::write(root.path().join(folder).join("0000.txt"), text).unwrap();
        }
        Sequence::open(&root.path().join("detection/Car/0000.txt")).unwrap()
    }

    /// World position of an object at x and z in front of the camera.
    const fn ahead(x: f64, z: f64) -> [f64; 2] {
        [z + 1.08, -x - 0.32]
    }

    /// Figures of cars for a tracker with tracks at these places.
    fn figures(places_m: &[[f64; 2]]) -> [Option<f64>; 3] {
        let track = |(&position_m, id)| PublishedTrack { id, agent_type: AgentType::Vehicle, position_m };
        let contender = Contender {
            name: "given",
            track: Box::new(move |_| Ok(vec![places_m.iter().zip(1..).map(track).collect()])),
        };
        let [cars, ..] = sequence().evaluate(&contender, [-1.0; 3]).unwrap();
        [KittiMeasure::Missed, KittiMeasure::False, KittiMeasure::Hota].map(|measure| cars.0.figure(measure))
    }

    #[test]
    fn tracks_outside_the_labelled_regions_are_not_false() {
        const CAR: [f64; 2] = ahead(0.0, 20.0);
        assert_eq!(figures(&[CAR]), [Some(0.0), Some(0.0), Some(1.0)]);
        let [missed, wrong, _] = figures(&[]);
        assert_eq!((missed, wrong), (Some(1.0), Some(0.0)));
        // On the van, in the region without labels, behind the camera, and too far away to be seen well.
        let free = figures(&[CAR, ahead(5.0, 25.0), ahead(-12.0, 20.0), ahead(0.0, -20.0), ahead(0.0, 60.0)]);
        assert_eq!(free, [Some(0.0), Some(0.0), Some(1.0)]);
        let [missed, wrong, _] = figures(&[CAR, ahead(-3.0, 20.0), ahead(0.5, 20.5)]);
        assert_eq!((missed, wrong), (Some(0.0), Some(2.0)));
    }

    #[test]
    fn contenders_get_the_detections_above_their_threshold() {
        let contender = Contender {
            name: "plain",
            track: Box::new(|recording| {
                let seen =
                    recording.frames.iter().map(|frame| frame.detections.iter().map(|d| d.score).collect());
                let seen: Vec<Vec<f32>> = seen.collect();
                Err(format!("{seen:?}").into())
            }),
        };
        let error = |least| sequence().evaluate(&contender, [least, 9.0, 9.0]).unwrap_err().to_string();
        assert!(error(0.0).ends_with("the tracker \"plain\": [[5.5, 0.5]]"), "{}", error(0.0));
        assert!(error(0.6).ends_with("[[5.5]]"), "{}", error(0.6));
    }
}
