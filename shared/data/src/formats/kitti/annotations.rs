use std::path::Path;

use wire::AgentType;

use super::files;
use super::geometry::{Camera, WorldFromCamera};
use super::{LABEL_NAMES, frame_index, label};
use crate::ReadError;
use crate::input::Input;
use crate::text::{self, Field, Separator};

/// Highest state of occlusion of labels that count: *largely*. The next one is *unknown*.
const OCCLUDED_MAX: i64 = 2;
/// Size of the image, px. Some sequences have a few pixels fewer.
const IMAGE_PX: [f64; 2] = [1242.0, 375.0];
/// Minimum height in the image of an object that counts, px.
const HEIGHT_MIN_PX: f64 = 25.0;

/// The labels of a sequence for the evaluation of a tracker. They list, per frame, the objects that a tracker
/// must find, the objects that it may find, and the regions of the image without labels. The rules are those
/// of the benchmark's own program, except that positions on the ground replace boxes.
#[derive(Clone, Debug)]
pub struct Annotations {
    poses: WorldFromCamera,
    camera: Camera,
    frames: Vec<AnnotatedFrame>,
}

/// The labels of a frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AnnotatedFrame {
    /// The objects, in the order of the file.
    pub objects: Vec<AnnotatedObject>,
    /// Boxes of the image, as (left, top, right, bottom), whose objects have no labels.
    pub unlabelled_px: Vec<[f64; 4]>,
}

/// A labelled object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnnotatedObject {
    /// The identity, which is the same in all frames.
    pub id: u64,
    /// The agent type that a tracker reports for it.
    pub agent_type: AgentType,
    /// Position (x, y) in the world, m.
    pub position_m: [f64; 2],
    /// Whether a miss counts. It counts for a car, pedestrian or cyclist that is wholly in the image and
    /// whose occlusion is known. Other objects (vans, sitting people, …) may be found or missed.
    pub counts: bool,
}

impl Annotations {
    /// Reads the labels of the sequence to which `recording` (a detector's output or the label file) belongs.
    ///
    /// # Errors
    /// [`ReadError`] with file, line, column and value, and if labels, calibration or ego motion are
    /// missing.
    pub fn open(recording: &Path) -> Result<Self, ReadError> {
        let [calibration, ego_motion] = files::sensors(recording)?;
        let labels = files::labels(recording)?;
        Self::parse(&labels, &calibration, &ego_motion)
    }

    fn parse(labels: &Input, calibration: &Input, ego_motion: &Input) -> Result<Self, ReadError> {
        let poses = WorldFromCamera::parse(calibration, ego_motion)?;
        let camera = Camera::parse(calibration)?;
        let mut frames = vec![AnnotatedFrame::default(); poses.frames_len()];
        for line in text::lines(labels) {
            let fields = line?.split(Separator::Space, &LABEL_NAMES)?;
            match fields[2].text {
                "DontCare" => {
                    let frame = &mut frames[frame_index(fields[0], &poses)?];
                    frame.unlabelled_px.push(box_px(&fields)?);
                }
                "Misc" => {}
                kind => {
                    let [truncated, occluded] = [fields[3].integer()?, fields[4].integer()?];
                    let whole = truncated <= 0 && occluded <= OCCLUDED_MAX;
                    let (frame, seen) = label(fields, &poses)?;
                    let object = AnnotatedObject {
                        id: seen.id,
                        agent_type: seen.agent_type().map_err(|_| fields[2].error("no agent"))?,
                        position_m: [seen.x_m, seen.y_m].map(f64::from),
                        counts: whole && ["Car", "Pedestrian", "Cyclist"].contains(&kind),
                    };
                    frames[frame].objects.push(object);
                }
            }
        }
        Ok(Self { poses, camera, frames })
    }

    /// The frames, one for each row of the ego motion.
    pub fn frames(&self) -> &[AnnotatedFrame] {
        &self.frames
    }

    /// Whether an object at a world position would have a label: it is in the image, high enough, and outside
    /// the unlabelled regions.
    #[must_use]
    pub fn covers(&self, frame: usize, agent_type: AgentType, position_m: [f64; 2]) -> bool {
        let (Some(annotated), Some(([x, y, z], _))) =
            (self.frames.get(frame), self.poses.standing(frame, position_m, 0.0))
        else {
            return false;
        };
        let height_m = super::height_m(agent_type);
        let Some([u, v, scale]) = self.camera.image_of([x, y - height_m / 2.0, z]) else { return false };
        let in_box =
            |[left, top, right, bottom]: [f64; 4]| (left..=right).contains(&u) && (top..=bottom).contains(&v);
        in_box([0.0, 0.0, IMAGE_PX[0], IMAGE_PX[1]])
            && height_m * scale > HEIGHT_MIN_PX
            && !annotated.unlabelled_px.iter().any(|&unlabelled| in_box(unlabelled))
    }
}

fn box_px(fields: &[Field<'_>; 17]) -> Result<[f64; 4], ReadError> {
    Ok([fields[6].number()?, fields[7].number()?, fields[8].number()?, fields[9].number()?])
}
