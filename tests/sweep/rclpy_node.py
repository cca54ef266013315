"""A node of a real rclpy, run by the Python of `tools/ros2`: `python rclpy_node.py NAME`.

It has the environment of ROS 2, and none of our packages.
"""

import contextlib
import importlib
import sys
import threading
import time

import rclpy
from line_protocol import obey, tell
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile

WAIT_S = 120.0


def type_of(name):
    package, kind, last = name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), last)


def reported(value):
    """Convert a message to JSON values."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: reported(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return [*value]
    if isinstance(value, str) or not hasattr(value, "__iter__"):
        return value
    return [reported(each) for each in value]


def filled(message, fields):
    for name, value in fields.items():
        if isinstance(value, dict):
            filled(getattr(message, name), value)
        else:
            setattr(message, name, value)
    return message


class Judge:
    def __init__(self, name):
        self.node = rclpy.create_node(name)
        self.publishers, self.clients, self.subscriptions = {}, {}, {}

    def subscribe(self, topic, kind, latched=False):
        quality = QoSProfile(depth=10)
        if latched:
            quality.durability = DurabilityPolicy.TRANSIENT_LOCAL
        self.subscriptions[topic] = self.node.create_subscription(
            type_of(kind),
            topic,
            lambda message: tell("sample", topic=topic, message=reported(message)),
            quality,
        )

    def unsubscribe(self, topic):
        self.node.destroy_subscription(self.subscriptions.pop(topic))

    def advertise(self, topic, kind):
        publisher = self.publishers[topic] = self.node.create_publisher(type_of(kind), topic, 10)
        end_s = time.monotonic() + WAIT_S
        while not publisher.get_subscription_count():
            if time.monotonic() > end_s:
                raise TimeoutError(f"nobody subscribes to {topic}")
            time.sleep(0.005)
        tell("matched", topic=topic)

    def publish(self, topic, message, period_s=None):
        """Publish once, or periodically."""
        publisher = self.publishers[topic]
        message = filled(publisher.msg_type(), message)
        if period_s is None:
            publisher.publish(message)
        else:
            self.node.create_timer(period_s, lambda: publisher.publish(message))

    def graph(self):
        topics = dict(self.node.get_topic_names_and_types())
        tell(
            "graph",
            nodes=[f"{space.rstrip('/')}/{name}" for name, space in
                   self.node.get_node_names_and_namespaces()],
            topics=topics,
            services=dict(self.node.get_service_names_and_types()),
            hashes={name: self._hashes(name) for name in topics},
        )  # fmt: skip

    def _hashes(self, topic):
        endpoints = (
            *self.node.get_publishers_info_by_topic(topic),
            *self.node.get_subscriptions_info_by_topic(topic),
        )
        return {each.node_name: str(each.topic_type_hash) for each in endpoints}

    def call(self, service, kind, request, wait_s):
        client = self.node.create_client(type_of(kind), service)
        if not client.wait_for_service(wait_s):
            tell("answer", service=service, message=None)
            return
        future = client.call_async(filled(type_of(kind).Request(), request))
        future.add_done_callback(
            lambda done: tell("answer", service=service, message=reported(done.result()))
        )


def spin(executor):
    with contextlib.suppress(ExternalShutdownException):
        executor.spin()


def main(name):
    rclpy.init()
    judge = Judge(name)
    executor = SingleThreadedExecutor()
    executor.add_node(judge.node)
    spinning = threading.Thread(target=spin, args=(executor,))
    spinning.start()
    tell("ready", middleware=rclpy.get_rmw_implementation_identifier())
    try:
        obey(judge)
    finally:
        rclpy.shutdown()  # ends the spinning
        spinning.join()


if __name__ == "__main__":
    main(*sys.argv[1:])
