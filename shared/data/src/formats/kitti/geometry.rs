//! From the camera of KITTI's car to a fixed world frame.
//!
//! The calibration transforms a point of the rectified camera frame to the inertial unit, `imu = (R_rect ·
//! Tr_velo_cam · Tr_imu_velo)⁻¹ · camera`. The unit's pose transforms it to the world (m). The unit's
//! position is latitude and longitude on a Mercator map that is true to scale at the first row. KITTI's own
//! development kit uses the same map. The attitude is roll, pitch and yaw. Yaw is 0 to the east and
//! counter-clockwise.
//!
//! The inverse transformation needs a height: objects are assumed to stand on the plane on which the car
//! stands.

use std::path::Path;

use nalgebra::{Isometry3, Matrix2, Matrix3x4, Matrix4, Point3, Rotation3, Translation3, Vector2, Vector3};

use super::files;
use crate::text::{self, Line, Separator};
use crate::{Ego, Input, ReadError};

/// Radius of the sphere of the Mercator map, m.
const EARTH_RADIUS_M: f64 = 6_378_137.0;
/// Height of the inertial unit above the ground, m.
const IMU_HEIGHT_M: f64 = 0.93;
/// Objects nearer to the camera's plane have no image, m.
const DEPTH_MIN_M: f64 = 0.1;
const EGO_NAMES: [&str; 30] = [
    "lat",
    "lon",
    "alt",
    "roll",
    "pitch",
    "yaw",
    "vn",
    "ve",
    "vf",
    "vl",
    "vu",
    "ax",
    "ay",
    "az",
    "af",
    "al",
    "au",
    "wx",
    "wy",
    "wz",
    "wf",
    "wl",
    "wu",
    "pos_accuracy",
    "vel_accuracy",
    "navstat",
    "numsats",
    "posmode",
    "velmode",
    "orimode",
];

/// The pose of the camera in the world at each frame.
#[derive(Clone, Debug)]
pub struct WorldFromCamera {
    imu_from_camera: Matrix4<f64>,
    camera_from_imu: Matrix4<f64>,
    /// One per frame, at least one.
    world_from_imu: Vec<Isometry3<f64>>,
}

impl WorldFromCamera {
    /// Reads the calibration and the ego motion of a sequence.
    ///
    /// # Errors
    /// [`ReadError`] with file, line, column and value.
    pub fn parse(calibration: &Input, ego_motion: &Input) -> Result<Self, ReadError> {
        let (camera_from_imu, imu_from_camera) = camera_and_imu(calibration)?;
        Ok(Self { imu_from_camera, camera_from_imu, world_from_imu: world_from_imu(ego_motion)? })
    }

    /// Reads calibration and ego motion of the sequence to which `recording` (a detector's output or the
    /// label file) belongs.
    ///
    /// # Errors
    /// [`ReadError`] with file, line, column and value, and if calibration or ego motion are missing.
    pub fn open(recording: &Path) -> Result<Self, ReadError> {
        let [calibration, ego_motion] = files::sensors(recording)?;
        Self::parse(&calibration, &ego_motion)
    }

    /// Frames whose pose is known.
    pub fn frames_len(&self) -> usize {
        self.world_from_imu.len()
    }

    /// The car's pose at each frame, in the plane.
    pub fn egos(&self) -> impl Iterator<Item = Ego> {
        self.world_from_imu.iter().map(|pose| {
            let ahead = pose * Vector3::x();
            Ego {
                position_m: [pose.translation.x as f32, pose.translation.y as f32],
                heading_rad: ahead.y.atan2(ahead.x) as f32,
                is_sensor: true,
            }
        })
    }

    /// World position (x, y), m, and heading, rad, of an object. The object's base is at `centre_m` in the
    /// camera frame. The object is rotated by `rotation_rad` about the camera's y axis (down).
    ///
    /// # Panics
    /// If `frame` has no pose.
    #[must_use]
    pub fn object(&self, frame: usize, centre_m: [f64; 3], rotation_rad: f32) -> ([f64; 2], f64) {
        let pose = &self.world_from_imu[frame];
        let rotation_rad = f64::from(rotation_rad);
        let centre = pose * self.imu_from_camera.transform_point(&Point3::from(centre_m));
        let ahead = Vector3::new(rotation_rad.cos(), 0.0, -rotation_rad.sin());
        let ahead = pose * self.imu_from_camera.transform_vector(&ahead);
        ([centre.x, centre.y], ahead.y.atan2(ahead.x))
    }

    /// The inverse of [`WorldFromCamera::object`]: position in the camera frame, m, and rotation about its y
    /// axis, rad, of an object that stands at a world position. `None` if `frame` has no pose.
    #[must_use]
    pub fn standing(&self, frame: usize, position_m: [f64; 2], heading_rad: f64) -> Option<([f64; 3], f64)> {
        let pose = self.world_from_imu.get(frame)?;
        let rotation = pose.rotation.to_rotation_matrix();
        let flat: Matrix2<f64> = rotation.matrix().fixed_view::<2, 2>(0, 0).into();
        // The vector whose height is in the car's frame and whose other two coordinates are in the world's.
        let lifted = |xy: Vector2<f64>, height_m: f64| {
            let height: Vector2<f64> = rotation.matrix().fixed_view::<2, 1>(0, 2) * height_m;
            let xy = flat.try_inverse()? * (xy - height);
            Some(Vector3::new(xy.x, xy.y, height_m))
        };
        let place = Vector2::from(position_m) - pose.translation.vector.xy();
        let place = self.camera_from_imu.transform_point(&Point3::from(lifted(place, -IMU_HEIGHT_M)?));
        let ahead = lifted(Vector2::new(heading_rad.cos(), heading_rad.sin()), 0.0)?;
        let ahead = self.camera_from_imu.transform_vector(&ahead);
        Some(([place.x, place.y, place.z], (-ahead.z).atan2(ahead.x)))
    }
}

/// The projection of the rectified camera frame to the image of the left colour camera.
#[derive(Clone, Debug)]
pub(super) struct Camera {
    projection: Matrix3x4<f64>,
}

impl Camera {
    /// Reads the projection `P2` of a calibration.
    pub(super) fn parse(calibration: &Input) -> Result<Self, ReadError> {
        for line in text::lines(calibration) {
            let line = line?;
            if line.pieces(Separator::Space).next().is_some_and(|(_, key)| key.trim_end_matches(':') == "P2")
            {
                return Ok(Self { projection: Matrix3x4::from_row_slice(&numbers::<12>(&line)?) });
            }
        }
        Err(ReadError::missing(&calibration.path, "P2", ""))
    }

    /// Image coordinates of a point, px from the upper left corner, and the scale there, px/m; `None` if the
    /// point is behind the camera.
    pub(super) fn image_of(&self, [x, y, z]: [f64; 3]) -> Option<[f64; 3]> {
        let image = self.projection * nalgebra::Vector4::new(x, y, z, 1.0);
        (image.z > DEPTH_MIN_M)
            .then(|| [image.x / image.z, image.y / image.z, self.projection[(1, 1)] / image.z])
    }
}

/// Camera from inertial unit, and its inverse.
fn camera_and_imu(input: &Input) -> Result<(Matrix4<f64>, Matrix4<f64>), ReadError> {
    let (mut rectified, mut camera_from_velodyne, mut velodyne_from_imu) = (None, None, None);
    let mut last = None;
    for line in text::lines(input) {
        let line = line?;
        last = Some(line);
        let Some((column, key)) = line.pieces(Separator::Space).next() else { continue };
        match key.trim_end_matches(':') {
            "P0" | "P1" | "P2" | "P3" => drop(numbers::<12>(&line)?),
            "R_rect" | "R0_rect" => rectified = Some(rotation(numbers(&line)?)),
            "Tr_velo_cam" | "Tr_velo_to_cam" => camera_from_velodyne = Some(rigid(numbers(&line)?)),
            "Tr_imu_velo" | "Tr_imu_to_velo" => velodyne_from_imu = Some(rigid(numbers(&line)?)),
            _ => return Err(line.field("key", column, key).error("not a key of a KITTI calibration")),
        }
    }
    let missing = |role| ReadError::missing(&input.path, role, "");
    let rectified = rectified.ok_or_else(|| missing("R_rect"))?;
    let camera_from_velodyne = camera_from_velodyne.ok_or_else(|| missing("Tr_velo_cam"))?;
    let velodyne_from_imu = velodyne_from_imu.ok_or_else(|| missing("Tr_imu_velo"))?;
    let camera_from_imu: Matrix4<f64> = rectified * camera_from_velodyne * velodyne_from_imu;
    let inverse = camera_from_imu.try_inverse().filter(|m| m.iter().all(|x| x.is_finite()));
    match (inverse, last) {
        (Some(inverse), _) => Ok((camera_from_imu, inverse)),
        (None, Some(line)) => {
            Err(line.field("calibration", 1, line.text).error("the matrices have no inverse"))
        }
        (None, None) => Err(ReadError::Empty { path: input.path.clone() }),
    }
}

/// The numbers that follow the key of a line.
fn numbers<const N: usize>(line: &Line<'_>) -> Result<[f64; N], ReadError> {
    let mut values = [0.0; N];
    let mut found = 0;
    for (column, text) in line.pieces(Separator::Space).skip(1) {
        let value = line.field("matrix", column, text).number_in(-1e6..=1e6)?;
        if let Some(place) = values.get_mut(found) {
            *place = value;
        }
        found += 1;
    }
    if found == N { Ok(values) } else { Err(line.columns_error(found + 1, N + 1)) }
}

fn rotation(values: [f64; 9]) -> Matrix4<f64> {
    nalgebra::Matrix3::from_row_slice(&values).to_homogeneous()
}

fn rigid(values: [f64; 12]) -> Matrix4<f64> {
    let mut matrix = Matrix4::identity();
    matrix.fixed_view_mut::<3, 4>(0, 0).copy_from(&nalgebra::Matrix3x4::from_row_slice(&values));
    matrix
}

fn world_from_imu(input: &Input) -> Result<Vec<Isometry3<f64>>, ReadError> {
    let mut poses = Vec::new();
    let mut first: Option<(f64, Vector3<f64>)> = None;
    for line in text::lines(input) {
        let line = line?;
        let fields = line.split(Separator::Space, &EGO_NAMES)?;
        for unused in &fields[6..] {
            unused.number()?;
        }
        let [latitude, longitude] =
            [fields[0].number_in(-85.0..=85.0)?, fields[1].number_in(-180.0..=180.0)?];
        let altitude_m = fields[2].number_in(-1e4..=1e5)?;
        let [roll, pitch, yaw] = [fields[3].angle_rad()?, fields[4].angle_rad()?, fields[5].angle_rad()?];
        let (scale, origin) = *first.get_or_insert_with(|| {
            let scale = latitude.to_radians().cos();
            (scale, mercator(scale, latitude, longitude, altitude_m))
        });
        let position = mercator(scale, latitude, longitude, altitude_m) - origin;
        if position.xy().amax() > f64::from(wire::POSITION_MAX_M) {
            return Err(fields[0].error("too far from the first row"));
        }
        let attitude = Rotation3::from_euler_angles(f64::from(roll), f64::from(pitch), f64::from(yaw));
        poses.push(Isometry3::from_parts(Translation3::from(position), attitude.into()));
        crate::rows::limit(poses.len(), &line)?;
    }
    if poses.is_empty() { Err(ReadError::Empty { path: input.path.clone() }) } else { Ok(poses) }
}

/// East, north, up on a Mercator map with the given scale.
fn mercator(scale: f64, latitude: f64, longitude: f64, altitude_m: f64) -> Vector3<f64> {
    let east_m = scale * EARTH_RADIUS_M * longitude.to_radians();
    let north_m = scale * EARTH_RADIUS_M * (45.0 + latitude / 2.0).to_radians().tan().ln();
    Vector3::new(east_m, north_m, altitude_m)
}
