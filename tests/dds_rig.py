"""Participants on a DDS domain of this test run alone, on loopback."""

import random

from cardan.bus.dds_options import DdsOptions
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import completed
from cardan_dds.network import DdsNetwork

TIMEOUT_S = 20.0

OPTIONS = DdsOptions(dds_domain=random.SystemRandom().randrange(50, 100))

STRING, TRIGGER = "std_msgs/msg/String", "std_srvs/srv/Trigger"


def encoded(name, /, **fields):
    return codec_of(name).encode(completed(name, fields))


def network(name, **more):
    return DdsNetwork(OPTIONS, name, **more)
