#!/bin/sh
# RustDDS, and with it a node of dora-rs, may never hear a topic because a third program joins DDS.
#
# One would guess: who joins has no effect on what two others have told each other; what DDS has
# acknowledged of a writer, it knows.
# It is so: where the announcement of a writer waits to be read while another, new participant is
# processed, RustDDS takes it with that participant's and throws it away, as it is not of that one. It has
# acknowledged it already, so nobody sends it again, and the reader hears nothing for as long as both are
# there, without a word. A node that joins a domain with two participants or more meets that by chance:
# all of them answer at once. With one other participant it does not happen. A node that is made anew
# draws anew.
#
# A node of dora-rs that hears a first topic is stopped; meanwhile writers of ten more are made, and
# before each a participant of Cyclone DDS joins, or not; then the node goes on. On loopback.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    "cyclonedds==11.0.1" "dora-rs==1.1.0" "pyarrow==26.0.1"
mkdir -p "$folder/share/std_msgs/msg"
echo "string data" >"$folder/share/std_msgs/msg/String.msg"
echo "<package><name>std_msgs</name></package>" >"$folder/share/std_msgs/package.xml"
cat >"$folder/node.py" <<'PYTHON'
import sys
import time
import warnings

warnings.filterwarnings("ignore", message="dora-rs ROS2 Bridge")

import dora

PERIOD_S = 0.01
transport, qos = dora.Ros2Transport.dds(), dora.Ros2QosPolicies(reliable=True, keep_last=10)
context = dora.Ros2Context(transport=transport, domain_id=int(sys.argv[1]))
node = context.new_node("dora", "/", dora.Ros2NodeOptions(rosout=False))
there = {
    name: node.create_subscription(node.create_topic(f"/{name}", "std_msgs/String", qos), qos)
    for name in sys.argv[2:]
}
while there:
    for name in [name for name, topic in there.items() if topic.next() is not None]:
        print(name, flush=True)
        del there[name]
    time.sleep(PERIOD_S)
PYTHON
AMENT_PREFIX_PATH="$folder" "$folder/venv/bin/python" - "$folder/node.py" <<'PYTHON'
import importlib.metadata
import os
import random
import select
import signal
import subprocess
import sys
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic

DOMAIN, ALONE_RUNS, MOST_RUNS = random.randrange(50, 100), 4, 20
STARTED_S, WAITED_S, PERIOD_S = 60.0, 8.0, 0.1
NAMES = [f"topic_{number}" for number in range(10)]
CONFIG = """<CycloneDDS xmlns="https://cdds.io/config"><Domain Id="any">
<General><Interfaces><NetworkInterface name="lo" multicast="true"/></Interfaces></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>40</MaxAutoParticipantIndex>
<Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>"""
QOS = Qos(
    Policy.Reliability.Reliable(0),
    Policy.History.KeepLast(10),
    Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False),
)


@dataclass
class String(IdlStruct, typename="std_msgs.msg.dds_.String_"):
    data: str


def writer(participant, name):
    return DataWriter(participant, Topic(participant, f"rt/{name}", String), qos=QOS)


def told(node, writers, most, within_s):
    """How many lines the node tells, `most` at most, while all write, until none comes in time."""
    text, end_s = b"", time.monotonic() + within_s
    while (count := text.count(b"\n")) < most and time.monotonic() < end_s:
        for each in writers:
            each.write(String("on"))
        if select.select([node.stdout], [], [], PERIOD_S)[0]:
            text += os.read(node.stdout.fileno(), 4096)
            end_s = time.monotonic() + within_s
    return count


def heard(joins):
    """How many topics are heard, where another participant joins before each writer, or none does."""
    participant, others = DomainParticipant(DOMAIN), []
    command = [sys.executable, sys.argv[1], str(DOMAIN), "first", *NAMES]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as node:
        try:
            writers = [writer(participant, "first")]
            assert told(node, writers, 1, STARTED_S) == 1
            node.send_signal(signal.SIGSTOP)
            for name in NAMES:
                if joins:
                    others.append(DomainParticipant(DOMAIN))
                writers.append(writer(participant, name))
                time.sleep(PERIOD_S)
            node.send_signal(signal.SIGCONT)
            return told(node, writers, len(NAMES), WAITED_S)
        finally:
            node.kill()


domain = Domain(DOMAIN, CONFIG)
alone, joined = [heard(False) for _ in range(ALONE_RUNS)], []
while len(joined) < MOST_RUNS and sum(joined) == len(joined) * len(NAMES):
    joined.append(heard(True))
print("dora-rs", importlib.metadata.version("dora-rs"))
print(f"heard, of {len(NAMES)}: {alone} with nobody else; {joined} where others join meanwhile")
sys.stdout.flush()
os._exit(not (sum(alone) == len(alone) * len(NAMES) and sum(joined) < len(joined) * len(NAMES)))
PYTHON
