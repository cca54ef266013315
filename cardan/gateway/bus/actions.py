"""Motions of an arm as ROS 2 actions: goals that report their progress, and can be canceled. A
valid goal is accepted at once, a malformed one rejected; a refusal by the arm ends the goal as
aborted, with the reason in its result, because a rejected goal cannot carry one. A later motion
replaces the goal, through rest, as with all motions. A goal that is canceled before it moves the
arm, or before it is accepted, never begins: it is accepted and ends as canceled."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, NamedTuple

from cardan.bus.node import BusNode, ServiceRequest
from cardan.errors import CardanError
from cardan.gateway.arm.requests import CANCELED, MotionNote, PacketError, Request
from cardan.gateway.arm.verb_results import Outcome
from cardan.gateway.bus.commands import ActionCommand, Instant
from cardan.gateway.bus.serving import CommandServer
from cardan.protocols.ros2.actions import (
    CANCEL_TYPE,
    FEEDBACK_QOS,
    STATUS_QOS,
    STATUS_TYPE,
    Goal,
    Goals,
    GoalStatus,
)
from cardan.protocols.ros2.cdr import MalformedCdr, Message, codec_of
from cardan.protocols.ros2.interfaces import action_type
from cardan.protocols.ros2.messages import default_message
from cardan.protocols.ros2.refusals import refusal

MAX_WAITING = 8
"""Most clients that wait for the result of one goal."""


class Ahead(NamedTuple):
    """A goal that must be accepted before the cancellations that arrived with it, and begin after
    them: the packet itself follows."""

    packet: ServiceRequest


_Taken = tuple[int, Goal, Any]
"""The id of a request, the goal, and the verb's argument."""


class ArmAction:
    """Server of an action of an arm."""

    def __init__(self, node: BusNode, server: CommandServer, command: ActionCommand) -> None:
        """`node` is open; `server` passes goals on to the worker."""
        self.goals = Goals()
        self._server, self._command = server, command
        self._type = own = action_type(command.type_name)
        base = f"{command.action}/_action"
        send = node.service(f"{base}/send_goal", own.send_goal.name)
        cancel = node.service(f"{base}/cancel_goal", CANCEL_TYPE)
        result = node.service(f"{base}/get_result", own.get_result.name)
        self._feedback = node.publisher(f"{base}/feedback", own.feedback, FEEDBACK_QOS)
        self._status = node.publisher(f"{base}/status", STATUS_TYPE, STATUS_QOS)
        self._stopper = _CancelClient(self)
        self.offers: tuple[Callable[[], Any], Any] = send.poll, _GoalClient(self)
        """Poll of goals, and the client of the worker that takes them."""
        self.cancels: tuple[Callable[[], Any], Any] = cancel.poll, self._stopper
        self.results: tuple[Callable[[], Any], Any] = result.poll, _ResultClient(self)
        self._results: dict[bytes, list[ServiceRequest]] = {}
        self._lock, self._telling = threading.Lock(), threading.Lock()
        self._running: Goal | None = None
        self.put_status()

    # -- for the loop ----------------------------------------------------------------------------

    @property
    def running(self) -> bool:
        """True while a goal moves the arm."""
        return self._running is not None

    def tell(self, now: Instant, now_ns: int) -> None:
        """Publish the progress of the goal that moves the arm."""
        goal = self._running
        if goal is None:
            return
        feedback = self._command.feedback(now)
        message = {"goal_id": {"uuid": goal.id}, "feedback": feedback}
        self._feedback.put(codec_of(self._type.feedback).encode(message), now_ns)

    # -- for the worker's threads ----------------------------------------------------------------

    def accept(self, packet: ServiceRequest) -> _Taken | None:
        """Take a goal; None if it was answered otherwise. Raises PacketError for a malformed
        goal."""
        server, command = self._server, self._command
        name = self._type.send_goal.request
        number = server.next_id()
        message = codec_of(name).decode(packet.data)
        if isinstance(message, MalformedCdr):
            server.refused += 1
            reason = f"{command.verb}: {message.reason}"
            server.tell(command.verb, 0, "refused", reason)
            _refuse(packet, self._type.send_goal.name, reason)
            raise PacketError(reason, number)
        now_ns = time.time_ns()
        with self._lock:
            goal = self.goals.accept(bytes(message["goal_id"]["uuid"]), now_ns, time.monotonic())
        stamp = {"sec": now_ns // 10**9, "nanosec": now_ns % 10**9}
        answer = {"accepted": goal is not None, "stamp": stamp}
        packet.reply(codec_of(self._type.send_goal.response).encode(answer), now_ns)
        if goal is None:
            server.tell(command.verb, 0, "refused", f"{command.verb}: its goal id is known already")
            return None
        self.put_status()
        try:
            return number, goal, command.value(message["goal"])
        except CardanError as error:
            self.end(goal, GoalStatus.ABORTED, str(error), error)
            raise PacketError(str(error), number) from error

    def begin(self, goal: Goal) -> None:
        """Mark the goal as moving the arm."""
        before, self._running = self._running, goal
        if before is not None:
            self.end(before, GoalStatus.ABORTED, f"{self._command.verb} took over")
        with self._lock:
            self.goals.execute(goal)
        self.put_status()
        if goal.status is GoalStatus.CANCELING:
            self._server.offer(self._stopper, None)

    def end(
        self, goal: Goal, status: GoalStatus, reason: str = "", error: CardanError | None = None
    ) -> None:
        """End the goal: answer the requests for its result."""
        if self._running is goal:
            self._running = None
        if status is GoalStatus.ABORTED and goal.status is GoalStatus.CANCELING:
            status = GoalStatus.CANCELED
        result = self._command.result(reason, error)
        with self._lock:
            if not self.goals.finish(goal, status, result, time.monotonic()):
                return
            waiting = self._results.pop(goal.id, [])
        self.put_status()
        for packet in waiting:
            self._reply_result(packet, status, result)

    def cancel(self, message: Message) -> tuple[Message, bool]:
        """Return the response to a request to cancel, and whether the arm must brake for it."""
        with self._lock:
            response, going = self.goals.cancel(message)
        self.put_status()
        return response, self._running in going

    def ask_result(self, goal_id: bytes, packet: ServiceRequest) -> None:
        """Answer with a goal's result as soon as it is known."""
        with self._lock:
            goal = self.goals.find(goal_id)
            if goal is not None and not goal.status.over:
                waiting = self._results.setdefault(goal_id, [])
                if len(waiting) < MAX_WAITING:
                    waiting.append(packet)
                else:
                    reason = f"{MAX_WAITING} clients wait for this result already"
                    _refuse(packet, self._type.get_result.name, reason)
                return
        if goal is None or goal.result is None:
            unknown = default_message(self._type.result)
            self._reply_result(packet, GoalStatus.UNKNOWN, unknown)
        else:
            self._reply_result(packet, goal.status, goal.result)

    def _reply_result(self, packet: ServiceRequest, status: GoalStatus, result: Message) -> None:
        message = {"status": int(status), "result": result}
        packet.reply(codec_of(self._type.get_result.response).encode(message), time.time_ns())

    def put_status(self) -> None:
        """Publish the states of all goals."""
        with self._telling:
            with self._lock:
                states = self.goals.status_array()
            data = codec_of(STATUS_TYPE).encode(states)
            self._status.put(data, time.time_ns())

    def read(self, service: str, packet: ServiceRequest) -> Message:
        """Decode the message in a request to `service`. Raises PacketError, after the refusal."""
        message = codec_of(f"{service}_Request").decode(packet.data)
        if isinstance(message, MalformedCdr):
            self._server.refused += 1
            _refuse(packet, service, message.reason)
            raise PacketError(f"{self._command.action}: {message.reason}")
        return message

    def request(self, taken: _Taken, packet: ServiceRequest) -> Request:
        """Convert the goal of `packet` to a request to the arm. It is not begun once it is
        canceled, and, without an end of its own, ends with its client."""
        (number, goal, value), server = taken, self._server
        request = Request(
            number, server.source(packet), self.verb, value,
            wanted=lambda: goal.status is not GoalStatus.CANCELING,
        )  # fmt: skip
        return server.watched(request, packet)

    @property
    def verb(self) -> str:
        """Verb that carries out the goals."""
        return self._command.verb

    @property
    def result_type(self) -> str:
        """Type of the service that returns the result."""
        return self._type.get_result.name

    def next_id(self) -> int:
        """Id of the next request."""
        return self._server.next_id()


def _refuse(packet: ServiceRequest, service: str, reason: str) -> None:
    response = refusal(service, reason)
    packet.reply(codec_of(f"{service}_Response").encode(response), time.time_ns())


class _GoalClient:
    """The goals of an action as requests to the arm."""

    def __init__(self, action: ArmAction) -> None:
        self._action = action
        self._asked: dict[int, Goal] = {}
        self._moving: dict[int, Goal] = {}
        """Goals under way, by their motion's id."""
        self._ahead: dict[ServiceRequest, _Taken | None] = {}
        """Accepted goals that have not begun; None: goals that were answered otherwise."""

    def decode(self, packet: ServiceRequest | Ahead) -> Request | None:
        action = self._action
        if isinstance(packet, Ahead):
            if packet.packet not in self._ahead:
                self._ahead[packet.packet] = None  # Also where it raises.
                self._ahead[packet.packet] = action.accept(packet.packet)
            return None
        taken = self._ahead.pop(packet) if packet in self._ahead else action.accept(packet)
        if taken is None:
            return None
        number, goal, _ = taken
        if goal.status is GoalStatus.CANCELING:
            action.end(goal, GoalStatus.CANCELED, f"{action.verb}: {CANCELED}")
            return None
        self._asked[number] = goal
        return action.request(taken, packet)

    def done(self, request: Request, result: Any) -> None:
        goal = self._asked.pop(request.id)
        if isinstance(result, MotionNote) and result.outcome is Outcome.RUNNING:
            self._moving[result.id] = goal
            self._action.begin(goal)
        else:
            self._end(goal, result)

    def refused(self, number: int | None, error: CardanError) -> None:
        goal = self._asked.pop(number or 0, None)
        if goal is not None:
            self._action.end(goal, GoalStatus.ABORTED, str(error), error)

    def ended(self, note: MotionNote) -> None:
        goal = self._moving.pop(note.id, None)
        if goal is not None:
            self._end(goal, note)

    def _end(self, goal: Goal, note: MotionNote) -> None:
        done = note.outcome is Outcome.DONE
        status = GoalStatus.SUCCEEDED if done else GoalStatus.ABORTED
        self._action.end(goal, status, "" if done else note.reason or "it was ended")


class _CancelClient:
    """Requests to cancel goals; the arm brakes if one of them moves it."""

    def __init__(self, action: ArmAction) -> None:
        self._action = action

    def decode(self, packet: ServiceRequest | None) -> Request | None:
        """Decode a request to cancel; None for `packet`: only brake."""
        action = self._action
        if packet is not None:
            response, moving = action.cancel(action.read(CANCEL_TYPE, packet))
            packet.reply(codec_of(f"{CANCEL_TYPE}_Response").encode(response), time.time_ns())
            if not moving:
                return None
        return Request(action.next_id(), "", "stop")

    def done(self, request: Request, result: Any) -> None:
        """Do nothing: the goal reports its end."""

    def refused(self, number: int | None, error: CardanError) -> None:
        """Do nothing: a malformed request was answered already."""

    def ended(self, note: MotionNote) -> None:
        """Do nothing: this client begins no motion."""


class _ResultClient:
    """Requests for results."""

    def __init__(self, action: ArmAction) -> None:
        self._action = action

    def decode(self, packet: ServiceRequest) -> None:
        message = self._action.read(self._action.result_type, packet)
        self._action.ask_result(bytes(message["goal_id"]["uuid"]), packet)

    def done(self, request: Request, result: Any) -> None:
        """Do nothing: it requests nothing of the arm."""

    def refused(self, number: int | None, error: CardanError) -> None:
        """Do nothing: a malformed request was answered already."""

    def ended(self, note: MotionNote) -> None:
        """Do nothing: this client begins no motion."""
