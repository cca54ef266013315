"""dora-rs 1.1 as the judge of a sweep: `python -m tests.sweep.dora_judge [CONFIG] < PLAN`.

With a CONFIG file over Zenoh, without one over DDS. Source: Ros2Context. AMENT_PREFIX_PATH names
the folder of the interfaces, ROS_DOMAIN_ID the domain.
"""

import json
import os
import sys
import time
import warnings
from contextlib import contextmanager

warnings.filterwarnings("ignore", message="dora-rs ROS2 Bridge")

import dora  # noqa: E402
import pyarrow as pa  # noqa: E402

from cardan.bus.dds_options import DdsOptions  # noqa: E402
from cardan.protocols.ros2.interfaces import DUMMY_MEMBER, message_type  # noqa: E402
from cardan.protocols.ros2.messages import completed  # noqa: E402
from cardan_dds.network import DdsNetwork  # noqa: E402
from cardan_dds.wire import RUST_DDS  # noqa: E402
from tests.sweep.plan import RESULT, command  # noqa: E402
from tests.waiting import until  # noqa: E402

TIMEOUT_S = 120.0


def short(type_name):
    """Type name in dora's form."""
    package, _, name = type_name.split("/")
    return f"{package}/{name}"


PRIMITIVES = {"char": "uint8", "byte": "uint8", "bool": "bool_", "string": "string"}


def arrow(type_name):
    """pyarrow type of a message."""
    fields = [each for each in message_type(type_name).fields if each.name != DUMMY_MEMBER]
    return pa.struct([(each.name, _field(each)) for each in fields])


def _field(field):
    if field.nested:
        base = arrow(field.base)
    else:
        base = getattr(pa, PRIMITIVES.get(field.base, field.base))()
    return pa.list_(base) if field.array else base


def array(type_name, given):
    """A message in the form that dora takes."""
    return pa.array([_plain(completed(type_name, given))], arrow(type_name))


def _plain(message):
    """Convert bytes to lists of numbers."""
    if isinstance(message, dict):
        return {key: _plain(value) for key, value in message.items()}
    return [*message] if isinstance(message, (bytes, bytearray)) else message


@contextmanager
def announcing(dds):
    """Yield a function that waits until other nodes have discovered a subscription; over Zenoh no
    wait is needed.

    RustDDS 0.14.3 has room for 64 commands to its discovery thread, and uses two of them for each
    subscription. It drops commands that find no room (`discovery_command.try_send`, dds/pubsub.rs)
    and never announces these subscriptions: of 33 made at once on one busy core, Cyclone DDS
    discovered 19 to 29, and the heartbeats of RustDDS's own DCPSSubscription ended with those.
    """
    if not dds:
        yield lambda _name: None
        return
    with DdsNetwork(DdsOptions(), "watches") as watching:

        def announced(name):
            def known():
                return any(each.vendor == RUST_DDS for each in watching.others(name)[1])

            until(known, f"RustDDS telling of {name}")

        yield announced


def main(config=""):
    plan = json.load(sys.stdin)
    zenoh = dora.Ros2Transport.zenoh
    context = dora.Ros2Context(
        transport=zenoh("rep2016", config) if config else dora.Ros2Transport.dds(),
        domain_id=int(os.environ.get("ROS_DOMAIN_ID", "0")),
    )
    node = context.new_node("dora", "/", dora.Ros2NodeOptions(rosout=False))
    qos = dora.Ros2QosPolicies(reliable=True, keep_last=10)
    latched = dora.Ros2QosPolicies(
        durability=dora.Ros2Durability.TransientLocal, reliable=True, keep_last=1
    )
    # dora finds only servers that have the same queue depth as its client; ROS 2's parameter
    # services have 1000.
    deep = dora.Ros2QosPolicies(reliable=True, keep_last=1000)

    def subscribe(name, type_name):
        retained = ("_static", "_description", "/configuration", "/scene")
        quality = latched if name.endswith(retained) else qos
        topic = node.create_topic(name, short(type_name), quality)
        subscription = node.create_subscription(topic, quality)
        announced(name)
        return subscription

    def taken(subscription):
        return [each.to_pylist()[0] for each in iter(subscription.next, None)]

    with announcing(dds=not config) as announced:
        hearing = {name: subscribe(name, type_name) for name, type_name in plan["hear"]}
        results = subscribe(RESULT, "cardan_msgs/msg/CommandResult")
    reported = {"commands": {}, "services": {}, "actions": {}, "heard": {}}
    for each in plan["commands"]:
        topic, type_name, message, _verb, _tag = each
        publisher = node.create_publisher(node.create_topic(topic, short(type_name), qos), qos)
        sent = array(type_name, message)
        reported["commands"][topic] = command(
            each,
            lambda publisher=publisher, sent=sent: publisher.publish(sent),
            lambda: taken(results),
            time.monotonic() + TIMEOUT_S,
        )
    for name, type_name, request in plan["services"]:
        depth = deep if "parameter" in name or "type_description" in name else qos
        client = node.create_service_client(name, short(type_name), depth)
        asked = array(f"{type_name}_Request", request)
        try:
            reported["services"][name] = client.call(asked, TIMEOUT_S).to_pylist()[0]
        except Exception as error:
            reported["services"][name] = None
            print(name, error, file=sys.stderr)
    for name, type_name, goal in plan["actions"]:
        client = node.create_action_client(name, short(type_name), qos)
        asked = array(f"{type_name}_Goal", goal)
        try:
            _status, result = client.take_result(client.send_goal(asked, TIMEOUT_S), TIMEOUT_S)
            reported["actions"][name] = result.to_pylist()[0]
        except Exception as error:
            reported["actions"][name] = None
            print(name, error, file=sys.stderr)
    print("HEARING", flush=True)
    until_s = time.monotonic() + TIMEOUT_S
    while time.monotonic() < until_s and len(reported["heard"]) < len(hearing):
        for name, subscription in hearing.items():
            if name not in reported["heard"] and subscription.next() is not None:
                reported["heard"][name] = True
        time.sleep(0.005)
    print(json.dumps(reported, default=str), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
