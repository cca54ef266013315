#!/bin/sh
# Two Zenoh peers whose direct connection breaks once stay apart, with a router that both still have.
#
# One would guess: as Zenoh retries connections without end, two peers that met by a router's gossip
# are connected again when their TCP connection breaks, or the router passes their messages on.
# It is so: only what stands in connect/endpoints is tried again. A peer that was met by gossip is
# not, nothing is logged, and no message comes any more, though both peers and the router go on.
#
# A router and two peers on loopback; what connects the peers is shut down, as a dropped Wi-Fi does.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check "eclipse-zenoh==1.10.2"
"$folder/venv/bin/python" - <<'PYTHON'
import importlib.metadata
import json
import os
import socket
import sys
import time

import zenoh

WATCHED_S = 10.0


def opened(mode, connect=(), listen=()):
    config = zenoh.Config()
    for key, value in {
        "mode": mode,
        "connect/endpoints": list(connect),
        "listen/endpoints": list(listen),
        "scouting/multicast/enabled": False,
    }.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


with socket.socket() as free:
    free.bind(("127.0.0.1", 0))
    place = f"tcp/127.0.0.1:{free.getsockname()[1]}"
router = opened("router", listen=[place])
sender = opened("peer", [place], ["tcp/127.0.0.1:0"])
receiver = opened("peer", [place], ["tcp/127.0.0.1:0"])
heard = []
receiver.declare_subscriber("a", lambda sample: heard.append(time.monotonic()))
publisher = sender.declare_publisher("a")


def send_for(seconds):
    heard.clear()
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        publisher.put(b"x")
        time.sleep(0.02)
    return len(heard)


def direct():
    """The ports of each connection between the two peers."""
    return [
        {int(str(end).rpartition(":")[2]) for end in (link.src, link.dst)}
        for link in receiver.info.links()
        if str(link.zid) == str(sender.zid())
    ]


deadline_s = time.monotonic() + 30.0
while not direct() and time.monotonic() < deadline_s:
    time.sleep(0.1)
time.sleep(1.0)
before = send_for(2.0)
ports = direct()
for number in os.listdir("/proc/self/fd"):
    try:
        with socket.socket(fileno=os.dup(int(number))) as one:
            if {one.getsockname()[1], one.getpeername()[1]} in ports:
                one.shutdown(socket.SHUT_RDWR)
    except (OSError, IndexError, TypeError):
        pass
send_for(2.0)
after = send_for(WATCHED_S)
print("eclipse-zenoh", importlib.metadata.version("eclipse-zenoh"))
print(f"messages in 2 s before: {before}; in {WATCHED_S:g} s after: {after}; connected: {direct()}")
good = before > 50 and after == 0 and not direct()
sys.stdout.flush()
os._exit(not good)
PYTHON
