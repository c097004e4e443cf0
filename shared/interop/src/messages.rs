//! The ROS messages, with the names and the order of fields of their packages.
#![expect(missing_docs, reason = "the fields are documented by their packages")]

use crate::cdr::{Byte, Cdr, CdrError, Input, Output};
use crate::definition::{Definition, Type};

macro_rules! messages {
    ($($(#[$doc:meta])+ $name:ident = $ros:literal $([$($constant:literal),+])? { $($field:ident: $type:ty,)+ })+) => {
        $($(#[$doc])+
        #[derive(Clone, Debug, Default, PartialEq)]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        pub struct $name {
            $(pub $field: $type,)+
        }

        impl $name {
            /// The definition of the message type.
            pub const DEFINITION: Definition = Definition {
                name: $ros,
                constants: &[$($($constant),+)?],
                fields: &[$((stringify!($field), <$type as Cdr>::TYPE)),+],
            };
        }

        impl Cdr for $name {
            const TYPE: Type = Type::Message(&Self::DEFINITION);

            fn write(&self, output: &mut Output) {
                $(self.$field.write(output);)+
            }

            fn read(input: &mut Input<'_>) -> Result<Self, CdrError> {
                Ok(Self { $($field: <$type>::read(input)?,)+ })
            }
        })+
    };
}

/// Labels of [`ObjectClassification`].
pub mod label {
    pub const UNKNOWN: u8 = 0;
    pub const CAR: u8 = 1;
    pub const TRUCK: u8 = 2;
    pub const BUS: u8 = 3;
    pub const TRAILER: u8 = 4;
    pub const MOTORCYCLE: u8 = 5;
    pub const BICYCLE: u8 = 6;
    pub const PEDESTRIAN: u8 = 7;
}

/// Types and actions of [`Marker`].
pub mod marker {
    pub const CUBE: i32 = 1;
    pub const CYLINDER: i32 = 3;
    pub const LINE_LIST: i32 = 5;
    pub const TEXT_VIEW_FACING: i32 = 9;
    pub const ADD: i32 = 0;
    pub const DELETEALL: i32 = 3;
}

/// A 6 × 6 covariance, row-major.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(from = "[[f64; 6]; 6]", into = "[[f64; 6]; 6]"))]
pub struct Covariance(pub [f64; 36]);

/// serde has no arrays of more than 32 elements. The rows have the same bytes.
impl From<[[f64; 6]; 6]> for Covariance {
    fn from(rows: [[f64; 6]; 6]) -> Self {
        Self(std::array::from_fn(|place| rows[place / 6][place % 6]))
    }
}

impl From<Covariance> for [[f64; 6]; 6] {
    fn from(covariance: Covariance) -> Self {
        std::array::from_fn(|row| std::array::from_fn(|column| covariance.0[row * 6 + column]))
    }
}

impl Default for Covariance {
    fn default() -> Self {
        Self([0.0; 36])
    }
}

impl Cdr for Covariance {
    const TYPE: Type = <[f64; 36]>::TYPE;

    fn write(&self, output: &mut Output) {
        self.0.write(output);
    }

    fn read(input: &mut Input<'_>) -> Result<Self, CdrError> {
        Ok(Self(<[f64; 36]>::read(input)?))
    }
}

messages! {
    /// A point in time.
    Time = "builtin_interfaces/msg/Time" { sec: i32, nanosec: u32, }
    /// A span of time.
    Duration = "builtin_interfaces/msg/Duration" { sec: i32, nanosec: u32, }
    /// Time and frame of data.
    Header = "std_msgs/msg/Header" { stamp: Time, frame_id: String, }
    /// An identity.
    Uuid = "unique_identifier_msgs/msg/UUID" { uuid: [u8; 16], }
    /// A point.
    Point = "geometry_msgs/msg/Point" { x: f64, y: f64, z: f64, }
    /// A point in single precision.
    Point32 = "geometry_msgs/msg/Point32" { x: f32, y: f32, z: f32, }
    /// A vector.
    Vector3 = "geometry_msgs/msg/Vector3" { x: f64, y: f64, z: f64, }
    /// A rotation.
    Quaternion = "geometry_msgs/msg/Quaternion" { x: f64, y: f64, z: f64, w: f64, }
    /// Position and orientation.
    Pose = "geometry_msgs/msg/Pose" { position: Point, orientation: Quaternion, }
    /// Velocity and turn rates.
    Twist = "geometry_msgs/msg/Twist" { linear: Vector3, angular: Vector3, }
    /// Accelerations.
    Accel = "geometry_msgs/msg/Accel" { linear: Vector3, angular: Vector3, }
    /// A pose with its covariance.
    PoseWithCovariance = "geometry_msgs/msg/PoseWithCovariance" { pose: Pose, covariance: Covariance, }
    /// A twist with its covariance.
    TwistWithCovariance = "geometry_msgs/msg/TwistWithCovariance" { twist: Twist, covariance: Covariance, }
    /// Accelerations with their covariance.
    AccelWithCovariance = "geometry_msgs/msg/AccelWithCovariance" { accel: Accel, covariance: Covariance, }
    /// A polygon.
    Polygon = "geometry_msgs/msg/Polygon" { points: Vec<Point32>, }
    /// A frame's place in another one.
    Transform = "geometry_msgs/msg/Transform" { translation: Vector3, rotation: Quaternion, }
    /// A transform with its time and frames.
    TransformStamped = "geometry_msgs/msg/TransformStamped" {
        header: Header, child_frame_id: String, transform: Transform,
    }
    /// The time of a simulation or of a bag that is played.
    Clock = "rosgraph_msgs/msg/Clock" { clock: Time, }
    /// Transforms.
    TfMessage = "tf2_msgs/msg/TFMessage" { transforms: Vec<TransformStamped>, }
    /// A class with its probability.
    ObjectClassification = "autoware_perception_msgs/msg/ObjectClassification"
    ["uint8 UNKNOWN=0", "uint8 CAR=1", "uint8 TRUCK=2", "uint8 BUS=3", "uint8 TRAILER=4", "uint8 MOTORCYCLE=5",
     "uint8 BICYCLE=6", "uint8 PEDESTRIAN=7"] { label: u8, probability: f32, }
    /// An outline.
    Shape = "autoware_perception_msgs/msg/Shape"
    ["uint8 BOUNDING_BOX=0", "uint8 CYLINDER=1", "uint8 POLYGON=2"] {
        r#type: u8, footprint: Polygon, dimensions: Vector3,
    }
    /// A path that an object may take: poses `time_step` apart, the first at the header's stamp.
    PredictedPath = "autoware_perception_msgs/msg/PredictedPath" {
        path: Vec<Pose>, time_step: Duration, confidence: f32,
    }
    /// Motion of a predicted object.
    PredictedObjectKinematics = "autoware_perception_msgs/msg/PredictedObjectKinematics" {
        initial_pose_with_covariance: PoseWithCovariance,
        initial_twist_with_covariance: TwistWithCovariance,
        initial_acceleration_with_covariance: AccelWithCovariance,
        predicted_paths: Vec<PredictedPath>,
    }
    /// A predicted object.
    PredictedObject = "autoware_perception_msgs/msg/PredictedObject" {
        object_id: Uuid,
        existence_probability: f32,
        classification: Vec<ObjectClassification>,
        kinematics: PredictedObjectKinematics,
        shape: Shape,
    }
    /// Predicted objects.
    PredictedObjects = "autoware_perception_msgs/msg/PredictedObjects" {
        header: Header, objects: Vec<PredictedObject>,
    }
    /// Motion of a tracked object.
    TrackedObjectKinematics = "autoware_perception_msgs/msg/TrackedObjectKinematics"
    ["uint8 UNAVAILABLE=0", "uint8 SIGN_UNKNOWN=1", "uint8 AVAILABLE=2"] {
        pose_with_covariance: PoseWithCovariance,
        twist_with_covariance: TwistWithCovariance,
        acceleration_with_covariance: AccelWithCovariance,
        orientation_availability: u8,
        is_stationary: bool,
    }
    /// A tracked object.
    TrackedObject = "autoware_perception_msgs/msg/TrackedObject" {
        object_id: Uuid,
        existence_probability: f32,
        classification: Vec<ObjectClassification>,
        kinematics: TrackedObjectKinematics,
        shape: Shape,
    }
    /// Tracked objects.
    TrackedObjects = "autoware_perception_msgs/msg/TrackedObjects" {
        header: Header, objects: Vec<TrackedObject>,
    }
    /// Motion of a detected object.
    DetectedObjectKinematics = "autoware_perception_msgs/msg/DetectedObjectKinematics"
    ["uint8 UNAVAILABLE=0", "uint8 SIGN_UNKNOWN=1", "uint8 AVAILABLE=2"] {
        pose_with_covariance: PoseWithCovariance,
        has_position_covariance: bool,
        orientation_availability: u8,
        twist_with_covariance: TwistWithCovariance,
        has_twist: bool,
        has_twist_covariance: bool,
    }
    /// A detected object.
    DetectedObject = "autoware_perception_msgs/msg/DetectedObject" {
        existence_probability: f32,
        classification: Vec<ObjectClassification>,
        kinematics: DetectedObjectKinematics,
        shape: Shape,
    }
    /// Detected objects.
    DetectedObjects = "autoware_perception_msgs/msg/DetectedObjects" {
        header: Header, objects: Vec<DetectedObject>,
    }
    /// A named value.
    KeyValue = "diagnostic_msgs/msg/KeyValue" { key: String, value: String, }
    /// The state of a part.
    DiagnosticStatus = "diagnostic_msgs/msg/DiagnosticStatus" ["byte OK=0", "byte WARN=1", "byte ERROR=2", "byte STALE=3"] {
        level: Byte, name: String, message: String, hardware_id: String, values: Vec<KeyValue>,
    }
    /// States of parts.
    DiagnosticArray = "diagnostic_msgs/msg/DiagnosticArray" { header: Header, status: Vec<DiagnosticStatus>, }
    /// A color with its opacity.
    ColorRgba = "std_msgs/msg/ColorRGBA" { r: f32, g: f32, b: f32, a: f32, }
    /// An image in a file format.
    CompressedImage = "sensor_msgs/msg/CompressedImage" { header: Header, format: String, data: Vec<u8>, }
    /// A place in a texture.
    UvCoordinate = "visualization_msgs/msg/UVCoordinate" { u: f32, v: f32, }
    /// A mesh.
    MeshFile = "visualization_msgs/msg/MeshFile" { filename: String, data: Vec<u8>, }
    /// A shape, line or text for rviz.
    Marker = "visualization_msgs/msg/Marker"
    ["int32 CUBE=1", "int32 CYLINDER=3", "int32 LINE_LIST=5", "int32 TEXT_VIEW_FACING=9", "int32 ADD=0", "int32 DELETEALL=3"] {
        header: Header,
        ns: String,
        id: i32,
        r#type: i32,
        action: i32,
        pose: Pose,
        scale: Vector3,
        color: ColorRgba,
        lifetime: Duration,
        frame_locked: bool,
        points: Vec<Point>,
        colors: Vec<ColorRgba>,
        texture_resource: String,
        texture: CompressedImage,
        uv_coordinates: Vec<UvCoordinate>,
        text: String,
        mesh_resource: String,
        mesh_file: MeshFile,
        mesh_use_embedded_materials: bool,
    }
    /// Markers.
    MarkerArray = "visualization_msgs/msg/MarkerArray" { markers: Vec<Marker>, }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cdr::{from_bytes, to_bytes};

    #[test]
    fn type_hashes_equal_the_published_ones() {
        let hashes = [
            (
                &PredictedObjects::DEFINITION,
                "b63151309c3323bb6e3f09c54b3358aa53a8e66937a1cde15c5d5ede1ef80a08",
            ),
            (&TrackedObjects::DEFINITION, "3559bd4e62ce8a4d96e32720c02bbe656cc090bb2b3f3f91f52a7c3ab095417a"),
            (
                &DetectedObjects::DEFINITION,
                "2facd6b15786cbd1f720cdd23d22e6d60d2e7e83b8dff8fd401330e24edb187b",
            ),
            // By PyPI's `rosbags` 0.11, from the definition of Jazzy.
            (&MarkerArray::DEFINITION, "86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf"),
        ];
        for (definition, hash) in hashes {
            assert_eq!(definition.hash(), format!("RIHS01_{hash}"), "{}", definition.name);
        }
    }

    #[test]
    fn messages_are_read_as_they_were_written_and_cut_ones_are_refused() {
        let status = DiagnosticStatus { level: Byte(1), name: "a".to_owned(), ..DiagnosticStatus::default() };
        let message = DiagnosticArray { status: vec![status.clone(), status], ..DiagnosticArray::default() };
        let bytes = to_bytes(&message);
        assert_eq!(from_bytes::<DiagnosticArray>(&bytes), Ok(message));
        for len in 0..bytes.len() {
            assert!(from_bytes::<DiagnosticArray>(&bytes[..len]).is_err(), "{len}");
        }
        let schema = PredictedObjects::DEFINITION.schema();
        assert!(
            schema
                .starts_with("std_msgs/Header header\nautoware_perception_msgs/PredictedObject[] objects\n")
        );
        assert!(schema.contains("\nMSG: autoware_perception_msgs/Shape\nuint8 BOUNDING_BOX=0\n"), "{schema}");
        assert!(schema.contains("\nuint8 type\n") && schema.contains("float64[36] covariance\n"), "{schema}");
    }
}
