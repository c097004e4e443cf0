//! The messages that a recording holds for other tools.

use std::collections::{BTreeMap, VecDeque};
use std::str::FromStr;

use recording::{About, Event, Frame, Happened, LogLine, Message, View, ViewChannel};
use scene::ContextMap;
use wire::tick_view::TickView;
use wire::{ForecastsTopic, Header, StageId, Topic as _, Track, TracksTopic, WorldOrigin, flags};

use crate::autoware::Tick;
use crate::cdr::to_bytes;
use crate::foxglove::{Level, schemas};
use crate::messages::{DiagnosticArray, PredictedObjects, TfMessage, TrackedObjects};
use crate::{Definition, autoware, foxglove};

/// Tracks that wait for the forecasts of their tick.
const WAITING_MAX: usize = 16;
/// The topic of the context map.
pub const GRID_TOPIC: &str = "/stgdat/map";
/// Infinite duration of a QoS.
const INFINITE: &str = "{sec: 9223372036, nsec: 854775807}";

wire::named! {
    /// A tool that reads a recording.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum Target {
        /// Foxglove: scene, transforms and log in protobuf.
        Foxglove => "foxglove",
        /// Autoware and other ROS 2 tools: objects, transforms and diagnostics in CDR.
        Autoware => "autoware",
    }
}

impl FromStr for Target {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        match name {
            "foxglove" => Ok(Self::Foxglove),
            "autoware" => Ok(Self::Autoware),
            _ => Err(format!("there is no tool \"{name}\": expected foxglove or autoware")),
        }
    }
}

/// A message that a view adds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Scene,
    FrameTransforms,
    Grid,
    Log,
    Tracked,
    Predicted,
    Tf,
    Diagnostics,
}

/// The messages that other tools need.
#[derive(Clone, Debug, Default)]
pub struct ViewOptions<'a> {
    /// The tools.
    pub targets: &'a [Target],
    /// Largest number of paths of an object.
    pub paths_max: usize,
    /// Largest age of a forecast among Autoware's predicted objects; no limit if `None`.
    pub max_age_ns: Option<u64>,
    /// The context map, if the run has a fixed one. Foxglove receives it once, with the first tick.
    pub map: Option<ContextMap>,
}

/// Adds a run's messages for other tools to its recording. A tick needs the frames of tracks and forecasts.
#[derive(Debug)]
pub struct Views {
    kinds: Vec<Kind>,
    paths_max: usize,
    max_age_ns: Option<u64>,
    /// The context map until it is sent.
    map: Option<ContextMap>,
    budgets_ms: BTreeMap<StageId, f64>,
    origin: WorldOrigin,
    /// Unix time minus `CLOCK_MONOTONIC`.
    clock_offset_ns: i64,
    /// The newest tracks, oldest first.
    waiting: VecDeque<(Header, Vec<Track>)>,
}

/// The view of a run for these tools; `None` without any.
#[must_use]
pub fn views(options: ViewOptions<'_>, about: &About) -> Option<Box<dyn View>> {
    let ViewOptions { targets, paths_max, max_age_ns, map } = options;
    let mut kinds = Vec::new();
    if targets.contains(&Target::Foxglove) {
        kinds.extend([Kind::Scene, Kind::FrameTransforms, Kind::Log]);
        kinds.extend(map.is_some().then_some(Kind::Grid));
    }
    if targets.contains(&Target::Autoware) {
        kinds.extend([Kind::Tracked, Kind::Predicted, Kind::Tf, Kind::Diagnostics]);
    }
    let waiting = VecDeque::with_capacity(WAITING_MAX);
    let (budgets_ms, origin) = (about.run.budgets_ms(), about.run.origin());
    let clock_offset_ns = about.clock_offset_ns;
    let views = Views { kinds, paths_max, max_age_ns, map, budgets_ms, origin, clock_offset_ns, waiting };
    (!targets.is_empty()).then(|| Box::new(views) as Box<dyn View>)
}

impl View for Views {
    /// ROS's tools refuse bags of other profiles.
    fn profile(&self) -> &'static str {
        if self.kinds.contains(&Kind::Predicted) { "ros2" } else { "stgdat" }
    }

    fn channels(&self) -> Vec<ViewChannel> {
        self.kinds.iter().map(|kind| kind.channel()).collect()
    }

    fn add(&mut self, message: &Message, output: &mut dyn FnMut(u16, &[u8])) {
        match message {
            Message::Frame(frame) if frame.topic().name == TracksTopic::NAME => self.tracks(frame, output),
            Message::Frame(frame) if frame.topic().name == ForecastsTopic::NAME => {
                self.forecasts(frame, output);
            }
            Message::Event(event) => self.event(event, output),
            Message::Line(line) => self.line(line, output),
            Message::Frame(_) | Message::Before(_) => {}
        }
    }
}

impl Views {
    fn send(&self, kind: Kind, output: &mut dyn FnMut(u16, &[u8]), bytes: impl FnOnce() -> Option<Vec<u8>>) {
        if let Some(place) = self.kinds.iter().position(|have| *have == kind)
            && let Some(bytes) = bytes()
        {
            output(place as u16, &bytes);
        }
    }

    /// Keeps the tracks until their forecasts arrive.
    fn tracks(&mut self, frame: &Frame, output: &mut dyn FnMut(u16, &[u8])) {
        // Frames that their readers refuse have no view.
        let Ok(tracks) = frame.elements::<TracksTopic>() else { return };
        // A reader would take a refused tick for an empty road.
        if !frame.header().is_tick() || frame.header().has(flags::VOID) {
            return;
        }
        let none = Header { counts: frame.header().counts, ..Header::default() };
        let view = TickView::new((frame.header(), &tracks), (&none, &[]));
        let view = Tick { view, tracks: &tracks, origin: self.origin };
        if let Some(map) = self.map.take() {
            self.send(Kind::Grid, output, || Some(foxglove::grid(&map, self.origin, view.stamp_ns)));
        }
        self.send(Kind::Tracked, output, || Some(to_bytes(&autoware::tracked_objects(&view))));
        self.send(Kind::Tf, output, || autoware::transforms(&view).map(|tf| to_bytes(&tf)));
        self.send(Kind::FrameTransforms, output, || foxglove::frame_transforms(&view));
        if self.waiting.len() == WAITING_MAX {
            self.waiting.pop_front();
        }
        self.waiting.push_back((*frame.header(), tracks));
    }

    fn forecasts(&mut self, frame: &Frame, output: &mut dyn FnMut(u16, &[u8])) {
        let header = frame.header();
        let Ok(forecasts) = frame.elements::<ForecastsTopic>() else { return };
        let of_tick =
            |(tracks, _): &(Header, _)| tracks.seq == header.seq && tracks.stamp_ns == header.stamp_ns;
        let Some(place) = self.waiting.iter().position(of_tick) else { return };
        let (of, tracks) = &self.waiting[place];
        let view = TickView::new((of, tracks), (header, &forecasts[..]));
        let view = Tick { view, tracks, origin: self.origin };
        let limited = self.max_age_ns.map(|max_age_ns| {
            let mut limited = view.view.clone();
            // Only a released tick has an age of its own.
            let passed_ns =
                if header.released_ns == 0 { 0 } else { frame.sent_ns().saturating_sub(header.released_ns) };
            autoware::leave_out_old(&mut limited, max_age_ns, passed_ns);
            Tick { view: limited, tracks, origin: self.origin }
        });
        self.send(Kind::Predicted, output, || {
            Some(to_bytes(&autoware::predicted_objects(limited.as_ref().unwrap_or(&view), self.paths_max)))
        });
        self.send(Kind::Diagnostics, output, || {
            Some(to_bytes(&autoware::diagnostics(&view, header.hops(), &self.budgets_ms)))
        });
        self.send(Kind::Scene, output, || Some(foxglove::scene_update(&view, self.paths_max)));
        self.waiting.drain(..=place);
    }

    fn event(&self, event: &Event, output: &mut dyn FnMut(u16, &[u8])) {
        let level = match event.what {
            Happened::Linked
            | Happened::Replaced { .. }
            | Happened::Kept { .. }
            | Happened::Mark { .. }
            | Happened::Ended { .. } => Level::Info,
            Happened::Starved { .. } | Happened::Refused { .. } | Happened::Lost { .. } => Level::Warning,
            Happened::Died { .. } | Happened::GivenUp { .. } => Level::Error,
        };
        let unix_ns = self.unix_ns(event.at_ns);
        self.send(Kind::Log, output, || {
            Some(foxglove::log(unix_ns, level, "supervisor", &event.what.to_string()))
        });
    }

    fn line(&self, line: &LogLine, output: &mut dyn FnMut(u16, &[u8])) {
        let levels = [(" ERROR ", Level::Error), (" WARN ", Level::Warning), (" DEBUG ", Level::Debug)];
        let found = levels.into_iter().find(|(word, _)| line.line.contains(word));
        let level = found.map_or(Level::Info, |(_, level)| level);
        let unix_ns = self.unix_ns(line.at_ns);
        self.send(Kind::Log, output, || Some(foxglove::log(unix_ns, level, &line.stage, &line.line)));
    }

    fn unix_ns(&self, monotonic_ns: u64) -> i64 {
        i64::try_from(monotonic_ns).unwrap_or(i64::MAX).saturating_add(self.clock_offset_ns)
    }
}

impl Kind {
    fn channel(self) -> ViewChannel {
        match self {
            Self::Scene => protobuf("/stgdat/scene", "foxglove.SceneUpdate", schemas::SCENE_UPDATE),
            Self::FrameTransforms => {
                protobuf("/stgdat/tf", "foxglove.FrameTransforms", schemas::FRAME_TRANSFORMS)
            }
            Self::Grid => protobuf(GRID_TOPIC, "foxglove.Grid", schemas::GRID),
            Self::Log => protobuf("/stgdat/log", "foxglove.Log", schemas::LOG),
            Self::Tracked => {
                ros("/perception/object_recognition/tracking/objects", &TrackedObjects::DEFINITION, 1)
            }
            Self::Predicted => {
                ros("/perception/object_recognition/objects", &PredictedObjects::DEFINITION, 1)
            }
            Self::Tf => ros("/tf", &TfMessage::DEFINITION, 100),
            Self::Diagnostics => ros("/diagnostics", &DiagnosticArray::DEFINITION, 10),
        }
    }
}

fn protobuf(topic: &'static str, schema: &'static str, descriptor: &[u8]) -> ViewChannel {
    let [encoding, schema_encoding] = ["protobuf"; 2];
    ViewChannel {
        topic,
        encoding,
        schema,
        schema_encoding,
        schema_data: descriptor.to_vec(),
        metadata: Vec::new(),
    }
}

/// A channel with the QoS of Autoware: reliable, volatile, and a queue of `depth`.
fn ros(topic: &'static str, definition: &Definition, depth: u32) -> ViewChannel {
    // Enumerations are numbers, which all versions of rosbag2 read. Readers require all nine keys.
    let qos = format!(
        "- history: 1\n  depth: {depth}\n  reliability: 1\n  durability: 2\n  deadline: {INFINITE}\n  \
         lifespan: {INFINITE}\n  liveliness: 1\n  liveliness_lease_duration: {INFINITE}\n  \
         avoid_ros_namespace_conventions: false\n"
    );
    ViewChannel {
        topic,
        encoding: "cdr",
        schema: definition.name,
        schema_encoding: "ros2msg",
        schema_data: definition.schema().into_bytes(),
        metadata: vec![("offered_qos_profiles", qos), ("topic_type_hash", definition.hash())],
    }
}
