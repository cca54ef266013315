"""A remote device's motion at its own spacing, from states that arrive as they may."""

import math
import random
from typing import NamedTuple

import pytest

from cardan.drivers.remote import RemoteOptions
from cardan.drivers.remote.playout import Motion, Playout
from cardan.drivers.remote.shared import CLAIM_PERIOD_S
from cardan.errors import OptionError
from cardan.types import IDENTITY, NEUTRAL, Axes, DeviceLink, Pose, Vector3
from tests.drivers.remote_rig import STEP_S, Bench, Link, Way

PERIOD_S = 0.008
"""Between the reports of a SpaceMouse."""
FINE_S = 0.0005
"""Step of the virtual time in which a network's states are played."""
OFFSET_S = 1000.0
MAX_AGE_S = 0.3


class Network(NamedTuple):
    """A network, and the playout that is tried on it."""

    link: Link
    playout_s: float
    stall_s: float = 0.0
    """Nothing arrives for so long, then all of it ..."""
    stalls_every_s: float = math.inf
    """... so often."""
    drift: float = 1e-4
    stamp_noise_s: float = 0.0


WIFI = Network(Link(0.0, 0.013, loss=0.01), 0.03)  # 5 ± 8 ms: none is quicker than 0.
LTE = Network(Link(0.025, 0.04, loss=0.01), 0.06)
NETWORKS = {
    "wifi": WIFI,
    "lte": LTE,
    "bursts": WIFI._replace(playout_s=0.1, stall_s=0.08, stalls_every_s=1.0),
    "stalls": LTE._replace(stall_s=0.5, stalls_every_s=5.0),
    "twice": WIFI._replace(link=WIFI.link._replace(twice=0.2)),
    "reordered": WIFI._replace(link=WIFI.link._replace(in_order=False)),
}


class Played(NamedTuple):
    """What came of it, after the first second: s."""

    arrived_error: list
    """Of the spacing of states on arrival against that of their stamps, absolute."""
    played_error: list
    """The same of what was played."""
    added: list
    """From arrival to play."""
    ages: list
    """Of what was shown, each step."""


def played(network, seconds=20.0, seed=1, period_s=PERIOD_S, x=lambda t: 0.5):
    """Play what a hand that is never at rest sends."""
    way = Way(network.link, random.Random(seed))
    playout = Playout(network.playout_s, MAX_AGE_S)
    arrived, shown = {}, {}
    ages = []
    newest = sent = -1
    next_stall_s = network.stalls_every_s
    for step in range(round(seconds / FINE_S)):
        now_s = step * FINE_S
        if now_s >= next_stall_s:
            next_stall_s += network.stalls_every_s
            way.stall(now_s + network.stall_s)
        if now_s >= (sent + 1) * period_s - 1e-9:
            sent += 1
            way.send(sent, now_s)
        for number in way.arrived(now_s):
            if number <= newest:
                continue  # As the core does with what comes twice or late.
            newest = number
            made_s = number * period_s
            there_s = OFFSET_S + made_s * (1.0 + network.drift)
            axes = NEUTRAL._replace(x=x(made_s))
            arrived[number] = now_s
            playout.heard(there_s, now_s)
            playout.take(Motion(there_s, made_s, made_s, axes), now_s, at_once=False)
        playout.advance(now_s)
        if playout.shown is not None:
            made_s = playout.shown.made_s
            shown.setdefault(round(made_s / period_s), now_s)
            if now_s > 1.0:
                ages.append(now_s - made_s)

    def errors(at_s):
        numbers = [each for each in sorted(at_s) if each * period_s > 1.0]
        return [
            abs(at_s[b] - at_s[a] - (b - a) * period_s)
            for a, b in zip(numbers, numbers[1:], strict=False)
        ]

    added = [shown[n] - arrived[n] for n in shown if n * period_s > 1.0]
    return Played(errors(arrived), errors(shown), added, ages)


def quantile(values, share):
    return sorted(values)[math.ceil(share * len(values)) - 1]


@pytest.mark.parametrize("name", NETWORKS)
def test_motion_has_its_own_spacing_and_waits_no_longer_than_allowed(name):
    network = NETWORKS[name]
    found = played(network)
    ratio = quantile(found.played_error, 0.95) / quantile(found.arrived_error, 0.95)
    assert ratio <= 0.25, f"{ratio:.2f}"
    assert max(found.added) <= network.playout_s + FINE_S
