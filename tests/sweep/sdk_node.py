"""zenoh-ros2-sdk, run by the Python of `tools/ros2`: `python sdk_node.py PORT DEFINITIONS`.

It connects to a session at that port. Definitions come from a folder, or by git from the internet.
"""

import dataclasses
import sys
import threading
import time

import numpy
import zenoh_ros2_sdk
from line_protocol import obey, tell
from zenoh_ros2_sdk.qos import QosDurability, QosProfile

ROUTER = {"router_ip": "127.0.0.1", "router_port": int(sys.argv[1]), "domain_id": 0}
NAME = 2  # Nodetype.NAME of rosbags: a nested message
OCTETS = {"byte": "uint8", "octet": "uint8", "char": "uint8"}
LATCHED = QosProfile(durability=QosDurability.TRANSIENT_LOCAL)


def reported(value):
    """Convert a message to JSON values."""
    if dataclasses.is_dataclass(value):
        names = [each.name for each in dataclasses.fields(value) if each.name != "__msgtype__"]
        return {name: reported(getattr(value, name)) for name in names}
    if isinstance(value, numpy.ndarray):
        return value.tolist()
    return [reported(each) for each in value] if isinstance(value, list) else value


def fields_of(store, kind, fields):
    """Convert JSON values to the values of a message's fields."""
    return {
        name: _value(store, store.fielddefs[kind][1], name, given) for name, given in fields.items()
    }


def _value(store, definitions, name, given):
    (inner,) = [form[1] for field, form in definitions if field == name]
    if isinstance(given, dict):
        return _message(store, inner, given)
    if isinstance(given, list):
        element, of = int(inner[0][0]), inner[0][1]
        if element == NAME:
            return [_message(store, of, each) for each in given]
        if of[0] != "string":
            return numpy.array(given, dtype=OCTETS.get(of[0], of[0]))
    return given


def _message(store, kind, fields):
    return store.types[kind](**fields_of(store, kind, fields))


class Judge:
    def __init__(self):
        self.publishers, self.subscriptions = {}, {}

    def subscribe(self, topic, kind, latched=False):
        self.subscriptions[topic] = zenoh_ros2_sdk.ROS2Subscriber(
            topic, kind, lambda message: tell("sample", topic=topic, message=reported(message)),
            node_name="judge", qos=LATCHED if latched else None, **ROUTER,
        )  # fmt: skip

    def unsubscribe(self, topic):
        self.subscriptions.pop(topic).close()

    def advertise(self, topic, kind):
        made = zenoh_ros2_sdk.ROS2Publisher(topic, kind, node_name="judge", **ROUTER)
        self.publishers[topic] = made, kind
        tell("matched", topic=topic)

    def publish(self, topic, message, period_s=None):
        """Publish once, or periodically."""
        publisher, kind = self.publishers[topic]
        fields = fields_of(publisher.session_mgr.store, kind, message)
        publisher.publish(**fields)
        if period_s is not None:
            threading.Thread(target=self._repeat, args=(publisher, fields, period_s)).start()

    def _repeat(self, publisher, fields, period_s):
        while True:
            time.sleep(period_s)
            publisher.publish(**fields)

    def call(self, service, kind, request, wait_s):
        client = zenoh_ros2_sdk.ROS2ServiceClient(
            service, kind, node_name="judge", timeout=wait_s, **ROUTER
        )
        store = client.session_mgr.store
        reply = client.call(**fields_of(store, client.request_store_type, request))
        tell("answer", service=service, message=reported(reply))


if __name__ == "__main__":
    zenoh_ros2_sdk.get_registry(sys.argv[2])
    tell("ready", middleware="zenoh")
    obey(Judge())
    zenoh_ros2_sdk.ZenohSession.get_instance().close()
