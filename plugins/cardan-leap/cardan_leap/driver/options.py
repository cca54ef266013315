"""Options of the Leap Motion driver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cardan.common import bounds
from cardan.common.options import Options
from cardan_leap.protocol import PORT

HIGHEST_VERSION = 7
"""Protocol versions; some bridges of newer tracking software offer one more, with the same
frames."""

VERSION = bounds.Range(1, HIGHEST_VERSION, "", "there are no later frames of this form")
MIN_VISIBLE_S = bounds.Range(0.0, 10.0, "s", "an operator would take it for broken")
CUTOFF_HZ = bounds.Range(0.0, 1000.0, "Hz", "above the frame rate it filters nothing", zero="none")
CUTOFF_RISE_1_M = bounds.Range(
    0.0, 1000.0, "Hz per m/s", "above it not even slow motion would be filtered"
)


@dataclass(frozen=True, kw_only=True)
class LeapOptions(Options):
    """Options of :class:`Leap`. Raises OptionError for a value that is not allowed."""

    host: Annotated[str, bounds.HOST] = "127.0.0.1"
    """Host of the tracking service."""
    port: Annotated[int, bounds.PORT] = PORT
    """Its WebSocket port."""
    version: Annotated[int, VERSION] = 6
    """Protocol version to request, 1 to 7; lower ones are tried if the service does not know it."""
    hand: Literal["first", "left", "right"] = "first"
    """The hand that counts; first: the hand that has been in view longest."""
    clutch: Literal["still", "open", "grab", "pinch"] = "still"
    """Posture that holds the button "clutch": a hand kept still once, until it leaves; an open hand
    kept still, until it closes; a fist; a pinch."""
    min_confidence: Annotated[float, bounds.SHARE_OR_NONE] = 0.3
    """Lowest confidence, 0 to 1, of a hand's measurement that is used."""
    min_visible_s: Annotated[float, MIN_VISIBLE_S] = 0.2
    """Time that a hand must have been in view before it counts, s."""
    cutoff_hz: Annotated[float, CUTOFF_HZ] = 4.0
    """Cut-off of the low-pass filter on the pose while the hand rests, Hz; 0: no filter."""
    cutoff_rise_1_m: Annotated[float, CUTOFF_RISE_1_M] = 20.0
    """Rise of the cut-off with the hand's speed, Hz per m/s (1 Euro filter)."""
    max_speed_m_s: Annotated[float, bounds.HAND_SPEED_M_S] = 1.5
    """The pose follows the hand no faster than this, m/s."""
    optimize_hmd: bool = False
    """True: the tracker is worn on the forehead, looking forward."""
    wait_for_device: bool = False
    """open() succeeds without the service, which is used once it runs."""
