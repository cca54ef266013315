"""Process that subscribes to the topics of sessions and reads nothing: ``python -m`` this module
with the endpoints as a JSON list. It prints READY and ends at the end of its standard input."""

from __future__ import annotations

import contextlib
import json
import sys
import time
from collections.abc import Sequence

import zenoh

from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.gateway.bus.options import DEFAULT_NAME
from cardan.gateway.bus.record_topics import CONTROLLER_LOG_TOPIC
from cardan.protocols.ros2.zenoh import DEFAULT_QOS

JOIN_WITHIN_S = 20.0
"""Startup timeout: a small computer that starts several programs at once needs seconds for each."""

MATCH_S = 1.0
"""Time until a session has noticed its subscribers."""


def listen(endpoints: Sequence[str]) -> None:
    """Subscribe to all topics except those for recorders."""
    with contextlib.ExitStack() as stack:
        retained = []
        for endpoint in endpoints:
            options = BusOptions(router=endpoint)
            network = stack.enter_context(BusNetwork(options, "bench_listener"))
            if not network.wait_for_service(f"/{DEFAULT_NAME}/stat", JOIN_WITHIN_S):
                raise RuntimeError(f"there is no session at {endpoint}")
            for topic, known in network.topics().items():
                if known.publishers and not _for_recorders(topic):
                    # Zenoh's own threads receive the messages and keep the newest.
                    ring = zenoh.handlers.RingChannel(1)
                    key = f"{options.domain}{topic}/**"
                    retained.append(network.node.declare_subscriber(key, ring, DEFAULT_QOS))
        time.sleep(MATCH_S)
        print("READY", flush=True)
        sys.stdin.read()


def _for_recorders(topic: str) -> bool:
    return "/raw/" in topic or topic.endswith(CONTROLLER_LOG_TOPIC[1:])


if __name__ == "__main__":
    listen(json.loads(sys.argv[1]))
