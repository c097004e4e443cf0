"""The wire of stgdat, schema 2: what its topics carry through shared memory.

Printed by `stgdat wire --python`; not to be edited.

Nothing but Python is needed to import it. `TOPICS` has the elements of each topic's payload slices, with the type names
by which iceoryx2 connects; `DTYPES` the same layouts for numpy, empty where it is not installed:

    numpy.frombuffer(buffer, DTYPES[Forecast], count)
"""

import ctypes as c
import enum

try:
    import numpy
except ModuleNotFoundError:
    numpy = None

# Version of the whole wire: of the header, of every payload and of the topics' type names.
SCHEMA = 2
# Maximum number of agents in a frame.
AGENTS_MAX = 128
# Number of 32-bit words that hold a bit for each agent of a frame.
SHED_WORDS = 4
# Maximum number of detections in a frame.
DETECTIONS_MAX = 512
# Maximum time between a measurement and its frame's stamp, in either direction.
OFFSET_MAX_NS = 1000000000
# Largest number of a sensor in a detection.
SENSORS_MAX = 8
# Largest number of a tick.
SEQ_MAX = 4611686018427387904
# Shortest interval between the frames of ticks.
INTERVAL_MIN_NS = 1000000
# Longest interval between the frames of ticks.
INTERVAL_MAX_NS = 3600000000000
# Maximum number of stages on a tick's path.
HOPS_MAX = 12
# Maximum number of stages that a pipeline file can add to stgdat's own.
ADDED_STAGES_MAX = 16
# Maximum number of topics that a pipeline file can declare.
ADDED_TOPICS_MAX = 16
# Largest element of a topic that a pipeline file declares, in bytes.
ELEMENT_SIZE_MAX = 65536
# Longest history, T_h, in steps.
HISTORY_MAX = 8
# Longest forecast, T_f, in steps.
HORIZON_MAX = 12
# Maximum number of latent draws (modes), K, of an agent.
MODES_MAX = 20
# Maximum number of conflicts in a forecast.
CONFLICTS_MAX = 2
# Maximum number of experts in a forecast's weights.
EXPERTS_MAX = 8
# Maximum number of pairs of sender and cause for which a heartbeat counts refused frames.
REFUSALS_MAX = 8
# Maximum number of edges of all steps of the history graph together, including the self edges.
EDGES_MAX = 32768
# Channels of a local context patch: density and the two components of the mean velocity.
PATCH_CHANNELS = 3
# Largest side of a local context patch, in cells.
PATCH_SIDE_MAX = 32
# Components of the state features s.
STATE_FEATURES = 6
# Components of the relation features φ.
RELATION_FEATURES = 6
# Components of the state embedding SE.
STATE_EMBEDDING = 32
# Components of the context embedding CE.
CONTEXT_EMBEDDING = 32
# Components of a node attribute v = [SE ‖ CE].
NODE_ATTRIBUTES = 64
# Components of an edge attribute e.
EDGE_ATTRIBUTES = 16
# Components of the temporal summary ṽ.
TEMPORAL = 64
# Components of the latent variable z.
LATENT = 32
# Largest magnitude of a world coordinate; beyond it f32 resolves less than 4 mm.
POSITION_MAX_M = 32768.0
# Maximum credible speed of an agent.
SPEED_MAX_MPS = 120.0


class Flags(enum.IntFlag):
    """Bits of `Header.flags`."""

    WARM_UP = 1  # The frame links the pipeline before the first tick: no agents, not counted anywhere.
    END = 2  # The last frame of a recording: no agents; no frame follows.
    HAS_IDENTITIES = 4  # The detections have identities that the tracker may trust instead of associating.
    LOCKSTEP = 8  # The tick runs in lockstep: no stage may give up waiting.
    VOID = 16  # No agents: a stage has refused this tick, or it was a late measurement that was processed out of sequence.
    SEEN_FROM_EGO = 32  # A sensor made the detections from `Header.ego_m`, and objects occlude its view.
    PREDICTED = 64  # No detections arrived for this tick: its tracks are predicted.
    NEW_SESSION = 128  # The tick begins a session: the clock of the stamps was set.


class DetectionFlags(enum.IntFlag):
    """Bits of `Detection.flags`."""

    HAS_ID = 1  # `id` is valid.
    HAS_HEADING = 2  # `heading_rad` is valid.
    HAS_SPEED = 4  # `speed_mps` is valid: along the heading, negative in reverse.
    HAS_SIZE = 8  # `length_m` and `width_m` are valid.


class Doubts(enum.IntFlag):
    """Bits of `InputCounts.doubts`."""

    HEADINGS_IN_DEGREES = 1  # Headings are in degrees.
    HEADINGS_FROM_NORTH = 2  # Headings are clockwise from north, or x and y are swapped.
    HEADINGS_MIRRORED = 4  # Headings mirror the motion: clockwise from +x, or y is flipped.
    HEADINGS_TURNED = 8  # Headings are turned against the motion by a quarter or half turn.
    HEADINGS_UNRELATED = 16  # Headings and motion do not agree.
    SPEEDS_IN_KMH = 32  # Speeds are in km/h.
    SPEEDS_IN_MPH = 64  # Speeds are in mph.
    SPEEDS_DIFFER = 128  # Speeds from positions differ from the reported ones.
    SPEEDS_UNUSUAL = 256  # Agents of a type move at unusual speeds.
    FEET = 512  # Lengths or positions are in feet.
    PIXELS = 1024  # Positions are in pixels.
    STAMPS_IN_OTHER_UNIT = 2048  # Stamps are in another unit than seconds.
    STAMPS_ARE_FRAMES = 4096  # Stamps are the numbers of frames.
    STAMPS_GO_BACK = 8192  # Stamps decrease.
    REPEATED = 16384  # Detections repeat the previous one of a moving agent.
    OUTLIERS = 32768  # Positions that their agent can't have reached.
    PLACEHOLDERS = 65536  # Positions that are placeholders for missing ones.
    IDENTITIES_JUMP = 131072  # Identities jump from one agent to another.
    NOISE_CHANGED = 262144  # The noise of the positions has changed by a factor of three.
    GEOGRAPHIC = 1048576  # Positions are degrees of longitude and latitude.
    STACKED = 2097152  # Boxes are on top of each other.
    SPARSE = 4194304  # Frames are too far apart for agents without identities.
    SEEN_TWICE = 8388608  # Agents take the same paths twice, by two clocks.
    IDENTITIES_CHANGE = 16777216  # Identities change while their agents continue.
    ALL_DISPLACED = 33554432  # All agents are displaced at once.
    SIZES_SWAPPED = 67108864  # Vehicles are wider than they are long.


class StageId(enum.IntEnum):
    """A stage of the pipeline, by number. Numbers below 64 are kept for stages of stgdat's own, 0 stands for none of
    them, 64 is the tap's; from 65 to 80 are those of the stages that a pipeline file adds, in the order of the
    file."""

    SOURCE = 1  # Releases detections.
    TRACKER = 2  # Computes tracks from detections.
    LOCALISER = 3  # Samples local patches of the context map.
    EXTRACTOR = 4  # Computes node and edge attributes.
    ENCODER = 5  # Graph dual attention: the temporal summary of each agent.
    DECODER = 6  # Control Gaussians of each agent, draw and step.
    SAMPLER = 7  # Trajectories through the kinematic layer.
    RECORDER = 8  # Collects the data for the report.


class StampSource(enum.IntEnum):
    """The clock of a frame's `Header.stamp_ns`."""

    UNKNOWN = 0  # The source did not report it.
    RECORDING = 1  # A recording.
    SENSOR_CLOCK = 2  # The sensor's own clock, at its measurement.
    TIME_OF_RECEIPT = 3  # The receiving computer's clock when the measurement arrived: later than the measurement by the transmission time.
    GENERATED = 4  # A generated scene.


class AgentType(enum.IntEnum):
    """The kinds of agents that the model distinguishes. Each has its own state MLP, decoder and motion model."""

    VEHICLE = 0  # Cars, trucks, buses, carts: kinematic bicycle.
    CYCLIST = 1  # Riders of bicycles and similar.
    PEDESTRIAN = 2  # People on foot (and on skates).


class TrackStatus(enum.IntEnum):
    """Whether a track was detected in the newest frame that could contain it."""

    CONFIRMED = 0  # Updated by a detection of the newest frame that observed its type.
    COASTING = 1  # Predicted over one or more frames without a detection.


class Quality(enum.IntEnum):
    """The origin of a forecast."""

    LEARNED = 0  # The model's forecast of this tick.
    HELD = 1  # The model's forecast of an earlier tick, shifted to the current time.
    KINEMATIC = 2  # Zero control with growing covariance.


class Cause(enum.IntEnum):
    """Why a forecast is not `Quality.Learned`. Numbers up to 31, each with a bit in `Forecast.causes`. These are
    reserved for future causes: 7 detections missing, 8 stage restarted, 9 integrity check failed, 10 out of
    distribution, 11 source frozen."""

    NONE = 0  # Nothing is wrong.
    LATE = 1  # The controls of this tick had not arrived at the deadline.
    REJECTED = 2  # The controls of this tick were refused as not finite or impossible.
    MISSING = 3  # The controls of this tick do not contain the track.
    YOUNG = 4  # The track has too short a history for the model.
    OUTDONE = 5  # Constant velocity has more than half of the weight: the other experts proved to be worse.
    SHED = 6  # The agent was left out of this tick, which did not have time for all agents.


class Steering(enum.IntEnum):
    """The meaning of a forecast's controls."""

    NONE = 0  # There are no controls.
    BICYCLE = 1  # Acceleration in m/s² and slip rate in rad/s of a kinematic bicycle.
    DISPLACEMENT = 2  # Displacement of the step relative to constant velocity from the forecast's start, in m along and across the agent.


class Expert(enum.IntEnum):
    """The origin of a mode; numbers below `EXPERTS_MAX` are slots of `Forecast.expert_weights`."""

    NETWORK = 0  # The network.
    BASE = 1  # The model's base control alone.
    CONSTANT_VELOCITY = 2  # Constant velocity.
    DECAYING_TURN = 3  # A decaying turn.
    PROCESS_MODEL = 4  # The tracker's process model: zero control.
    DECAYING_ACCELERATION = 5  # A decaying acceleration.
    FOLLOWING = 6  # A decaying turn with a decaying acceleration, behind the vehicle ahead; of a pedestrian: no motion.
    LANE = 7  # The lane nearest to the decaying turn, with a decaying acceleration, behind the vehicle ahead; of a pedestrian: the mean velocity of the last 1.6 s.
    FAN = 254  # A centre between constant velocity and the single best forecast, plus a typical residual of similar agents.
    RETRIEVAL = 255  # The network's best forecast with residuals of other agents at the same place, from the retrieval memory.


class RefusalCause(enum.IntEnum):
    """Why frames were refused, as heartbeats and reports count it."""

    SCHEMA = 1  # Another schema.
    FOREIGN_RUN = 2  # A frame of another run.
    OLD_INCARNATION = 3  # A frame of a process that has been replaced.
    SIZE = 4  # Sizes that exceed their limits, or that do not match each other or the model.
    VALUE = 5  # A number that is not finite or is impossible.
    ORDER = 6  # Stamps or elements out of order, or repeated.
    CHECK_VALUE = 7  # A check value that does not match header and payload.
    UNPROTECTED = 8  # No check value, although pipeline.toml requires one.
    REPEATED = 9  # A repeated frame, or one that a newer frame has overtaken.
    FROZEN = 10  # Content that does not change while its stamps advance.


class LinkCount(enum.IntEnum):
    """What a stage counts about its link to other boxes: a `Refusals.cause` beyond those of `RefusalCause`."""

    CONNECTIONS = 64  # Connections that were authenticated.
    FRAMES = 65  # Frames that were sent, or received and delivered.
    SKIPPED = 66  # Frames that a newer one has replaced before they were sent or read.
    TOO_OLD = 67  # Received frames that were too old to be delivered.
    LOST = 68  # Connections that were lost, and attempts that failed.
    TOO_SLOW = 69  # Connections without a confirmation in time.
    ANOTHER_KEY = 70  # Connections with another key.
    GARBAGE = 71  # Connections that sent something else, another version or damaged frames.
    NO_ROOM = 72  # Connections that found no room.
    OUTSIDE = 73  # Detections outside of the world.
    SINCE_STAMP_P50 = 128  # Median of the time from the sensor's stamp to the publication, in microseconds.
    SINCE_STAMP_P99 = 129  # The 99th percentile of the same.
    SINCE_STAMP_MAX = 130  # The maximum of the same.


def _check(record, size, offsets):
    """Refuses a machine on which a record does not lie as it does in stgdat."""
    found = {name: getattr(record, name).offset for name in offsets}
    if c.sizeof(record) != size or found != offsets:
        raise ImportError(f"{record.__name__} has {c.sizeof(record)} bytes, {found}, not {size}, {offsets}")


class Protection(c.Structure):
    """The end-to-end protection of a frame, in the order of AUTOSAR's E2E profile 7. All zeros if the frame is not
    protected."""

    _fields_ = [
        ("crc", c.c_uint64),  # CRC-64/XZ of the header after this field, and of the payload.
        ("length", c.c_uint32),  # Total bytes of header and payload.
        ("counter", c.c_uint32),  # Counts the frames of the sender; wraps around.
        ("data_id", c.c_uint32),  # Identifies the topic: FNV-1a of its name, in 32 bits.
        ("reserved", c.c_uint8 * 4),  # Zero.
    ]


_check(Protection, 24, {
    "crc": 0,
    "length": 8,
    "counter": 12,
    "data_id": 16,
    "reserved": 20,
})


class Hop(c.Structure):
    """When one stage processed a tick, on `CLOCK_MONOTONIC`."""

    _fields_ = [
        ("stage", c.c_uint32),  # The stage's `StageId` as a number.
        ("incarnation", c.c_uint32),  # Number of the stage's earlier starts.
        ("received_ns", c.c_uint64),  # When the input was taken from its queue.
        ("started_ns", c.c_uint64),  # When the computation started.
        ("finished_ns", c.c_uint64),  # When the computation ended.
        ("sent_ns", c.c_uint64),  # When the output was passed to the transport.
    ]


_check(Hop, 40, {
    "stage": 0,
    "incarnation": 4,
    "received_ns": 8,
    "started_ns": 16,
    "finished_ns": 24,
    "sent_ns": 32,
})


class Counts(c.Structure):
    """The sizes of a frame's tensors."""

    _fields_ = [
        ("agents_len", c.c_uint32),  # Number of agents (or detections, or truths) in the frame.
        ("history_len", c.c_uint32),  # Steps of the history window, T_h.
        ("horizon_len", c.c_uint32),  # Steps of the forecast, T_f.
        ("modes_len", c.c_uint32),  # Latent draws, K.
        ("patch_side", c.c_uint32),  # Side of the context patches, P, in cells.
        ("edges_len", c.c_uint32),  # Edges of all history steps.
    ]


_check(Counts, 24, {
    "agents_len": 0,
    "history_len": 4,
    "horizon_len": 8,
    "modes_len": 12,
    "patch_side": 16,
    "edges_len": 20,
})


class InputCounts(c.Structure):
    """Counts of the input's contents since the counting stage was started. The source fills `unplayed` and `merged`,
    the tracker the others."""

    _fields_ = [
        ("detections", c.c_uint32),  # Detections that the tracker has processed.
        ("repeated", c.c_uint32),  # Detections identical to the previous one of a moving track: not measurements.
        ("misfits", c.c_uint32),  # Detections that their track can't have reached: treated as missed.
        ("placeholders", c.c_uint32),  # Detections at a placeholder's position.
        ("reassigned", c.c_uint32),  # Tracks whose state was restarted because misfits agreed with one another.
        ("unplayed", c.c_uint32),  # Detections of unplayed frames that are in no played frame.
        ("merged", c.c_uint32),  # Detections of unplayed frames that were sent with another frame.
        ("doubts", c.c_uint32),  # Bits of `doubts` about the input; 0 without any.
    ]


_check(InputCounts, 32, {
    "detections": 0,
    "repeated": 4,
    "misfits": 8,
    "placeholders": 12,
    "reassigned": 16,
    "unplayed": 20,
    "merged": 24,
    "doubts": 28,
})


class Header(c.Structure):
    """The header of every frame."""

    _fields_ = [
        ("protection", Protection),  # End-to-end protection of the frame.
        ("schema", c.c_uint32),  # `SCHEMA` of the sender.
        ("flags", c.c_uint32),  # Bits of `flags`.
        ("run_id", c.c_uint64),  # Identifies the run; frames of other runs are refused.
        ("seq", c.c_uint64),  # The tick's number, from 0, without gaps at the source.
        ("stamp_ns", c.c_int64),  # Time of validity of the detections on the recording's or sensor's clock; the time of all algorithms.
        ("released_ns", c.c_uint64),  # When the source released the tick, on `CLOCK_MONOTONIC`; only for latency and age.
        ("interval_ns", c.c_uint64),  # The interval between frames as planned by the source.
        ("step_ns", c.c_uint64),  # Spacing of history and forecast steps, Δt; 0 before the tracker.
        ("stamp_source", c.c_uint32),  # `StampSource` of `stamp_ns` as a number.
        ("sender", c.c_uint32),  # `StageId` of the frame's sender as a number; 0 if the sender is not a stage.
        ("incarnation", c.c_uint32),  # Number of the sender's earlier starts.
        ("observed_types", c.c_uint32),  # Bits of the agent types that the sensor looked for in this frame.
        ("left_out_len", c.c_uint32),  # Number of agents left out because the frame was full.
        ("hops_len", c.c_uint32),  # Number of valid entries of `hops`.
        ("hops_missing_len", c.c_uint32),  # Number of stages on the tick's path that do not fit in `hops`.
        ("ego_m", c.c_float * 2),  # Position of the ego vehicle, or of the scene's centre, in the world frame.
        ("ego_heading_rad", c.c_float),  # Heading of the ego vehicle, 0 for a fixed sensor.
        ("counts", Counts),  # Sizes of the frame's tensors.
        ("hops", Hop * 12),  # The stages on the tick's path, the source first.
        ("silent_len", c.c_uint32),  # Number of agents without a forecast, by the degradation policy.
        ("resumed_ticks", c.c_uint32),  # In forecasts after a restart of the sampler: number of ticks in the retrieval memory and the evidence that it resumed with; 0 if it resumed without them.
        ("feedback_age_ns", c.c_uint64),  # Time between the stamp of the tracker's newest forecasts and this frame's; 0 if it has none, or does not report it.
        ("chain_ns", c.c_uint64),  # Processing time of those forecasts' agents, from the extractor's end to the decoder's; 0 if they did not pass both.
        ("chain_len", c.c_uint32),  # Number of those agents that the decoder served.
        ("shed", c.c_uint32 * 4),  # Agents of the tick, by their place among its tracks, whose controls were left out to save time: bit `place % 32` of number `place / 32`.
        ("sampling_ns", c.c_uint32),  # Processing time of the sampler for those forecasts; 0 if it is unknown.
        ("input", InputCounts),  # Findings of source and tracker in the detections so far; all 0 if they do not report.
    ]

    @staticmethod
    def type_name():
        """The name by which iceoryx2 knows it."""
        return "stgdat.header.2"


_check(Header, 704, {
    "protection": 0,
    "schema": 24,
    "flags": 28,
    "run_id": 32,
    "seq": 40,
    "stamp_ns": 48,
    "released_ns": 56,
    "interval_ns": 64,
    "step_ns": 72,
    "stamp_source": 80,
    "sender": 84,
    "incarnation": 88,
    "observed_types": 92,
    "left_out_len": 96,
    "hops_len": 100,
    "hops_missing_len": 104,
    "ego_m": 108,
    "ego_heading_rad": 116,
    "counts": 120,
    "hops": 144,
    "silent_len": 624,
    "resumed_ticks": 628,
    "feedback_age_ns": 632,
    "chain_ns": 640,
    "chain_len": 648,
    "shed": 652,
    "sampling_ns": 668,
    "input": 672,
})


class Detection(c.Structure):
    """One detected object: element of the topic `detections`."""

    _fields_ = [
        ("id", c.c_uint64),  # Identity given by the sensor or recording; see `detection_flags.HAS_ID`.
        ("x_m", c.c_float),  # Position in the world frame.
        ("y_m", c.c_float),  # Position in the world frame.
        ("heading_rad", c.c_float),  # Heading, counter-clockwise from +x.
        ("speed_mps", c.c_float),  # Speed along the heading.
        ("length_m", c.c_float),  # Extent along the heading.
        ("width_m", c.c_float),  # Extent across the heading.
        ("score", c.c_float),  # The detector's confidence, higher is more confident; 1 if it reports none.
        ("sigma_m", c.c_float),  # Standard deviation of the position per axis; 0 for the tracker's value for the type.
        ("agent_type", c.c_uint32),  # `AgentType` as a number.
        ("flags", c.c_uint32),  # Bits of `detection_flags`.
        ("offset_ns", c.c_int64),  # Time of the measurement minus the frame's stamp, at most `OFFSET_MAX_NS` in magnitude; 0 if it was made at the stamp.
        ("sensor", c.c_uint8),  # The sensor that made the measurement, from 1 to `SENSORS_MAX`; 0 if it is not reported.
        ("reserved", c.c_uint8 * 7),  # Zero.
    ]

    @staticmethod
    def type_name():
        """The name by which iceoryx2 knows it."""
        return "stgdat.detections.2"


_check(Detection, 64, {
    "id": 0,
    "x_m": 8,
    "y_m": 12,
    "heading_rad": 16,
    "speed_mps": 20,
    "length_m": 24,
    "width_m": 28,
    "score": 32,
    "sigma_m": 36,
    "agent_type": 40,
    "flags": 44,
    "offset_ns": 48,
    "sensor": 56,
    "reserved": 57,
})


class Truth(c.Structure):
    """The true state at the stamp of a frame: element of the topic `truth`, which only the recorder reads."""

    _fields_ = [
        ("id", c.c_uint64),  # Identity in the recording.
        ("agent_type", c.c_uint32),  # `AgentType` as a number.
        ("x_m", c.c_float),  # Position in the world frame.
        ("y_m", c.c_float),  # Position in the world frame.
        ("reserved", c.c_uint8 * 4),  # Zero.
        ("offset_ns", c.c_int64),  # Time of the position minus the frame's stamp.
    ]

    @staticmethod
    def type_name():
        """The name by which iceoryx2 knows it."""
        return "stgdat.truth.2"


_check(Truth, 32, {
    "id": 0,
    "agent_type": 8,
    "x_m": 12,
    "y_m": 16,
    "reserved": 20,
    "offset_ns": 24,
})


class HistoryState(c.Structure):
    """A step of a track's history."""

    _fields_ = [
        ("x_m", c.c_float),  # Position in the world frame.
        ("y_m", c.c_float),  # Position in the world frame.
        ("vx_mps", c.c_float),  # Velocity in the world frame.
        ("vy_mps", c.c_float),  # Velocity in the world frame.
        ("heading_rad", c.c_float),  # Heading, also defined at rest.
        ("present", c.c_uint32),  # 1 if the track has a state at this step, else 0, with all other fields 0.
    ]


_check(HistoryState, 24, {
    "x_m": 0,
    "y_m": 4,
    "vx_mps": 8,
    "vy_mps": 12,
    "heading_rad": 16,
    "present": 20,
})


class Track(c.Structure):
    """A confirmed or coasting track: element of the topic `tracks` and first section of `context`."""

    _fields_ = [
        ("id", c.c_uint64),  # The track's identity; never reused within a run.
        ("source_id", c.c_uint64),  # The detections' own identity if they have one, else 0.
        ("born_ns", c.c_int64),  # Stamp of the track's first state.
        ("unseen_ns", c.c_uint64),  # Time since the last detection that updated the track.
        ("agent_type", c.c_uint32),  # `AgentType` as a number.
        ("status", c.c_uint32),  # `TrackStatus` as a number.
        ("state_len", c.c_uint32),  # Rows of the covariance in use: 5 for [x, y, ψ, v, β], 4 for [x, y, vx, vy].
        ("forecastable", c.c_uint32),  # 1 if the track is at least Δt old and has two states in its history, else 0.
        ("x_m", c.c_float),  # Filtered position.
        ("y_m", c.c_float),  # Filtered position.
        ("heading_rad", c.c_float),  # Filtered heading.
        ("speed_mps", c.c_float),  # Filtered speed along the heading; negative in reverse.
        ("slip_rad", c.c_float),  # Filtered slip angle; 0 if the state has none.
        ("vx_mps", c.c_float),  # Filtered velocity in the world frame.
        ("vy_mps", c.c_float),  # Filtered velocity in the world frame.
        ("length_m", c.c_float),  # Extent along the heading; 0 if unknown.
        ("width_m", c.c_float),  # Extent across the heading; 0 if unknown.
        ("existence", c.c_float),  # Probability that the object exists.
        ("type_probability", c.c_float * 3),  # Probability of each `AgentType`.
        ("covariance", c.c_float * 25),  # Covariance of the filtered state, row-major, `state_len` × `state_len`, the rest 0.
        ("history", HistoryState * 8),  # States at now − (T_h − 1 − k) Δt, oldest first, in the first `history_len` entries.
        ("prior", c.c_uint32),  # `Quality` of the prediction to this stamp, as a number: a forecast, one that is older than Δt, or the process model alone.
        ("noise_m", c.c_float),  # Standard deviation per axis of the positions that the detector reports for the track's type, as the tracker has learned it; 0 without enough evidence, and if it is not reported.
        ("prior_age_ns", c.c_uint64),  # Time since the stamp of that forecast's controls; 0 if there is none.
        ("prior_weights", c.c_float * 21),  # Weight of each of its modes, and last the weight of the process model; they sum to 1.
        ("noise_heading_rad", c.c_float),  # The same of the headings, modulo a half turn.
        ("learned_age_ns", c.c_uint64),  # Time between the stamp of the controls of the track's newest learned forecast that the tracker has received and this frame's; 0 if there is none, or it is not reported.
        ("noise_speed_mps", c.c_float),  # The same of the speeds.
        ("reserved", c.c_uint8 * 4),  # Zero.
    ]

    @staticmethod
    def type_name():
        """The name by which iceoryx2 knows it."""
        return "stgdat.tracks.2"


_check(Track, 512, {
    "id": 0,
    "source_id": 8,
    "born_ns": 16,
    "unseen_ns": 24,
    "agent_type": 32,
    "status": 36,
    "state_len": 40,
    "forecastable": 44,
    "x_m": 48,
    "y_m": 52,
    "heading_rad": 56,
    "speed_mps": 60,
    "slip_rad": 64,
    "vx_mps": 68,
    "vy_mps": 72,
    "length_m": 76,
    "width_m": 80,
    "existence": 84,
    "type_probability": 88,
    "covariance": 100,
    "history": 200,
    "prior": 392,
    "noise_m": 396,
    "prior_age_ns": 400,
    "prior_weights": 408,
    "noise_heading_rad": 492,
    "learned_age_ns": 496,
    "noise_speed_mps": 504,
    "reserved": 508,
})


class Row(c.Structure):
    """64 bytes, one cache line: the unit of `context` and `features` payloads, whose sections are cast from it."""

    _align_ = 64  # of Python 3.13 on; topics are aligned all the same
    _fields_ = [
        ("values", c.c_float * 16),  # The bytes, as single-precision numbers.
    ]


_check(Row, 64, {
    "values": 0,
})


class AgentFeatures(c.Structure):
    """The extractor's output for an agent: first section of the topic `features`."""

    _fields_ = [
        ("id", c.c_uint64),  # The track.
        ("agent_type", c.c_uint32),  # `AgentType` as a number.
        ("forecastable", c.c_uint32),  # As in `Track.forecastable`.
        ("present", c.c_uint32),  # Bit k is set if the agent has a state at history step k.
        ("length_m", c.c_float),  # Length if known, else 0; determines the rear axle of the bicycle.
        ("state", c.c_float * 6 * 8),  # State features s in the model's scale; zero rows for absent steps.
        ("node", c.c_float * 64 * 8),  # Node attributes v = [SE ‖ CE]; zero rows for absent steps.
        ("turn", c.c_uint32),  # Its turn from 1, if a tick does not have time for all agents; 0 for the order of the frame.
        ("shed", c.c_uint32),  # 1 if the agent is left out of this tick to save time: it is present only for its neighbours.
        ("reserved", c.c_uint8 * 32),  # Zero.
    ]


_check(AgentFeatures, 2304, {
    "id": 0,
    "agent_type": 8,
    "forecastable": 12,
    "present": 16,
    "length_m": 20,
    "state": 24,
    "node": 216,
    "turn": 2264,
    "shed": 2268,
    "reserved": 2272,
})


class Edge(c.Structure):
    """The ends of a directed edge e_ij at a history step: i receives, j sends."""

    _fields_ = [
        ("step", c.c_uint16),  # History step.
        ("receiver", c.c_uint16),  # Agent i.
        ("sender", c.c_uint16),  # Agent j; i itself for the self edge.
        ("reserved", c.c_uint16),  # Zero.
    ]


_check(Edge, 8, {
    "step": 0,
    "receiver": 2,
    "sender": 4,
    "reserved": 6,
})


class AgentEncoding(c.Structure):
    """The graph dual attention's summary of an agent: element of the topic `encodings`."""

    _fields_ = [
        ("id", c.c_uint64),  # The track.
        ("agent_type", c.c_uint32),  # `AgentType` as a number.
        ("forecastable", c.c_uint32),  # As in `Track.forecastable`.
        ("present", c.c_uint32),  # Bit k is set if the agent has a state at history step k.
        ("length_m", c.c_float),  # Length if known, else 0.
        ("state", c.c_float * 6 * 8),  # State features s as in `AgentFeatures`: the decoder's burn-in and the base control read them.
        ("temporal", c.c_float * 64),  # The temporal summary ṽ_h.
        ("turn", c.c_uint32),  # Its turn from 1, if a tick does not have time for all agents; 0 for the order of the frame.
        ("shed", c.c_uint32),  # 1 if the agent is left out of this tick to save time: it is present only for its neighbours.
        ("reserved", c.c_uint8 * 32),  # Zero.
    ]

    @staticmethod
    def type_name():
        """The name by which iceoryx2 knows it."""
        return "stgdat.encodings.2"


_check(AgentEncoding, 512, {
    "id": 0,
    "agent_type": 8,
    "forecastable": 12,
    "present": 16,
    "length_m": 20,
    "state": 24,
    "temporal": 216,
    "turn": 472,
    "shed": 476,
    "reserved": 480,
})


class ControlGaussian(c.Structure):
    """The Gaussian of a control u = μ + L ε."""

    _fields_ = [
        ("mean", c.c_float * 2),  # Mean μ, see `Steering`.
        ("cholesky", c.c_float * 3),  # Lower Cholesky factor L as [l11, l21, l22].
    ]


_check(ControlGaussian, 20, {
    "mean": 0,
    "cholesky": 8,
})


class AgentControls(c.Structure):
    """The controls of an agent with a forecast: element of the topic `controls`."""

    _fields_ = [
        ("id", c.c_uint64),  # The track.
        ("agent_type", c.c_uint32),  # `AgentType` as a number.
        ("modes_len", c.c_uint32),  # Valid modes, at most `MODES_MAX`.
        ("probability", c.c_float * 20),  # Probability of each mode; they sum to 1.
        ("modes", ControlGaussian * 12 * 20),  # Controls of each mode and step, before saturation: acceleration and slip rate for a vehicle, otherwise displacements.
        ("best", ControlGaussian * 12),  # Controls of the single best forecast (K = 1).
        ("base", c.c_float * 2 * 12),  # The model's base control for the single best forecast, without the network's part; zeros if the model has no base.
        ("out_of_distribution", c.c_float),  # Distance of the history from the data that the base control was fitted to, relative to its width; 0 inside, and if the model does not report it.
        ("reserved", c.c_uint8 * 76),  # Zero.
    ]

    @staticmethod
    def type_name():
        """The name by which iceoryx2 knows it."""
        return "stgdat.controls.2"


_check(AgentControls, 5312, {
    "id": 0,
    "agent_type": 8,
    "modes_len": 12,
    "probability": 16,
    "modes": 96,
    "best": 4896,
    "base": 5136,
    "out_of_distribution": 5232,
    "reserved": 5236,
})


class ForeseenConflict(c.Structure):
    """A conflict that forecasts foretell: two agents whose outlines may come closer than 0.5 m within the horizon."""

    _fields_ = [
        ("other_id", c.c_uint64),  # The other track.
        ("probability", c.c_float),  # Probability that the conflict happens: the share of such pairs on recordings.
        ("if_nobody_reacts", c.c_float),  # Probability by the modes, as if neither agent reacted to the other.
        ("in_s", c.c_float),  # Mean time until it happens, s.
        ("reserved", c.c_uint32),  # Zero.
    ]


_check(ForeseenConflict, 24, {
    "other_id": 0,
    "probability": 8,
    "if_nobody_reacts": 12,
    "in_s": 16,
    "reserved": 20,
})


class Forecast(c.Structure):
    """The forecast of an agent: element of the topic `forecasts`. Step k is (k + 1) Δt after the frame's stamp."""

    _fields_ = [
        ("id", c.c_uint64),  # The track.
        ("source_id", c.c_uint64),  # The detections' own identity if they have one, else 0.
        ("age_ns", c.c_uint64),  # Time between the stamp of the controls and this frame's stamp; 0 for learned forecasts.
        ("prior_age_ns", c.c_uint64),  # As in `Track.prior_age_ns`.
        ("agent_type", c.c_uint32),  # `AgentType` as a number.
        ("quality", c.c_uint32),  # `Quality` as a number.
        ("cause", c.c_uint32),  # `Cause` as a number: the first one that applies.
        ("causes", c.c_uint32),  # Bits of all causes that apply, see `Cause.bit`; 0 if there are none.
        ("modes_len", c.c_uint32),  # Valid modes, at most `MODES_MAX`.
        ("prior", c.c_uint32),  # As in `Track.prior`.
        ("steering", c.c_uint32),  # `Steering` as a number.
        ("frame_heading_rad", c.c_float),  # Direction of the axes of displacements: the agent's heading at the stamp of the controls.
        ("x_m", c.c_float),  # Position at the stamp.
        ("y_m", c.c_float),  # Position at the stamp.
        ("vx_mps", c.c_float),  # Velocity at the stamp.
        ("vy_mps", c.c_float),  # Velocity at the stamp.
        ("heading_rad", c.c_float),  # Heading at the stamp.
        ("length_m", c.c_float),  # Extent along the heading; 0 if unknown.
        ("width_m", c.c_float),  # Extent across the heading; 0 if unknown.
        ("out_of_distribution", c.c_float),  # Distance of the agent's history from the model's training data, relative to their width; 0 inside, and if it is not reported.
        ("expert_weights", c.c_float * 8),  # Weight of each `Expert` by its number: network, base, constant velocity, decaying turn, process model, decaying acceleration, following or standing, lane or mean velocity; zeros if they are not reported.
        ("probability", c.c_float * 20),  # Probability of each mode; they sum to 1.
        ("mode_expert", c.c_uint8 * 20),  # `Expert` of each mode as a number.
        ("lanes", c.c_uint32),  # 1 if the forecast follows lanes of the map, 2 if a moving vehicle is not on a lane; 0 without a map, for all other agents, and if it is not reported.
        ("noise_m", c.c_float),  # As in `Track.noise_m`.
        ("noise_heading_rad", c.c_float),  # As in `Track.noise_heading_rad`.
        ("noise_speed_mps", c.c_float),  # As in `Track.noise_speed_mps`.
        ("conflicts_len", c.c_uint32),  # Conflicts in `conflicts`.
        ("conflicts", ForeseenConflict * 2),  # The agent's most probable conflicts, the most probable first; none if the sampler is not asked for them.
        ("reserved", c.c_uint8 * 8),  # Zero.
        ("covariance", c.c_float * 3 * 12),  # Covariance of the mixture of all modes as (xx, xy, yy), m².
        ("best", c.c_float * 2 * 12),  # The single best forecast (K = 1).
        ("mean", c.c_float * 2 * 12),  # Mean of the mixture of all modes.
        ("modes", c.c_float * 2 * 12 * 20),  # Mean positions (x, y) of each mode and step in the world frame, m.
        ("mode_covariance", c.c_float * 3 * 12 * 20),  # Covariance of the position of each mode and step as (xx, xy, yy), m².
        ("controls", ControlGaussian * 12 * 20),  # The controls that lead to `modes`, as applied (after saturation), with their first step at the stamp of the controls; zeros if `steering` is 0, none.
        ("reserved_end", c.c_uint8 * 64),  # Zero.
    ]

    @staticmethod
    def type_name():
        """The name by which iceoryx2 knows it."""
        return "stgdat.forecasts.2"


_check(Forecast, 10304, {
    "id": 0,
    "source_id": 8,
    "age_ns": 16,
    "prior_age_ns": 24,
    "agent_type": 32,
    "quality": 36,
    "cause": 40,
    "causes": 44,
    "modes_len": 48,
    "prior": 52,
    "steering": 56,
    "frame_heading_rad": 60,
    "x_m": 64,
    "y_m": 68,
    "vx_mps": 72,
    "vy_mps": 76,
    "heading_rad": 80,
    "length_m": 84,
    "width_m": 88,
    "out_of_distribution": 92,
    "expert_weights": 96,
    "probability": 128,
    "mode_expert": 208,
    "lanes": 228,
    "noise_m": 232,
    "noise_heading_rad": 236,
    "noise_speed_mps": 240,
    "conflicts_len": 244,
    "conflicts": 248,
    "reserved": 296,
    "covariance": 304,
    "best": 448,
    "mean": 544,
    "modes": 640,
    "mode_covariance": 2560,
    "controls": 5440,
    "reserved_end": 10240,
})


class Refusals(c.Structure):
    """Frames of one sender that one reader has refused for one cause, or a count of the reader's link."""

    _fields_ = [
        ("sender", c.c_uint16),  # The `StageId` of the frames' sender as a number; 0 if the sender is not a stage.
        ("cause", c.c_uint16),  # The `RefusalCause` or `LinkCount` as a number; 0 if the entry is free.
        ("frames_len", c.c_uint32),  # Number of frames, or the count of the link.
    ]


_check(Refusals, 8, {
    "sender": 0,
    "cause": 2,
    "frames_len": 4,
})


class Heartbeat(c.Structure):
    """A stage's sign of life: element of the topic `heartbeats`."""

    _fields_ = [
        ("stage", c.c_uint32),  # The stage's number.
        ("incarnation", c.c_uint32),  # Number of the stage's earlier starts.
        ("pid", c.c_uint32),  # The operating system's process number.
        ("linked", c.c_uint32),  # 1 after a frame has passed from the stage's input to its output, else 0.
        ("beat", c.c_uint64),  # Counts the stage's heartbeats.
        ("seq", c.c_uint64),  # Number of the newest tick that the stage has finished.
        ("frames_len", c.c_uint64),  # Number of finished frames.
        ("rejected_len", c.c_uint64),  # Number of refused frames.
        ("dropped_len", c.c_uint32),  # Number of ticks with a frame that never arrived, by gaps in `seq`.
        ("unanswered_len", c.c_uint32),  # The subset of these ticks whose missing frame starts a step: the stage has sent nothing for them.
        ("sent_ns", c.c_uint64),  # Time of sending, on `CLOCK_MONOTONIC`.
        ("refusals", Refusals * 8),  # Number of refused frames by sender and cause, and the counts of the stage's link to other boxes.
    ]

    @staticmethod
    def type_name():
        """The name by which iceoryx2 knows it."""
        return "stgdat.heartbeats.2"


_check(Heartbeat, 128, {
    "stage": 0,
    "incarnation": 4,
    "pid": 8,
    "linked": 12,
    "beat": 16,
    "seq": 24,
    "frames_len": 32,
    "rejected_len": 40,
    "dropped_len": 48,
    "unanswered_len": 52,
    "sent_ns": 56,
    "refusals": 64,
})


class ContextRow(Row):
    """Localiser → extractor: tracks and their local patches of the context map."""

    @staticmethod
    def type_name():
        """The name by which iceoryx2 knows it."""
        return "stgdat.context.2"


class FeaturesRow(Row):
    """Extractor → encoder: node and edge attributes of the history graph."""

    @staticmethod
    def type_name():
        """The name by which iceoryx2 knows it."""
        return "stgdat.features.2"


# All records, each after those that it is made of.
RECORDS = [
    Protection,
    Hop,
    Counts,
    InputCounts,
    Header,
    Detection,
    Truth,
    HistoryState,
    Track,
    Row,
    AgentFeatures,
    Edge,
    AgentEncoding,
    ControlGaussian,
    AgentControls,
    ForeseenConflict,
    Forecast,
    Refusals,
    Heartbeat,
]

# Elements by topic; the service of iceoryx2 is "stgdat/NAME".
TOPICS = {
    "detections": Detection,  # Source → tracker: the sensor's detections.
    "tracks": Track,  # Tracker → localiser, sampler, users: confirmed and coasting tracks.
    "context": ContextRow,  # Localiser → extractor: tracks and their local patches of the context map.
    "features": FeaturesRow,  # Extractor → encoder: node and edge attributes of the history graph.
    "encodings": AgentEncoding,  # Encoder → decoder: the temporal summary of each agent.
    "controls": AgentControls,  # Decoder → sampler: control Gaussians per agent, mode and step.
    "forecasts": Forecast,  # Sampler → tracker, users: trajectories with probabilities and moments.
    "truth": Truth,  # Source → recorder: the agents' true positions, for the accuracy in the report.
    "heartbeats": Heartbeat,  # All stages → launcher, source, recorder: signs of life.
}

# What `Protection.data_id` is on each topic.
DATA_IDS = {
    "detections": 0x5e020e8d,
    "tracks": 0x50b1805d,
    "context": 0x8c87107c,
    "features": 0x5f8383ca,
    "encodings": 0x296ad139,
    "controls": 0xfd20ce17,
    "forecasts": 0x479c4999,
    "truth": 0xd677fb5e,
    "heartbeats": 0x4225a96c,
}


def _crc64(data):
    """CRC-64/XZ of some bytes: the check value that the format .xz keeps of what it holds."""
    import lzma  # Some builds of Python lack it.

    fastest = {"id": lzma.FILTER_LZMA2, "preset": 0, "mf": lzma.MF_HC3, "nice_len": 3, "depth": 1}
    packed = lzma.compress(data, lzma.FORMAT_XZ, lzma.CHECK_CRC64, filters=[fastest])
    # Before the last 12 bytes lies the index, whose length they tell; before it the check value.
    index = 4 * (int.from_bytes(packed[-8:-4], "little") + 1)
    return int.from_bytes(packed[-20 - index:-12 - index], "little")


def protect(header, payload, topic, counter):
    """Protects a frame: the last thing before it is sent. `counter` counts the sender's frames."""
    payload = bytes(payload)
    header.protection = Protection(length=c.sizeof(header) + len(payload), counter=counter, data_id=DATA_IDS[topic])
    header.protection.crc = _crc64(bytes(header)[8:] + payload)


def is_intact(header, payload, topic):
    """Whether a frame is what its sender protected."""
    payload, protection = bytes(payload), header.protection
    sizes = c.sizeof(header) + len(payload), DATA_IDS[topic]
    return (protection.length, protection.data_id) == sizes and protection.crc == _crc64(bytes(header)[8:] + payload)

DTYPES = {} if numpy is None else {record: numpy.dtype(record) for record in RECORDS}
for _record, _dtype in DTYPES.items():
    if _dtype.itemsize != c.sizeof(_record) or any(
            _dtype.fields[name][1] != getattr(_record, name).offset for name in _dtype.names):
        raise ImportError(f"numpy lays {_record.__name__} out otherwise")
