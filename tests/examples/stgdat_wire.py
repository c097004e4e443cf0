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
# Most agents in a frame.
AGENTS_MAX = 128
# Numbers of 32 bits that hold a bit for each agent of a frame.
SHED_WORDS = 4
# Most detections in a frame.
DETECTIONS_MAX = 512
# Greatest time between a measurement and the stamp of its frame, either way.
OFFSET_MAX_NS = 1000000000
# Most stages that a tick can pass.
HOPS_MAX = 12
# Most stages that a pipeline file can add to those of stgdat's own.
ADDED_STAGES_MAX = 16
# Most topics that a pipeline file can declare.
ADDED_TOPICS_MAX = 16
# Largest element of a topic that a pipeline file declares, in bytes.
ELEMENT_SIZE_MAX = 65536
# Longest history, T_h, in steps.
HISTORY_MAX = 8
# Longest forecast, T_f, in steps.
HORIZON_MAX = 12
# Most latent draws (modes), K, of an agent.
MODES_MAX = 20
# Most experts that a forecast can be weighed of.
EXPERTS_MAX = 8
# Pairs of sender and cause by which a heartbeat counts refused frames.
REFUSALS_MAX = 8
# Most edges of all steps of the history graph together, the self edges included.
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
# Largest speed that is believed of an agent.
SPEED_MAX_MPS = 120.0


class Flags(enum.IntFlag):
    """Bits of `Header.flags`."""

    WARM_UP = 1  # The frame links the pipeline before the first tick: no agents, not counted anywhere.
    END = 2  # The last frame of a recording: no agents, tells every stage that nothing follows.
    HAS_IDENTITIES = 4  # The detections carry identities that the tracker may trust instead of associating.
    LOCKSTEP = 8  # The tick runs in lockstep: no stage may give up waiting.
    VOID = 16  # A stage has refused this tick, or it came late and was taken in where it belongs: no agents.
    SEEN_FROM_EGO = 32  # The detections were made from `Header.ego_m`, by a sensor that can't see past what stands in its way.
    PREDICTED = 64  # No detections have come for this tick: its tracks are predicted.


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
    SPEEDS_DIFFER = 128  # Positions move at another speed than is reported.
    SPEEDS_UNUSUAL = 256  # Agents of a type move at unusual speeds.
    FEET = 512  # Lengths or positions are in feet.
    PIXELS = 1024  # Positions are in pixels.
    STAMPS_IN_OTHER_UNIT = 2048  # Stamps are in another unit than seconds.
    STAMPS_ARE_FRAMES = 4096  # Stamps are the numbers of frames.
    STAMPS_GO_BACK = 8192  # Stamps go back in time.
    REPEATED = 16384  # Detections repeat the previous one of a moving agent.
    OUTLIERS = 32768  # Positions that their agent can't have reached.
    PLACEHOLDERS = 65536  # Positions that stand for a missing one.
    IDENTITIES_JUMP = 131072  # Identities jump from one agent to another.


class StageId(enum.IntEnum):
    """A stage of the pipeline, by number. Numbers below 64 are kept for stages of stgdat's own, 0 stands for none of
    them, 64 is the tap's; from 65 to 80 are those of the stages that a pipeline file adds, in the order of the
    file."""

    SOURCE = 1  # Releases detections.
    TRACKER = 2  # Makes tracks of detections.
    LOCALISER = 3  # Samples local patches of the context map.
    EXTRACTOR = 4  # Computes node and edge attributes.
    ENCODER = 5  # Graph dual attention: the temporal summary of each agent.
    DECODER = 6  # Control Gaussians of each agent, draw and step.
    SAMPLER = 7  # Trajectories through the kinematic layer.
    RECORDER = 8  # Keeps what the report needs.


class StampSource(enum.IntEnum):
    """What a frame's `Header.stamp_ns` was read off."""

    UNKNOWN = 0  # The source did not say.
    RECORDING = 1  # A recording.
    SENSOR_CLOCK = 2  # The sensor's own clock, at its measurement.
    TIME_OF_RECEIPT = 3  # A clock of the receiving computer, when the measurement had come in: later than the measurement by its way.
    GENERATED = 4  # A scene that was generated.


class AgentType(enum.IntEnum):
    """The kinds of agents that the model tells apart; each has state MLP, decoder and motion model of its own."""

    VEHICLE = 0  # Cars, trucks, buses, carts: kinematic bicycle.
    CYCLIST = 1  # Riders of bicycles and similar.
    PEDESTRIAN = 2  # People on foot (and on skates).


class TrackStatus(enum.IntEnum):
    """Whether a track was seen in the newest frame that could have seen it."""

    CONFIRMED = 0  # Updated by a detection of the newest frame that observed its type.
    COASTING = 1  # Predicted over one or more frames without a detection.


class Quality(enum.IntEnum):
    """Where a forecast comes from."""

    LEARNED = 0  # The model's forecast of this tick.
    HELD = 1  # The model's forecast of an earlier tick, moved on to now.
    KINEMATIC = 2  # Zero control with growing covariance.


class Cause(enum.IntEnum):
    """Why a forecast is not `Quality.Learned`. Numbers up to 31, a bit each in `Forecast.causes`. These are kept for
    causes to come: 7 detections missing, 8 stage restarted, 9 integrity check failed, 10 out of distribution, 11
    source frozen."""

    NONE = 0  # Nothing is wrong.
    LATE = 1  # The controls of this tick had not come at the deadline.
    REJECTED = 2  # The controls of this tick were refused as not finite or impossible.
    MISSING = 3  # The controls of this tick do not name the track.
    YOUNG = 4  # The track has too short a history for the model.
    OUTDONE = 5  # Constant velocity has more than half of the weight: the other experts proved worse.
    SHED = 6  # The agent was left out of this tick, which had no time for all.


class Steering(enum.IntEnum):
    """What the controls of a forecast stand for."""

    NONE = 0  # There are none.
    BICYCLE = 1  # Acceleration in m/s² and slip rate in rad/s of a kinematic bicycle.
    DISPLACEMENT = 2  # Displacement of the step beyond that of the velocity at the forecast's start, in m along and across the agent.


class Expert(enum.IntEnum):
    """What a mode comes from; numbers below `EXPERTS_MAX` are slots of `Forecast.expert_weights`."""

    NETWORK = 0  # The network.
    BASE = 1  # The model's base control alone.
    CONSTANT_VELOCITY = 2  # Constant velocity.
    DECAYING_TURN = 3  # A turn that decays.
    PROCESS_MODEL = 4  # The tracker's process model: zero control.
    DECAYING_ACCELERATION = 5  # An acceleration that decays.
    FAN = 254  # A middle between constant velocity and the single best forecast, with a typical residual of agents alike.
    RETRIEVAL = 255  # The network's best forecast with residuals of others at the same place, from the retrieval memory.


class RefusalCause(enum.IntEnum):
    """Why frames were refused, as heartbeats and reports count it."""

    SCHEMA = 1  # Another schema.
    FOREIGN_RUN = 2  # A frame of another run.
    OLD_INCARNATION = 3  # A frame of a process that has been replaced.
    SIZE = 4  # Sizes beyond their limits, or that do not agree with each other or with the model.
    VALUE = 5  # A number that is not finite or can't be.
    ORDER = 6  # Stamps or elements out of order, or twice.
    CHECK_VALUE = 7  # A check value that header and payload do not have.
    UNPROTECTED = 8  # No check value, where pipeline.toml asks for one.
    REPEATED = 9  # A frame that came before, or one that a newer frame has overtaken.
    FROZEN = 10  # Content that stands still while its stamps go on.


def _check(record, size, offsets):
    """Refuses a machine on which a record does not lie as it does in stgdat."""
    found = {name: getattr(record, name).offset for name in offsets}
    if c.sizeof(record) != size or found != offsets:
        raise ImportError(f"{record.__name__} has {c.sizeof(record)} bytes, {found}, not {size}, {offsets}")


class Protection(c.Structure):
    """The end-to-end protection of a frame, in the order of AUTOSAR's E2E profile 7. All zeros: not protected."""

    _fields_ = [
        ("crc", c.c_uint64),  # CRC-64/XZ of the header behind this field and of the payload.
        ("length", c.c_uint32),  # Bytes of header and payload together.
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
    """When one stage had a tick in hand; `CLOCK_MONOTONIC`."""

    _fields_ = [
        ("stage", c.c_uint32),  # The stage's `StageId` as a number.
        ("incarnation", c.c_uint32),  # How often the stage had been started before.
        ("received_ns", c.c_uint64),  # The input was taken from its queue.
        ("started_ns", c.c_uint64),  # The computation began.
        ("finished_ns", c.c_uint64),  # The computation ended.
        ("sent_ns", c.c_uint64),  # The output was handed to the transport.
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
        ("agents_len", c.c_uint32),  # Agents (or detections, or truths) in the frame.
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
    """Counts of what the input contained, since the stage that counts was started. The source fills `unplayed` and
    `merged`, the tracker the others."""

    _fields_ = [
        ("detections", c.c_uint32),  # Detections that the tracker has taken in.
        ("repeated", c.c_uint32),  # Detections that repeat the last one of a moving track to the bit: no measurements.
        ("misfits", c.c_uint32),  # Detections that their track can't have reached: treated as missed.
        ("placeholders", c.c_uint32),  # Detections at a placeholder's position.
        ("reassigned", c.c_uint32),  # Tracks whose state began again because misfits agreed with one another.
        ("unplayed", c.c_uint32),  # Detections of unplayed frames that no played frame contains.
        ("merged", c.c_uint32),  # Detections of unplayed frames that went out with another frame.
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
        ("released_ns", c.c_uint64),  # When the source released the tick, `CLOCK_MONOTONIC`; for latency and age only.
        ("interval_ns", c.c_uint64),  # The interval between frames as planned by the source.
        ("step_ns", c.c_uint64),  # Spacing of history and forecast steps, Δt; 0 before the tracker.
        ("stamp_source", c.c_uint32),  # `StampSource` of `stamp_ns` as a number.
        ("sender", c.c_uint32),  # `StageId` of the frame's sender as a number, 0 where it is no stage.
        ("incarnation", c.c_uint32),  # How often the sender had been started before.
        ("observed_types", c.c_uint32),  # Bits of the agent types that the sensor looked for in this frame.
        ("left_out_len", c.c_uint32),  # Agents left out because the frame was full.
        ("hops_len", c.c_uint32),  # Valid entries of `hops`.
        ("hops_missing_len", c.c_uint32),  # Stages that the tick has passed beyond those of `hops`.
        ("ego_m", c.c_float * 2),  # Position of the ego vehicle, or of the scene's centre, in the world frame.
        ("ego_heading_rad", c.c_float),  # Heading of the ego vehicle, 0 for a fixed sensor.
        ("counts", Counts),  # Sizes of the frame's tensors.
        ("hops", Hop * 12),  # The stages that the tick has passed, the source first.
        ("silent_len", c.c_uint32),  # Agents of which the forecasts say nothing, by the policy of degradation.
        ("resumed_ticks", c.c_uint32),  # Of forecasts whose sampler was restarted: how many ticks its retrieval memory and its evidence had behind them when it began with them; 0 where it began without.
        ("feedback_age_ns", c.c_uint64),  # Time between the stamp of the newest forecasts that the tracker has and this frame's; 0 where it has none, or does not tell.
        ("chain_ns", c.c_uint64),  # How long the agents of those forecasts took from the extractor's end to the decoder's; 0 where they did not pass both.
        ("chain_len", c.c_uint32),  # How many of those agents the decoder served.
        ("shed", c.c_uint32 * 4),  # Agents of the tick, by their place among its tracks, whose controls were left out to save time: bit `place % 32` of number `place / 32`.
        ("sampling_ns", c.c_uint32),  # How long the sampler took for those forecasts; 0 where it is not known.
        ("input", InputCounts),  # What source and tracker have found in the detections so far; all 0 where they do not report.
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
        ("score", c.c_float),  # The detector's confidence, greater is surer; 1 where it reports none.
        ("sigma_m", c.c_float),  # Standard deviation of the position per axis; 0 takes the tracker's own for the type.
        ("agent_type", c.c_uint32),  # `AgentType` as a number.
        ("flags", c.c_uint32),  # Bits of `detection_flags`.
        ("offset_ns", c.c_int64),  # Time of the measurement less the frame's stamp, at most `OFFSET_MAX_NS` either way; 0 where it was made at the stamp.
        ("reserved", c.c_uint8 * 8),  # Zero.
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
    "reserved": 56,
})


class Truth(c.Structure):
    """What was really there at the stamp of a frame: element of the topic `truth`, which the recorder alone reads."""

    _fields_ = [
        ("id", c.c_uint64),  # Identity in the recording.
        ("agent_type", c.c_uint32),  # `AgentType` as a number.
        ("x_m", c.c_float),  # Position in the world frame.
        ("y_m", c.c_float),  # Position in the world frame.
        ("reserved", c.c_uint8 * 4),  # Zero.
        ("offset_ns", c.c_int64),  # Time of the position less the frame's stamp.
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
        ("heading_rad", c.c_float),  # Heading; defined also at rest.
        ("present", c.c_uint32),  # 1 where the track has a state at this step, else 0 and all others 0.
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
        ("source_id", c.c_uint64),  # The detections' own identity where they carry one, else 0.
        ("born_ns", c.c_int64),  # Stamp of the track's first state.
        ("unseen_ns", c.c_uint64),  # Time since the last detection that updated the track.
        ("agent_type", c.c_uint32),  # `AgentType` as a number.
        ("status", c.c_uint32),  # `TrackStatus` as a number.
        ("state_len", c.c_uint32),  # Rows of the covariance in use: 5 for [x, y, ψ, v, β], 4 for [x, y, vx, vy].
        ("forecastable", c.c_uint32),  # 1 once the track is Δt old and has two states in its history, else 0.
        ("x_m", c.c_float),  # Filtered position.
        ("y_m", c.c_float),  # Filtered position.
        ("heading_rad", c.c_float),  # Filtered heading; turns by at most 60° from one frame to the next, also where the front is found to be the back.
        ("speed_mps", c.c_float),  # Filtered speed along the heading; negative in reverse.
        ("slip_rad", c.c_float),  # Filtered slip angle; 0 where the state has none.
        ("vx_mps", c.c_float),  # Filtered velocity in the world frame.
        ("vy_mps", c.c_float),  # Filtered velocity in the world frame.
        ("length_m", c.c_float),  # Extent along the heading; 0 where unknown.
        ("width_m", c.c_float),  # Extent across the heading; 0 where unknown.
        ("existence", c.c_float),  # Probability that the object exists.
        ("type_probability", c.c_float * 3),  # Probability of each `AgentType`.
        ("covariance", c.c_float * 25),  # Covariance of the filtered state, row-major, `state_len` × `state_len`, the rest 0.
        ("history", HistoryState * 8),  # States at now − (T_h − 1 − k) Δt, oldest first, in the first `history_len` entries.
        ("prior", c.c_uint32),  # `Quality` of what moved the state to this stamp, as a number: a forecast, one that is older than Δt, or the process model alone.
        ("reserved", c.c_uint8 * 4),  # Zero.
        ("prior_age_ns", c.c_uint64),  # Time since the stamp of that forecast's controls; 0 where there is none.
        ("prior_weights", c.c_float * 21),  # Weight of each of its modes, and last that of the process model alone; they sum to 1.
        ("reserved_middle", c.c_uint8 * 4),  # Zero.
        ("learned_age_ns", c.c_uint64),  # Time between the stamp of the controls of the track's newest learned forecast that the tracker has seen and this frame's; 0 where it has seen none, or does not tell.
        ("reserved_end", c.c_uint8 * 8),  # Zero.
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
    "reserved": 396,
    "prior_age_ns": 400,
    "prior_weights": 408,
    "reserved_middle": 492,
    "learned_age_ns": 496,
    "reserved_end": 504,
})


class Row(c.Structure):
    """64 bytes: one cache line, the unit of `context` and `features` payloads, whose sections are cast from it."""

    _align_ = 64  # of Python 3.13 on; topics are aligned all the same
    _fields_ = [
        ("values", c.c_float * 16),  # The bytes, as numbers of single precision.
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
        ("present", c.c_uint32),  # Bit k is set where the agent has a state at history step k.
        ("length_m", c.c_float),  # Length where known, else 0; sets the rear axle of the bicycle.
        ("state", c.c_float * 6 * 8),  # State features s, scaled as the model wants them; zero rows where absent.
        ("node", c.c_float * 64 * 8),  # Node attributes v = [SE ‖ CE]; zero rows where absent.
        ("turn", c.c_uint32),  # Its turn where a tick has no time for all, from 1 on; 0 where the order of the frame counts.
        ("shed", c.c_uint32),  # 1 where the agent is left out of this tick to save time: it is there for its neighbours alone.
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
        ("present", c.c_uint32),  # Bit k is set where the agent has a state at history step k.
        ("length_m", c.c_float),  # Length where known, else 0.
        ("state", c.c_float * 6 * 8),  # State features s as in `AgentFeatures`: the decoder's burn-in and the base control read them.
        ("temporal", c.c_float * 64),  # The temporal summary ṽ_h.
        ("turn", c.c_uint32),  # Its turn where a tick has no time for all, from 1 on; 0 where the order of the frame counts.
        ("shed", c.c_uint32),  # 1 where the agent is left out of this tick to save time: it is there for its neighbours alone.
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
    """The controls of an agent that is forecast: element of the topic `controls`."""

    _fields_ = [
        ("id", c.c_uint64),  # The track.
        ("agent_type", c.c_uint32),  # `AgentType` as a number.
        ("modes_len", c.c_uint32),  # Valid modes, at most `MODES_MAX`.
        ("probability", c.c_float * 20),  # Probability of each mode; they sum to 1.
        ("modes", ControlGaussian * 12 * 20),  # Controls of each mode and step, before saturation: of a vehicle acceleration and slip rate, else displacements.
        ("best", ControlGaussian * 12),  # Controls of the single best forecast (K = 1).
        ("base", c.c_float * 2 * 12),  # The model's base control for the single best forecast, without what the network adds; zeros where the model has no base.
        ("out_of_distribution", c.c_float),  # How far the history lies outside of what the base control was fitted to, in the width of that; 0 inside, and where the model does not tell.
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


class Forecast(c.Structure):
    """The forecast of an agent: element of the topic `forecasts`. Step k lies (k + 1) Δt after the frame's stamp."""

    _fields_ = [
        ("id", c.c_uint64),  # The track.
        ("source_id", c.c_uint64),  # The detections' own identity where they carry one, else 0.
        ("age_ns", c.c_uint64),  # Time between the stamp of the controls and this frame's stamp; 0 for learned forecasts.
        ("prior_age_ns", c.c_uint64),  # As in `Track.prior_age_ns`.
        ("agent_type", c.c_uint32),  # `AgentType` as a number.
        ("quality", c.c_uint32),  # `Quality` as a number.
        ("cause", c.c_uint32),  # `Cause` as a number: the first one.
        ("causes", c.c_uint32),  # Bits of all causes that apply, see `Cause.bit`; 0 where nothing is wrong.
        ("modes_len", c.c_uint32),  # Valid modes, at most `MODES_MAX`.
        ("prior", c.c_uint32),  # As in `Track.prior`.
        ("steering", c.c_uint32),  # `Steering` as a number.
        ("frame_heading_rad", c.c_float),  # Direction of the axes of displacements: the agent's heading at the stamp of the controls.
        ("x_m", c.c_float),  # Position at the stamp.
        ("y_m", c.c_float),  # Position at the stamp.
        ("vx_mps", c.c_float),  # Velocity at the stamp.
        ("vy_mps", c.c_float),  # Velocity at the stamp.
        ("heading_rad", c.c_float),  # Heading at the stamp.
        ("length_m", c.c_float),  # Extent along the heading; 0 where unknown.
        ("width_m", c.c_float),  # Extent across the heading; 0 where unknown.
        ("out_of_distribution", c.c_float),  # How far the agent's history lies outside of what the model was trained on, in the width of that; 0 inside, and where it is not told.
        ("expert_weights", c.c_float * 8),  # Weight of each `Expert` by its number: network, base, constant velocity, decaying turn, process model, decaying acceleration; zeros where they are not told.
        ("probability", c.c_float * 20),  # Probability of each mode; they sum to 1.
        ("mode_expert", c.c_uint8 * 20),  # `Expert` of each mode as a number.
        ("lanes", c.c_uint32),  # 1 if the forecast was taken along lanes of the map, 2 if a vehicle moves on no lane of it; 0 without a map, for all other agents, and if it is not reported.
        ("reserved", c.c_uint8 * 72),  # Zero.
        ("covariance", c.c_float * 3 * 12),  # Covariance of the mixture of all modes as (xx, xy, yy), m².
        ("best", c.c_float * 2 * 12),  # The single best forecast (K = 1).
        ("mean", c.c_float * 2 * 12),  # Mean of the mixture of all modes.
        ("modes", c.c_float * 2 * 12 * 20),  # Mean positions (x, y) of each mode and step in the world frame, m.
        ("mode_covariance", c.c_float * 3 * 12 * 20),  # Covariance of the position of each mode and step as (xx, xy, yy), m².
        ("controls", ControlGaussian * 12 * 20),  # The controls that lead to `modes`, as they act (after saturation), their first step at the stamp of the controls; zeros where `steering` says that there are none.
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
    "reserved": 232,
    "covariance": 304,
    "best": 448,
    "mean": 544,
    "modes": 640,
    "mode_covariance": 2560,
    "controls": 5440,
    "reserved_end": 10240,
})


class Refusals(c.Structure):
    """Frames of one sender that one reader refused for one cause."""

    _fields_ = [
        ("sender", c.c_uint16),  # The `StageId` of the frames' sender as a number, 0 where it is no stage.
        ("cause", c.c_uint16),  # The `RefusalCause` as a number; 0: the entry is free.
        ("frames_len", c.c_uint32),  # How many frames.
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
        ("incarnation", c.c_uint32),  # How often the stage had been started before.
        ("pid", c.c_uint32),  # Operating system's number of the process.
        ("linked", c.c_uint32),  # 1 once a frame has passed from the stage's input to its output, else 0.
        ("beat", c.c_uint64),  # Counts the stage's heartbeats.
        ("seq", c.c_uint64),  # Number of the newest tick that the stage finished.
        ("frames_len", c.c_uint64),  # Frames finished.
        ("rejected_len", c.c_uint64),  # Frames refused.
        ("dropped_len", c.c_uint32),  # Ticks of which a frame never arrived, by gaps in `seq`.
        ("unanswered_len", c.c_uint32),  # Of these, ticks of which the frame that begins a step never arrived: the stage has sent nothing for them.
        ("sent_ns", c.c_uint64),  # `CLOCK_MONOTONIC` at sending.
        ("refusals", Refusals * 8),  # Frames refused, by their sender and the cause.
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
    Forecast,
    Refusals,
    Heartbeat,
]

# Elements by topic; the service of iceoryx2 is "stgdat/NAME".
TOPICS = {
    "detections": Detection,  # Source → tracker: what the sensor saw.
    "tracks": Track,  # Tracker → localiser, sampler, users: confirmed and coasting tracks.
    "context": ContextRow,  # Localiser → extractor: tracks and their local patches of the context map.
    "features": FeaturesRow,  # Extractor → encoder: node and edge attributes of the history graph.
    "encodings": AgentEncoding,  # Encoder → decoder: the temporal summary of each agent.
    "controls": AgentControls,  # Decoder → sampler: control Gaussians per agent, mode and step.
    "forecasts": Forecast,  # Sampler → tracker, users: trajectories with probabilities and moments.
    "truth": Truth,  # Source → recorder: where the agents really were, for the report's accuracy.
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
