"""The codes of the interface: up to four ASCII characters in an integer, first one lowest."""

from __future__ import annotations

import enum


def vocab(text: str) -> int:
    """The integer of a code of one to four ASCII characters. Raises ValueError for others."""
    data = text.encode("ascii", "strict")
    if not 1 <= len(data) <= 4:
        raise ValueError(f"a code has one to four characters, not {text!r}")
    return int.from_bytes(data, "little")


def vocab_text(code: int) -> str:
    """The characters of a code. Raises ValueError for an integer that is none."""
    if not 0 < code < 1 << 32:
        raise ValueError(f"{code} is not a code: it has one to four characters")
    return code.to_bytes(4, "little").rstrip(b"\0").decode("ascii", "strict")


class Generic(enum.IntEnum):
    """Codes that answer or introduce others."""

    OK = vocab("ok")
    FAIL = vocab("fail")
    SET = vocab("set")
    GET = vocab("get")


class Stream(enum.IntEnum):
    """Streaming commands; values of the parameter cpsc."""

    NONE = vocab("nset")
    """No streaming command is chosen."""
    POSE = vocab("pose")
    TWIST = vocab("twst")
    WRENCH = vocab("wrnc")
    JOINT = vocab("jnts")
    """Extension of Cardan: speeds of single joints."""


class Begins(enum.Enum):
    """Treatment of a streamed command that chooses its preset by itself while no streaming command
    is chosen. The values are the reasons for refusing it."""

    NEW = ""
    """The command chooses: its stream has just begun."""
    GOING_ON = (
        "the stream was ended, and does not begin again by itself: let it be silent for 0.5 s, or "
        "send zero, first"
    )
    """The command chooses only if its own stream fell silent: a stopped stream stays stopped, and
    another sender's is not continued."""
    REST = "zero begins no stream; the first command that moves the arm does"


class State(enum.IntEnum):
    """State of the controller."""

    NOT_CONTROLLING = vocab("ccnc")
    """At rest, stopping, or streaming."""
    MOVJ = vocab("ccjc")
    MOVL = vocab("cclc")
    MOVV = vocab("ccvc")
    GRAVITY = vocab("ccgc")
    FORCE = vocab("ccfc")


class Action(enum.IntEnum):
    """Commands of a gripper."""

    NONE = vocab("acn")
    CLOSE = vocab("accg")
    OPEN = vocab("acog")
    STOP = vocab("acsg")
    GENERIC = vocab("acg")


class FrameCode(enum.IntEnum):
    """Values of the parameter cpf."""

    BASE = vocab("cpfb")
    TCP = vocab("cpft")


class ProfileCode(enum.IntEnum):
    """Values of the parameter cppf: how a line gains and loses speed."""

    TRAPEZOID = vocab("trap")
    JERK = vocab("jerk")


class PolicyCode(enum.IntEnum):
    """Values of the parameter cppo: the policy if the arm cannot follow."""

    PATH = vocab("path")
    REACH = vocab("rech")


class Parameter(enum.IntEnum):
    """Keys of parameters; the last ten are extensions of Cardan."""

    ALL = vocab("prms")
    GAIN = vocab("cpcg")
    TRAJECTORY_DURATION = vocab("cptd")
    TRAJECTORY_SPEED = vocab("cpts")
    TRAJECTORY_ACCELERATION = vocab("cpta")
    CONTROL_PERIOD = vocab("cpcp")
    WAIT_PERIOD = vocab("cpwp")
    FRAME = vocab("cpf")
    STREAM = vocab("cpsc")
    ROTATION_SPEED = vocab("cprs")
    ROTATION_ACCELERATION = vocab("cpra")
    TRAJECTORY_JERK = vocab("cptj")
    ROTATION_JERK = vocab("cprj")
    PROFILE = vocab("cppf")
    POLICY = vocab("cppo")
    STREAM_TIMEOUT = vocab("cpst")
    JOINT_SPEED = vocab("cpjs")
    JOINT_ACCELERATION = vocab("cpja")
    DAMPING = vocab("cpda")
