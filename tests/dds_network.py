"""Participants on a DDS domain that only this test run uses, on loopback."""

import random

from cardan.bus.dds_options import DdsOptions
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import completed
from cardan_dds.network import DdsNetwork
from tests.waiting import WITHIN_S

TIMEOUT_S = WITHIN_S

OPTIONS, SESSION_OPTIONS = (
    DdsOptions(dds_domain=each) for each in random.SystemRandom().sample(range(50, 100), 2)
)
"""Two domains. The second one has only a session's server, and participants that its tests
admit."""

STRING, TRIGGER = "std_msgs/msg/String", "std_srvs/srv/Trigger"


def encoded(name, /, **fields):
    return codec_of(name).encode(completed(name, fields))


def network(name, **more):
    return DdsNetwork(OPTIONS, name, **more)
