"""Goals and their cancellation through rosbridge, without sockets: a client and a network within
the test."""

from __future__ import annotations

import asyncio
import json
from collections import Counter
from contextlib import asynccontextmanager
from types import SimpleNamespace

import pytest

pytest.importorskip("cbor2", reason="cbor2 is not installed: pip install cardan[network]")

from cardan.bus.network import Failure, NetworkError
from cardan.gateway.servers.calls import Mailbox, ServiceCaller
from cardan.gateway.servers.rosbridge_client import RosbridgeClient
from cardan.gateway.servers.web import WebOptions
from cardan.protocols.ros2.actions import CANCEL_TYPE, CancelCode, Goals, GoalStatus
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import completed
from tests.gateway.servers.memory_network import TEST_NODE, MemoryNetwork
from tests.gateway.servers.nodes import MOVE


class Part(MemoryNetwork):
    """A client's part of a network, unusable once the client has left."""

    def __init__(self, whole):
        super().__init__()
        self.servers, self.left = whole.servers, False

    def call(self, *asked):
        if self.left:
            raise NetworkError("this part of the network is closed")
        super().call(*asked)


class SlowServer:
    """An action server that accepts a goal when the test says so, and knows it from then on."""

    def __init__(self, network):
        self.goals, self.asked, self.waiting, self.codes = Goals(), [], {}, []
        network.serve("/move/_action/send_goal", f"{MOVE}_SendGoal", self.take, TEST_NODE)
        network.serve("/move/_action/get_result", f"{MOVE}_GetResult", self.result, TEST_NODE)
        network.offer("/move/_action/cancel_goal", CANCEL_TYPE, self.cancel)

    def take(self, request, answered):
        goal = codec_of(f"{MOVE}_SendGoal_Request").decode(request)
        self.asked.append((bytes(goal["goal_id"]["uuid"]), answered))

    def accept(self, accepted=True):
        """Reply to the oldest goal request."""
        goal_id, answered = self.asked.pop(0)
        if accepted:
            self.goals.accept(goal_id, 0, 0.0)
        kind = f"{MOVE}_SendGoal_Response"
        answered(codec_of(kind).encode(completed(kind, {"accepted": accepted})))

    def cancel(self, request):
        # Like servers that do not remember cancellations of unknown goals.
        goal = self.goals.find(bytes(request["goal_info"]["goal_id"]["uuid"]))
        if goal is None:
            self.codes.append(CancelCode.UNKNOWN_GOAL_ID)
            return {"return_code": int(CancelCode.UNKNOWN_GOAL_ID)}
        response, going = self.goals.cancel(request)
        self.codes.append(CancelCode(response["return_code"]))
        for each in going:
            self.goals.finish(each, GoalStatus.CANCELED, {}, 0.0)
            kind = f"{MOVE}_GetResult_Response"
            if each.id in self.waiting:
                self.waiting[each.id](codec_of(kind).encode(completed(kind, {"status": 5})))
        return response

    def result(self, request, answered):
        kind = f"{MOVE}_GetResult"
        goal_id = bytes(codec_of(f"{kind}_Request").decode(request)["goal_id"]["uuid"])
        goal = self.goals.find(goal_id)
        if goal.status.over:
            response = completed(f"{kind}_Response", {"status": int(goal.status)})
            answered(codec_of(f"{kind}_Response").encode(response))
        self.waiting[goal_id] = answered

    @property
    def states(self):
        return [each["status"] for each in self.goals.status_array()["status_list"]]


class Bench:
    """A client, and the action server."""

    def __init__(self):
        self.whole = MemoryNetwork()
        self.part = Part(self.whole)
        self.server = SlowServer(self.whole)
        self.sent = []
        mailbox = Mailbox(asyncio.get_running_loop())
        self.client = RosbridgeClient(
            SimpleNamespace(waited_s=0.0, transport=SimpleNamespace(is_closing=lambda: True)),
            "test",
            self.part,
            ServiceCaller(self.part, mailbox),
            None,
            None,
            mailbox,
            WebOptions().allowed,
            Counter(),
            lasting=ServiceCaller(self.whole, mailbox),
            max_bytes=1000,
            service_timeout_s=30.0,
        )
        self.client.send = lambda *frames: self.sent.extend(map(json.loads, frames))

    def ask(self, op, **fields):
        given = {"op": op, "id": "g", "action": "/move", **fields}
        self.client.receive(json.dumps(given))

    async def settle(self):
        """Wait until nothing more happens."""
        for _ in range(20):
            await asyncio.sleep(0)

    def leave(self):
        """Disconnect the client, and close its part of the network."""
        self.client._leave()
        self.part.left = True


@asynccontextmanager
async def a_goal():
    bench = Bench()
    bench.ask("send_action_goal", action_type=MOVE, args={})
    yield bench
    await bench.settle()


def in_loop(test):
    """Run a test that is a coroutine."""

    def run():
        asyncio.run(test())

    run.__name__ = test.__name__
    return run


@in_loop
async def test_a_cancellation_right_after_its_goal_is_for_when_it_is_accepted():
    async with a_goal() as bench:
        bench.ask("cancel_action_goal")
        await bench.settle()
        assert bench.sent == []
        bench.server.accept()
        await bench.settle()
        assert bench.server.codes[-1] is CancelCode.NONE
        assert bench.server.states == [GoalStatus.CANCELED]
        (reported,) = bench.sent
        assert (reported["op"], reported["id"], reported["status"]) == ("action_result", "g", 5)


@in_loop
async def test_an_accepted_goal_is_canceled_once():
    async with a_goal() as bench:
        bench.server.accept()
        await bench.settle()
        bench.ask("cancel_action_goal")
        await bench.settle()
        assert bench.server.codes == [CancelCode.NONE]
        assert bench.sent[0]["status"] == 5


@in_loop
async def test_a_goal_that_is_not_accepted_needs_no_more_canceling():
    async with a_goal() as bench:
        bench.ask("cancel_action_goal")
        await bench.settle()
        bench.server.accept(False)
        await bench.settle()
        assert bench.server.codes == [CancelCode.UNKNOWN_GOAL_ID]
        assert bench.sent[0]["values"] == "/move did not accept the goal"


@in_loop
async def test_a_goal_whose_acceptance_does_not_come_is_canceled():
    # The client gets a failure, and would never cancel the goal.
    async with a_goal() as bench:
        goal_id, answered = bench.server.asked.pop()
        bench.server.goals.accept(goal_id, 0, 0.0)
        answered(Failure("/move/_action/send_goal: no reply: no server offers it, or it is late"))
        await bench.settle()
        assert bench.server.states == [GoalStatus.CANCELED]
        assert "no reply" in bench.sent[0]["values"]


@in_loop
async def test_a_client_that_leaves_right_after_its_goal_has_none():
    async with a_goal() as bench:
        bench.leave()
        await bench.settle()
        bench.server.accept()
        await bench.settle()
        assert bench.server.states == [GoalStatus.CANCELED]
        assert bench.sent == []


@in_loop
async def test_a_client_that_cancels_and_leaves_has_none():
    async with a_goal() as bench:
        bench.ask("cancel_action_goal")
        bench.leave()
        await bench.settle()
        bench.server.accept()
        await bench.settle()
        assert bench.server.states == [GoalStatus.CANCELED]


@in_loop
async def test_a_client_that_leaves_asks_at_once_too():
    # The client's handler may end before the goal is accepted.
    async with a_goal() as bench:
        bench.leave()
        assert bench.server.codes == [CancelCode.UNKNOWN_GOAL_ID]


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        ({"return_code": int(CancelCode.REJECTED)}, "/move does not cancel this goal"),
        (Failure("/move/_action/cancel_goal: no reply"), "no reply"),
    ],
)
def test_a_client_is_reported_that_its_goal_is_not_canceled(answer, words):
    async def reported():
        async with a_goal() as bench:
            bench.ask("set_level", level="error")
            bench.server.accept()
            await bench.settle()
            bench.whole.offer("/move/_action/cancel_goal", CANCEL_TYPE, lambda _request: answer)
            bench.ask("cancel_action_goal")
            await bench.settle()
            (status,) = bench.sent
            assert (status["op"], status["id"]) == ("status", "g")
            assert words in status["msg"]

    asyncio.run(reported())
