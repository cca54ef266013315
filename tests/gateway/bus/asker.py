"""Request a motion of an arm on the network, report that, and run until killed.

asker.py ENDPOINT topic|service|remote [peer|client]
asker.py dds/DOMAIN topic|service
"""

import select
import sys
import time
from collections.abc import Callable

from cardan.bus.node import BusNode
from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.gateway.bus.options import DEFAULT_NAME
from cardan.gateway.bus.remote import network_arm
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import default_message
from tests.waiting import until

ARM = f"/{DEFAULT_NAME}"
TWIST = "geometry_msgs/msg/Twist"
SERVICE = "cardan_msgs/srv/MoveTwist"
AGAIN_S = 5.0


def slow_twist():
    message = default_message(TWIST)
    message["linear"]["z"] = -0.02
    return message


def keep_asking(ask: Callable[[], object]) -> None:
    """Request repeatedly until standard input ends: a request that was delayed by a busy session or
    bridge is refused."""
    ask()
    print("asked", flush=True)
    while not select.select([sys.stdin], [], [], AGAIN_S)[0]:
        ask()


def wait_for_the_arm(options):
    with BusNetwork(options, "finder") as network:
        assert network.wait_for_service(f"{ARM}/movv", 10.0)


def ask_on_dds(domain, way):
    from cardan.bus.dds_options import DdsOptions
    from cardan_dds.network import DdsNetwork

    with DdsNetwork(DdsOptions(dds_domain=int(domain)), "asker") as network:
        assert network.wait_for_service(f"{ARM}/movv", 20.0)
        if way == "topic":
            publisher = network.advertise(f"{ARM}/command/movv", TWIST, latched=False)
            until(lambda: publisher.heard, "somebody subscribes")
            data = codec_of(TWIST).encode(slow_twist())
            keep_asking(lambda: publisher.publish(data))
        else:
            data = codec_of(f"{SERVICE}_Request").encode({"xdot": slow_twist()})
            answered = lambda _reply: None  # noqa: E731
            keep_asking(lambda: network.call(f"{ARM}/movv", SERVICE, data, answered, 20.0))


def main(endpoint, way, mode="peer"):
    if endpoint.startswith("dds/"):
        ask_on_dds(endpoint.removeprefix("dds/"), way)
        return
    options = BusOptions(router=endpoint, mode=mode)
    if way == "remote":
        arm = network_arm(options=options)
        arm.open()
        arm.movv([0.0, 0.0, -0.02, 0.0, 0.0, 0.0])
        print("asked", flush=True)
        sys.stdin.read()
    wait_for_the_arm(options)
    with BusNode(options, "asker") as node:
        if way == "topic":
            publisher = node.publisher(f"{ARM}/command/movv", TWIST)
            data = codec_of(TWIST).encode(slow_twist())
            keep_asking(lambda: publisher.put(data, time.time_ns()))
        else:
            client = node.client(f"{ARM}/movv", SERVICE)
            data = codec_of(f"{SERVICE}_Request").encode({"xdot": slow_twist()})
            keep_asking(lambda: client.call(data))


if __name__ == "__main__":
    main(*sys.argv[1:])
