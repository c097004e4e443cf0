"""The named numbers in arrays. A test compares them with the wire."""

from enum import IntEnum, IntFlag


class AgentType(IntEnum):
    """The type of an agent."""

    VEHICLE = 0
    CYCLIST = 1
    PEDESTRIAN = 2


class TrackStatus(IntEnum):
    """Whether a track was detected in the newest frame that could contain it."""

    CONFIRMED = 0
    COASTING = 1


class Quality(IntEnum):
    """The origin of a forecast: the network, the network at an earlier tick, or constant control."""

    LEARNED = 0
    HELD = 1
    KINEMATIC = 2


class Cause(IntEnum):
    """Why a forecast is not `Quality.LEARNED`."""

    NONE = 0
    LATE = 1
    REJECTED = 2
    MISSING = 3
    YOUNG = 4
    OUTDONE = 5
    SHED = 6


class Expert(IntEnum):
    """The origin of a mode. Numbers below 8 are columns of `Forecasts.evidence`."""

    NETWORK = 0
    BASE = 1
    CONSTANT_VELOCITY = 2
    DECAYING_TURN = 3
    PROCESS_MODEL = 4
    DECAYING_ACCELERATION = 5
    FOLLOWING = 6
    LANE = 7
    FAN = 254
    RETRIEVAL = 255

    def name_for(self, agent_type: AgentType) -> str:
        """The name for agents of a type, as in JSON lines. Pedestrians have other experts in two slots."""
        if agent_type == AgentType.PEDESTRIAN and self in (Expert.FOLLOWING, Expert.LANE):
            return "standing" if self == Expert.FOLLOWING else "mean velocity"
        return self.name.lower().replace("_", " ")


class DetectionFlags(IntFlag):
    """The fields of a detection that are valid."""

    HAS_ID = 1
    HAS_HEADING = 2
    HAS_SPEED = 4
    HAS_SIZE = 8
