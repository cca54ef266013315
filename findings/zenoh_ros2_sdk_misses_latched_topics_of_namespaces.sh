#!/bin/sh
# zenoh-ros2-sdk hears a latched topic late only if its name has no second slash.
#
# One would guess: a subscriber with TRANSIENT_LOCAL gets the last message of each publisher that has
# kept one, whatever the topic is called, as one of rmw_zenoh does.
# It is so: /description is heard, /arm/description is not, without a word. rmw_zenoh writes each slash
# of a name as % in its liveliness tokens; the subscriber looks for publishers by a pattern in which
# only the first one is, finds nobody, and asks nobody's cache.
#
# A publisher as rmw_zenoh makes one, and a subscriber that comes later, in one process on loopback.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    "zenoh-ros2-sdk==0.1.8" "eclipse-zenoh==1.10.2"
HOME="$folder" "$folder/venv/bin/python" - <<'PYTHON'
import importlib.metadata
import json
import os
import socket
import sys
import time

import zenoh
import zenoh.ext
from zenoh_ros2_sdk import ROS2Subscriber
from zenoh_ros2_sdk.qos import QosDurability, QosProfile

WAITED_S = 3.0
QOS = QosProfile(durability=QosDurability.TRANSIENT_LOCAL, history_depth=1)
TYPE, DEFINITION = "std_msgs::msg::dds_::String_", "string data\n"
HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
MESSAGE = b"\0\1\0\0\3\0\0\0on\0"

with socket.socket() as free:
    free.bind(("127.0.0.1", 0))
    port = free.getsockname()[1]
config = zenoh.Config()
for key, value in {
    "mode": "router",
    "listen/endpoints": [f"tcp/127.0.0.1:{port}"],
    "scouting/multicast/enabled": False,
    "timestamping/enabled": True,
}.items():
    config.insert_json5(key, json.dumps(value))
session = zenoh.open(config)
kept = []


def latch(number, topic):
    """Publish as rmw_zenoh does: a cache for who comes later, and a token that tells of it."""
    publisher = zenoh.ext.declare_advanced_publisher(
        session,
        f"0{topic}/{TYPE}/{HASH}",
        cache=zenoh.ext.CacheConfig(max_samples=1),
        publisher_detection=True,
    )
    name = topic.replace("/", "%")
    token = session.liveliness().declare_token(
        f"@ros2_lv/0/{session.zid()}/0/{number}/MP/%/%/talker/{name}/{TYPE}/{HASH}/{QOS.encode()}"
    )
    publisher.put(MESSAGE)
    kept.append((publisher, token))


def heard_late(topic):
    heard = []
    subscriber = ROS2Subscriber(
        topic=topic,
        msg_type="std_msgs/msg/String",
        msg_definition=DEFINITION,
        type_hash=HASH,
        callback=lambda message: heard.append(message.data),
        router_ip="127.0.0.1",
        router_port=port,
        qos=QOS,
    )
    time.sleep(WAITED_S)
    subscriber.close()
    return heard


for number, topic in enumerate(("/description", "/arm/description"), 1):
    latch(number, topic)
one, other = heard_late("/description"), heard_late("/arm/description")
print("zenoh-ros2-sdk", importlib.metadata.version("zenoh-ros2-sdk"))
print(f"/description: {one}; /arm/description: {other}")
sys.stdout.flush()
os._exit(not (one == ["on"] and other == []))
PYTHON
