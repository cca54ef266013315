"""The simulated service, judged by leapjs: the vendor's public client, from npm."""

from __future__ import annotations

import json
import subprocess

import pytest

from cardan_leap.peer import LeapPeer, LeapPeerOptions
from cardan_leap.protocol import ClientOptions
from tests.npm import installed
from tests.serving import in_a_thread

pytestmark = pytest.mark.matrix

LEAPJS = "1.1.1"
RUN_TIMEOUT_S = 20.0

judged = pytest.mark.judged(device="Leap Motion", transport="WebSocket", by="leapjs 1.1.1")

# Prints each message as seen by the client, as a line of JSON, until FRAMES have hands.
CLIENT = """
const Leap = require('leapjs');
const [port, frames, background] = process.argv.slice(1).map(Number);
const say = (kind, more) => console.log(JSON.stringify({kind, ...more}));
const controller = new Leap.Controller({
  host: '127.0.0.1', port, frameEventName: 'deviceFrame', background: Boolean(background),
  loopWhileDisconnected: false, suppressAnimationLoop: true,
});
let left = frames;
controller.on('ready', () => say('ready', {
  version: controller.connection.protocol.version,
  service: controller.connection.protocol.serviceVersion,
  asked: controller.connection.opts.requestProtocolVersion,
}));
for (const name of ['deviceAttached', 'deviceStreaming', 'deviceStopped', 'deviceRemoved'])
  controller.on(name, device => say(name, {device}));
controller.on('disconnect', () => say('disconnect', {}));
controller.on('frame', frame => {
  if (!frame.hands.length) return;
  const hand = frame.hands[0];
  say('frame', {
    id: frame.id, hands: frame.hands.length, fingers: frame.fingers.length,
    type: hand.type, palm: hand.palmPosition, roll: hand.roll(), pitch: hand.pitch(),
    yaw: hand.yaw(), grab: hand.grabStrength, confidence: hand.confidence,
    extended: hand.fingers.filter(finger => finger.extended).length,
    order: [hand.thumb, hand.indexFinger, hand.middleFinger, hand.ringFinger, hand.pinky]
      .map(finger => finger && finger.type),
    bone: hand.middleFinger && hand.middleFinger.bones[1] ? {
      length: hand.middleFinger.bones[1].length,
      direction: Array.from(hand.middleFinger.bones[1].direction()),
      left: hand.middleFinger.bones[1].left(),
    } : null,
    arm: hand.arm ? hand.arm.length : null,
    box: Array.from(frame.interactionBox.normalizePoint(hand.palmPosition, true)),
  });
  if (--left === 0) process.exit(0);
});
controller.connect();
setTimeout(() => process.exit(3), 10000);
"""


@pytest.fixture(scope="module")
def leapjs():
    """The folder in which node finds leapjs."""
    return installed("leapjs", LEAPJS)


def heard(folder, script, frames, *, background=True, **options):
    """Return leapjs's output about a service, by kind, and the service."""
    peer = LeapPeer(LeapPeerOptions(port=0, script=script, **options))
    with in_a_thread(peer):
        result = subprocess.run(
            ["node", "-e", CLIENT, "--", str(peer.backend.port), str(frames), str(int(background))],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=RUN_TIMEOUT_S,
            check=False,
        )
    assert result.returncode == 0, result.stderr + result.stdout[-500:]
    lines = [json.loads(line) for line in result.stdout.splitlines() if line.startswith("{")]
    reported: dict[str, list] = {}
    for line in lines:
        reported.setdefault(line["kind"], []).append(line)
    return reported, peer.device


def write(tmp_path, text):
    path = tmp_path / "hand.script"
    path.write_text(text)
    return str(path)


@pytest.mark.real
@judged
def test_it_understands_hands_fingers_and_bones(leapjs, tmp_path):
    script = write(tmp_path, "0.1 enter right 40 220 -30\n0.1 tilt right 20 0 0\n0.5 loop")
    reported, service = heard(leapjs, script, 20)
    ready = reported["ready"][0]
    assert (ready["version"], ready["service"]) == (6, "2.3.1+33747")
    assert reported["deviceStreaming"][0]["device"]["type"] == "peripheral"
    frame = reported["frame"][-1]
    assert frame["palm"] == [40, 220, -30]
    assert frame["pitch"] == pytest.approx(0.349066, abs=1e-5)
    assert (frame["roll"], frame["yaw"]) == pytest.approx((0.0, 0.0), abs=1e-5)
    assert (frame["type"], frame["hands"], frame["fingers"], frame["extended"]) == (
        "right",
        1,
        5,
        5,
    )
    assert frame["order"] == [0, 1, 2, 3, 4]
    assert frame["bone"]["length"] == pytest.approx(45.0, abs=0.01)
    assert frame["bone"]["left"] is False
    assert frame["bone"]["direction"] == pytest.approx([0.0, 0.342, -0.94], abs=0.001)
    assert frame["arm"] == pytest.approx(250.0, abs=0.1)
    assert frame["box"] == pytest.approx([0.670, 0.585, 0.297], abs=0.001)
    assert [options for _, options in service.requests] == [
        ClientOptions(background=True),
        ClientOptions(optimize_hmd=False),
        ClientOptions(focused=True),
    ]


@judged
def test_a_left_hand_is_left_to_it(leapjs, tmp_path):
    script = write(tmp_path, "0.1 enter left\n0.1 grab left 1\n0.5 loop")
    reported, _ = heard(leapjs, script, 5, background=False)
    frame = reported["frame"][-1]
    assert (frame["type"], frame["grab"], frame["extended"]) == ("left", 1, 0)
    assert frame["bone"]["left"] is True


@judged
def test_it_takes_an_older_version_when_informed(leapjs, tmp_path):
    script = write(tmp_path, "0.1 enter right\n0.5 loop")
    reported, _ = heard(leapjs, script, 5, faults={"highest-version": 5.0})
    assert (reported["ready"][0]["version"], reported["ready"][0]["asked"]) == (5, 5)
    assert reported["frame"][-1]["palm"] == [0, 200, 0]


@judged
def test_it_notices_unplugging_and_comes_back_after_a_restart(leapjs, tmp_path):
    script = write(
        tmp_path, "0.2 unplug\n0.4 replug\n0.6 restart 0.2\n2.5 enter right\n3 leave right"
    )
    reported, service = heard(leapjs, script, 5)
    assert reported["deviceRemoved"][0]["device"]["attached"] is False
    assert reported["disconnect"]
    assert len(reported["ready"]) == 2
    assert service.restarts == 1
