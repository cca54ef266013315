"""Jog stream from a page to an arm: requests to the arm and their end, without a server."""

from __future__ import annotations

import asyncio
import json

import pytest

from cardan.gateway.arm.backlog import Delays
from cardan.gateway.arm.requests import encode_reply
from cardan.gateway.servers.console.jog import ArmJog, Wish
from cardan.protocols.handheld.frames import JogJoints, JogTwist
from cardan.types import Frame, Vector3

NOWHERE = Vector3(0.0, 0.0, 0.0)
NEVER_OLD_S = 1e12
TWIST = Wish(JogTwist(Vector3(0.0, 0.0, 0.1), NOWHERE, Frame.BASE), NEVER_OLD_S)
JOINTS = Wish(JogJoints((0.1, 0.0)), NEVER_OLD_S)


class Arm:
    """An arm that replies when the test says so."""

    def __init__(self):
        self.asked, self._answers = [], []

    def start(self, _service, _kind, data, _timeout_s):
        self.asked.append(json.loads(data["request"]))
        self._answers.append(asyncio.get_running_loop().create_future())
        return self._answers[-1]

    @property
    def verbs(self):
        return [each["verb"] for each in self.asked]

    async def answer(self, result=None):
        """Reply to all requests so far."""
        for asked, answer in zip(self.asked, self._answers, strict=True):
            if not answer.done():
                answer.set_result({"reply": encode_reply(asked["id"], result).decode()})
        await settle()


async def settle():
    for _ in range(10):
        await asyncio.sleep(0)


async def joints_then_twist(after):
    """Hold a joint, then the TCP; `after` runs while the arm is requested to leave the first
    stream. Returns the arm."""
    arm = Arm()
    jog = ArmJog("/arm", "page hand", arm, pytest.fail)
    jog.open()
    jog.begin()
    jog.move(JOINTS)
    await settle()
    await arm.answer()
    jog.rest()
    await settle()
    await arm.answer()
    assert arm.verbs == ["joints", "joints"]
    jog.begin()
    jog.move(TWIST)
    await settle()
    assert arm.verbs[2:] == ["set_parameters"]
    after(jog)
    for _ in range(3):
        await arm.answer()
    closing = asyncio.get_running_loop().create_task(jog.close())
    await settle()
    await arm.answer()
    await closing
    return arm


def test_a_hold_that_ends_before_its_first_command_is_sent_sends_none():
    arm = asyncio.run(joints_then_twist(ArmJog.rest))
    assert arm.verbs[3:] == ["release"]


def test_a_hold_goes_on_with_its_newest_command():
    newest = Wish(JogTwist(Vector3(0.0, 0.0, 0.2), NOWHERE, Frame.BASE), NEVER_OLD_S)
    arm = asyncio.run(joints_then_twist(lambda jog: jog.move(newest)))
    twists = [each["value"] for each in arm.asked if each["verb"] == "twist"]
    assert [each[2] for each in twists] == [0.2, 0.0]
    assert arm.verbs[-2:] == ["twist", "release"]


@pytest.mark.parametrize("again", [True, False])
def test_the_first_press_of_a_hand_that_the_arm_does_not_know_yet_moves_it(again):
    """The arm refuses the stream until it knows the sender's clock; later in a hold that would end
    it."""
    delays = Delays()
    delays.hear("page hand", 5.0, 7.0)
    why = delays.late("page hand")
    assert why

    async def pressed():
        arm, refused = Arm(), []
        jog = ArmJog("/arm", "page hand", arm, refused.append)
        jog.open()
        jog.begin()
        for answer in (None, why) if again else (why, None):
            jog.move(TWIST)
            await settle()
            await arm.answer(answer)
        begins = [each.get("begins") for each in arm.asked]
        closing = asyncio.get_running_loop().create_task(jog.close())
        await settle()
        await arm.answer()
        await closing
        return refused, begins

    refused, begins = asyncio.run(pressed())
    assert refused == ([why] if again else [])
    assert begins == (["new", None] if again else ["new", "new"])
