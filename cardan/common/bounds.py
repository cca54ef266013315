"""Allowed ranges of numbers and forms of texts in a configuration, with physical reasons.

A range is part of the annotation of its field, ``Annotated[float, LINEAR_SPEED_M_S]``, and nowhere
else; :class:`cardan.common.options.Options` reads it there. A number outside is an error, and could
overflow in a later computation.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Annotated


@dataclass(frozen=True)
class Range:
    """Range from `lowest` to `highest`, both allowed unless `above` or `below` is set."""

    lowest: float
    highest: float
    unit: str
    reason: str
    """Physical reason for the upper limit, and if it matters, for the lower one."""
    above: bool = False
    """True if `lowest` itself is not allowed."""
    below: bool = False
    """True if `highest` itself is not allowed."""
    zero: str = ""
    """Special meaning of 0; empty: none."""

    def __contains__(self, value: object) -> bool:
        """Return whether a value is a number in the range; never for NaN, a bool, or a text."""
        if not isinstance(value, (int, float)) or isinstance(value, bool):
            return False
        high_enough = value > self.lowest if self.above else value >= self.lowest
        return high_enough and (value < self.highest if self.below else value <= self.highest)

    def __str__(self) -> str:
        low, high = (
            f"{end:.10g}" if float(end).is_integer() else f"{end:.5g}"
            for end in (self.lowest, self.highest)
        )
        unit = f" {self.unit}" if self.unit else ""
        if self.zero:
            low += f" ({self.zero})"
        if math.isinf(self.highest):
            return f"above {low}{unit}" if self.above else f"{low}{unit} or more"
        if self.above:
            return f"above {low}, {'below' if self.below else 'at most'} {high}{unit}"
        return f"{low} to {'below ' if self.below else ''}{high}{unit}"


@dataclass(frozen=True)
class Text:
    """A text of a certain form, for ``Annotated[str, HOST]``."""

    pattern: str
    """Regular expression of the whole text."""
    words: str
    """Description of the allowed texts, for messages."""
    most_bytes: int = 0
    """Largest size in UTF-8; 0: unlimited."""

    def __contains__(self, value: object) -> bool:
        return (
            isinstance(value, str)
            and re.fullmatch(self.pattern, value) is not None
            and len(value.encode(errors="surrogatepass")) <= (self.most_bytes or math.inf)
        )

    def __str__(self) -> str:
        return self.words


@dataclass(frozen=True)
class Host(Text):
    """The address or the name of one computer, for ``Annotated[str, HOST]``."""

    listens: bool = False
    """True for an address to listen on: it may stand for all addresses of this computer
    (0.0.0.0)."""

    def __contains__(self, value: object) -> bool:
        if not super().__contains__(value):
            return False
        if _DOTTED.fullmatch(str(value)) and re.fullmatch(_IPV4, str(value)) is None:
            return False  # No name is of numbers alone: an address with one that is too large.
        if str(value).count(":") == 1 or "]:" in str(value):
            return False  # A port; addresses of IPv6 have two colons or more.
        kind = shared_address(str(value))
        return not kind or (self.listens and kind == _ALL_OWN)


_DOTTED = re.compile(r"[0-9]+(\.[0-9]+){3}")
_ALL_OWN = "a wildcard address"


def shared_address(host: str) -> str:
    """Return the kind of a `host` address that is not one computer alone; empty if it may be one,
    and for a name. A network's own broadcast address is not recognizable (`cardan.common.sockets`
    queries the system)."""
    import ipaddress
    import socket

    try:
        address: ipaddress.IPv4Address | ipaddress.IPv6Address
        try:
            # Systems take short forms, too: "0" for 0.0.0.0, "224.1" for 224.0.0.1.
            address = ipaddress.IPv4Address(socket.inet_aton(host))
        except OSError:
            address = ipaddress.ip_address(host.strip("[]"))
    except ValueError:
        return ""
    address = getattr(address, "ipv4_mapped", None) or address
    if address.is_unspecified:
        return _ALL_OWN
    if address.is_multicast:
        return "a multicast address"
    return "a broadcast address" if str(address) == _BROADCAST else ""


_BROADCAST = "255.255.255.255"


@dataclass(frozen=True)
class Located:
    """A text that may be a path, for ``Annotated[str, FILE]``: in a configuration file it is
    relative to that file (:func:`cardan.common.tables.resolved`)."""

    pattern: str = "(?P<path>.+)"
    """Regular expression of texts that are paths, with the group `path`."""
    is_read: bool = True
    """True if the file must exist."""
    is_met: bool = False
    """True for a path shared with another program, whose command line names it: relative to the
    working folder."""


@dataclass(frozen=True)
class Directed:
    """A vector that is not zero, for ``Annotated[tuple[...], Directed()]``."""

    shortest: float = 1e-9
    """Longest vector that counts as zero, because rounding leaves it no direction."""

    def __contains__(self, value: object) -> bool:
        return isinstance(value, (tuple, list)) and math.hypot(*value) > self.shortest

    def __str__(self) -> str:
        return "a vector that has a direction"


# -- speeds and accelerations ----------------------------------------------------------------------

_MAX_LINEAR_SPEED_M_S = 5.0
_MAX_LINEAR_ACCELERATION_M_S2 = 50.0
_MAX_ANGULAR_SPEED_RAD_S = 4.0 * math.pi
_MAX_ANGULAR_ACCELERATION_RAD_S2 = 100.0 * math.pi
_MAX_JOINT_SPEED_RAD_S = 8.0 * math.pi

_TCP_FAST = "no serial arm's TCP is faster, and slower is standstill"
_TCP_QUICK = "five times gravity: no serial arm's TCP speeds up or brakes faster"
_TURNS_FAST = "two turns in a second: no hand turns a tool faster"
_TURNS_QUICK = "to two turns in a second within 40 ms; no serial arm's wrist is quicker"
_JOINT_FAST = "four turns in a second: the fastest wrists have three"

LINEAR_SPEED_M_S = Range(1e-4, _MAX_LINEAR_SPEED_M_S, "m/s", _TCP_FAST)
LINEAR_ACCELERATION_M_S2 = Range(1e-3, _MAX_LINEAR_ACCELERATION_M_S2, "m/s²", _TCP_QUICK)
LINEAR_JERK_M_S3 = Range(
    1e-2, 10_000.0, "m/s³", "full acceleration within 5 ms: practically unlimited jerk"
)
ANGULAR_SPEED_RAD_S = Range(1e-4, _MAX_ANGULAR_SPEED_RAD_S, "rad/s", _TURNS_FAST)
ANGULAR_SPEED_DEG_S = Range(0.01, math.degrees(_MAX_ANGULAR_SPEED_RAD_S), "deg/s", _TURNS_FAST)
ANGULAR_ACCELERATION_RAD_S2 = Range(1e-3, _MAX_ANGULAR_ACCELERATION_RAD_S2, "rad/s²", _TURNS_QUICK)
ANGULAR_ACCELERATION_DEG_S2 = Range(
    0.1, math.degrees(_MAX_ANGULAR_ACCELERATION_RAD_S2), "deg/s²", _TURNS_QUICK
)
ANGULAR_JERK_RAD_S3 = Range(
    1e-2, 63_000.0, "rad/s³", "full acceleration within 5 ms: practically unlimited jerk"
)
JOINT_SPEED_RAD_S = Range(1e-4, _MAX_JOINT_SPEED_RAD_S, "rad/s or m/s", _JOINT_FAST)
JOINT_SPEED_DEG_S = Range(0.01, math.degrees(_MAX_JOINT_SPEED_RAD_S), "deg/s", _JOINT_FAST)
JOINT_ACCELERATION_RAD_S2 = Range(
    1e-3, _MAX_ANGULAR_ACCELERATION_RAD_S2, "rad/s² or m/s²", _TURNS_QUICK
)
HAND_SPEED_M_S = Range(
    0.0, 10.0, "m/s", "the speed of a thrown ball, not of a hand that guides", above=True
)
HAND_TURN_RAD_S = Range(0.1, 30.0, "rad/s", "no human wrist turns faster")

# -- lengths, angles, directions -------------------------------------------------------------------

LENGTH_M = Range(0.0, 100.0, "m", "no robot's cell is larger, its tracks included", above=True)
COORDINATE_M = Range(-100.0, 100.0, "m", "no robot's cell is larger, its tracks included")
NEAR_M = Range(-10.0, 10.0, "m", "no arm on a table reaches farther, and no tool is longer")
DESK_M = Range(-1.0, 1.0, "m", "a hand on a desk reaches no farther")
SAFETY_DISTANCE_M = Range(
    0.0, 1.0, "m", "an arm with a larger clearance has no room to work", above=True
)
TCP_TOLERANCE_M = Range(
    0.0,
    1.0,
    "m",
    "a tool a meter off is another tool: workspace limits are wrong then",
    above=True,
)
ARRIVAL_M = Range(
    0.0, 0.1, "m", "an arm a hand's breadth from its goal has not arrived", above=True
)
ARRIVAL_RAD = Range(0.0, 0.5, "rad", "a tool turned by half a radian has not arrived", above=True)
ARRIVAL_JOINT = Range(
    0.0, 0.1, "rad or m", "a meter along the arm that is a hand's breadth", above=True
)
PATH_OFFSET_M = Range(0.0, 1.0, "m", "a path a meter off is another path", above=True)
MAX_LEAD_M = Range(
    0.0, 0.5, "m", "an arm that far from its commanded position does not follow it", above=True
)
MAX_LEAD_RAD = Range(
    0.0, 1.5, "rad", "a tool a quarter turn off its commanded orientation is stuck", above=True
)
ANGLE_DEG = Range(-360.0, 360.0, "deg", "a whole turn changes nothing")
JOINT_ANGLE_DEG = Range(-3600.0, 3600.0, "deg", "no joint with cables turns ten times")
DIRECTION = Range(-1e6, 1e6, "", "only its direction counts")

Length = Annotated[float, LENGTH_M]
Coordinate = Annotated[float, COORDINATE_M]
Angle = Annotated[float, ANGLE_DEG]
Component = Annotated[float, DIRECTION]

Bounds = tuple[Coordinate, Coordinate]
Point = tuple[Coordinate, Coordinate, Coordinate]
Angles = tuple[Angle, Angle, Angle]
Direction = Annotated[tuple[Component, Component, Component], Directed()]

# -- measured and commanded values of a robot: one range for both ----------------------------------

JOINT_POSITION = Range(-2000.0, 2000.0, "rad or m", "250 turns are enough for an endless wrist")
JOINT_VELOCITY = Range(-1000.0, 1000.0, "rad/s or m/s", "no motor turns a joint so fast")
JOINT_TORQUE = Range(-1e5, 1e5, "N·m or N", "the largest joints hold a tonne at four meters")
LINEAR_VELOCITY_M_S = Range(-100.0, 100.0, "m/s", "no arm's TCP is nearly so fast")
ANGULAR_VELOCITY_RAD_S = Range(-1000.0, 1000.0, "rad/s", "no wrist turns so fast")
ROTATION_LENGTH = Range(0.99, 1.01, "", "a quaternion that is a rotation has length 1")

# -- times for which something may go on unseen ----------------------------------------------------

LONGEST_BLIND_S = 0.5
"""Longest time for which motion may continue without fresh data: at 0.25 m/s, the speed beside a
person, an arm moves 12 cm; no person reaches a stop button faster."""

AUTHORITY_LEASE_S = Range(
    0.1,
    10.0,
    "s",
    "longer, an abandoned source blocks the others; shorter, a network pause loses it",
)
BLIND_S = Range(0.0, LONGEST_BLIND_S, "s", "an arm at 0.25 m/s moves 12 cm unobserved", above=True)
NEIGHBOR_AGE_S = Range(
    0.02, LONGEST_BLIND_S, "s", "clock errors of 10 ms and the network's delay are the least age"
)
LOOP_DELAY_S = Range(0.0, 1.0, "s", "a contact that is rendered a second late cannot be held")
ARRIVAL_S = Range(0.1, 60.0, "s", "an arm that has not arrived by then will not arrive")
LAG_S = Range(0.0, 2.0, "s", "an arm with a longer delay cannot be teleoperated")

# -- forces and what goes with them ----------------------------------------------------------------

ROBOT_FORCE_N = Range(0.0, 10_000.0, "N", "the largest arms lift a tonne, no more", above=True)
ROBOT_TORQUE_NM = Range(0.0, 10_000.0, "N·m", "ten kilonewtons on a meter", above=True)
DEADBAND_N = Range(0.0, 10_000.0, "N", "more than the largest arms exert")
FORCE_RATE_S = Range(
    0.0, 1e6, "per s", "the largest force within 10 ms; a faster rise is a step", above=True
)
HAND_FORCE_N = Range(0.0, 100.0, "N", "no hand holds against more for long", above=True)
HAND_STIFFNESS_N_M = Range(
    0.0, 500.0, "N/m", "a stiffer contact oscillates when the device extrapolates it"
)
FIXTURE_STIFFNESS_N_M = Range(
    0.0, 100_000.0, "N/m", "a hand feels no difference to a rigid wall", above=True
)
ENVIRONMENT_STIFFNESS_N_M = Range(
    0.0, 1e7, "N/m", "ten newtons for a micrometer: stiffer than any arm", above=True
)
DAMPING_N_S_M = Range(0.0, 10_000.0, "N·s/m", "nothing moves against more")
DRAG_N_S_M = Range(0.0, 10_000.0, "N·s/m", "nothing moves against more", above=True)
FRICTION = Range(0.0, 2.0, "", "rubber on rubber has less")
FORCE_SCALE = Range(0.0, 10.0, "", "a newton at the robot is ten in the hand", above=True)
FORCE_CUTOFF_HZ = Range(0.1, 200.0, "Hz", "lower is rendered seconds late, higher filters nothing")
PAYLOAD_KG = Range(0.0, 1000.0, "kg", "the largest arms lift a tonne, no more")

# -- shares, factors, counts -----------------------------------------------------------------------

SHARE = Range(0.001, 1.0, "", "of the whole; at less than a thousandth nothing moves")
SHARE_OR_NONE = Range(0.0, 1.0, "", "a share of the whole")
DEAD_ZONE = Range(0.0, 1.0, "", "a dead band of the whole deflection moves nothing", below=True)
MOTION_SCALE = Range(-100.0, 100.0, "", "a millimeter of the device is ten centimeters of the TCP")
OUTPUT_VALUE = Range(-1e9, 1e9, "", "larger whole numbers are not exact in the robot's program")
ANALOG_OUTPUT = Range(0, 39, "", "EGM carries 40 values")
COUNTS = Range(1.0, 1e6, "counts", "no device's raw numbers are larger")
SEED = Range(0, 2**32 - 1, "", "32 bits")
NOT_NEGATIVE = Range(0.0, math.inf, "", "", below=True)
POSITIVE = Range(0.0, math.inf, "", "", above=True, below=True)
STARTS = Range(1, 1000, "starts", "a process that failed that often will not recover")
NOISE_COUNTS = Range(0, 1_000_000, "counts", "no device's raw numbers are larger")

# -- addresses and names ---------------------------------------------------------------------------

_BYTE = "(25[0-5]|2[0-4][0-9]|1[0-9][0-9]|[1-9]?[0-9])"
_SOCKET_PATH_BYTES = 107
"""Longest path in the address of a Unix socket, bytes."""

PORT = Range(1, 65535, "", "ports have 16 bits")
ANY_PORT = Range(0, 65535, "", "ports have 16 bits", zero="any free one")
HOP_LIMIT = Range(0, 255, "", "it has 8 bits", zero="this computer")
_ONE = "of one computer, without a port: no multicast, broadcast or wildcard address"
_OWN = "of this computer, without a port: no multicast or broadcast address"
_NAME = r"[^\s\x00-\x1f\x7f]+"
_NAME_OR_IPV4 = r"[^\s:\x00-\x1f\x7f]+"
HOST = Host(_NAME, f"the address or the name {_ONE}")
HOST_OR_IPV4 = Host(_NAME_OR_IPV4, f"the IPv4 address or the name {_ONE}")
LISTEN_HOST = Host(_NAME, f"the address or the name {_OWN}", listens=True)
LISTEN_HOST_OR_IPV4 = Host(_NAME_OR_IPV4, f"the IPv4 address or the name {_OWN}", listens=True)
_IPV4 = rf"{_BYTE}(\.{_BYTE}){{3}}"
IPV4 = Host(_IPV4, f"an IPv4 address, as 127.0.0.1, {_OWN}", listens=True)
FILE = Located()
PATH = Located(is_read=False)
"""Path of a file or a socket that need not exist when the configuration is read."""
MEETING = Located(is_read=False, is_met=True)
"""Path of a Unix socket on another program's command line."""
ARM_FILE = Located(r"(?i)(?![a-z_]\w*:)(?P<path>.+\.(toml|urdf|xacro))")
"""Name of an arm, PACKAGE:FILE, or a path."""
DDS_CONFIG = Located(r"file://(?P<path>.+)")
SOCKET_PATH = Text(r"[^\0]+", f"a path of up to {_SOCKET_PATH_BYTES} bytes", _SOCKET_PATH_BYTES)
