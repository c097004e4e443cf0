use std::path::Path;

use wire::AgentType;

use super::files;
use super::geometry::{Camera, WorldFromCamera};
use super::{LABEL_NAMES, frame_index, label};
use crate::ReadError;
use crate::input::Input;
use crate::text::{self, Field, Separator};

/// Labels count up to this state of occlusion: *largely*; beyond it is *unknown*.
const OCCLUDED_MAX: i64 = 2;
/// Size of the image, px; a few pixels more than those of some sequences.
const IMAGE_PX: [f64; 2] = [1242.0, 375.0];
/// Least height in the image, px, of an object that counts.
const HEIGHT_MIN_PX: f64 = 25.0;

/// The labels of a sequence as the evaluation of a tracker needs them: per frame the objects that a tracker
/// must find, those that it may find, and the regions of the image without labels. The rules are those of the
/// benchmark's own program, with positions on the ground instead of boxes.
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
    /// Boxes of the image within which objects have no label of their own, as (left, top, right, bottom).
    pub unlabelled_px: Vec<[f64; 4]>,
}

/// A labelled object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnnotatedObject {
    /// The same in all frames.
    pub id: u64,
    /// The agent type as which a tracker reports it.
    pub agent_type: AgentType,
    /// Position (x, y) in the world, m.
    pub position_m: [f64; 2],
    /// Whether a miss counts: a car, pedestrian or cyclist, wholly in the image and not occluded to an
    /// unknown degree. Other objects (vans, sitting people, …) may be found or missed.
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
    #[must_use]
    pub fn frames(&self) -> &[AnnotatedFrame] {
        &self.frames
    }

    /// Whether an object at a world position would have been labelled: it is in the image, high enough, and
    /// outside the unlabelled regions.
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
