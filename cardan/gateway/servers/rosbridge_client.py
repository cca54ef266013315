"""A client of a rosbridge server: its subscriptions, publications, service calls and services."""

from __future__ import annotations

import asyncio
import logging
import os
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from functools import partial
from typing import Any, NamedTuple

from cardan.bus.network import (
    Answered,
    Failure,
    Handle,
    Network,
    NetworkError,
)
from cardan.errors import shown
from cardan.gateway.arm.backlog import is_stale, stale_words
from cardan.gateway.servers.allow_list import Allowed
from cardan.gateway.servers.calls import CallError, Mailbox, ServiceCaller
from cardan.gateway.servers.connection import SendLoop
from cardan.gateway.servers.publishing import Advertisements, RefusedError, agreed_type
from cardan.gateway.servers.read_only import READING_SERVICES
from cardan.gateway.servers.rosapi import LOG, ROSOUT, SERVICES as ROSAPI_SERVICES, RosApi
from cardan.gateway.servers.rosbridge_subscriptions import (
    ClientStream,
    RosbridgeSubscription,
    RosbridgeSubscriptions,
)
from cardan.gateway.servers.send_queue import LATCHED_DEPTH, TopicQueue
from cardan.gateway.servers.web import ListenerConnection
from cardan.protocols.ros2.actions import CANCEL_TYPE, CancelCode, GoalStatus
from cardan.protocols.ros2.cdr import CdrError, MalformedCdr, Message, codec_of, decoded
from cardan.protocols.ros2.interfaces import (
    DUMMY_MEMBER,
    ActionType,
    InterfaceError,
    action_type,
    full_name,
    message_type,
    service_type,
)
from cardan.protocols.ros2.messages import MessageError, Stamp, completed
from cardan.protocols.ros2.names import RosNameError, checked_name
from cardan.protocols.rosbridge import forms
from cardan.protocols.rosbridge.delivery import (
    MAX_SUBSCRIPTIONS,
    Delivery,
    Subscriptions,
)
from cardan.protocols.rosbridge.forms import EncodedMessage
from cardan.protocols.rosbridge.operations import (
    Advertise,
    AdvertiseService,
    CallService,
    CancelActionGoal,
    Id,
    Publish,
    RefusedOperation,
    SendActionGoal,
    ServiceResponse,
    Subscribe,
    Unadvertise,
    UnadvertiseService,
    Unsubscribe,
)
from cardan.protocols.rosbridge.session import RosbridgeSession

MAX_OFFERED = 100
"""Most services offered by a client."""

MAX_CALLS = 100
"""Most unanswered calls and goals of a client."""

MAX_ASKED = 100
"""Most unanswered requests to a client's services."""

_GOAL_ID_BYTES = 16

_log = logging.getLogger(__name__)


_REFUSALS = (
    RefusedError,
    InterfaceError,
    MessageError,
    RosNameError,
    CdrError,
    NetworkError,
    CallError,
)


class _Subscribed(NamedTuple):
    stream: ClientStream
    subscription: RosbridgeSubscription
    latched: bool


class _Offered(NamedTuple):
    """A service offered by the client."""

    type: str
    handle: Handle


class _Asked(NamedTuple):
    """A request to the client that it has not answered."""

    service: str
    type: str
    answered: Answered
    timer: asyncio.TimerHandle


class _Goal:
    """A goal of the client without a result yet."""

    def __init__(
        self, name: Id, action: str, goal_id: bytes, accepted: asyncio.Future[Message]
    ) -> None:
        """`name`: the client's id of it; `goal_id`: the server's."""
        self.name, self.action, self.goal_id = name, action, goal_id
        self.accepted = accepted
        """The server's response to it."""
        self.canceled = False
        """True once the client has canceled it."""


class RosbridgeClient:
    """A connected client, in a loop; leaving the ``async with`` releases all of its endpoints."""

    def __init__(
        self,
        connection: ListenerConnection,
        peer: str,
        network: Network,
        caller: ServiceCaller,
        rosapi: RosApi,
        subscriptions: RosbridgeSubscriptions,
        mailbox: Mailbox,
        allowed: Allowed,
        counts: Counter[str],
        *,
        lasting: ServiceCaller,
        max_bytes: int,
        service_timeout_s: float,
    ) -> None:
        """`lasting` calls on the network that outlives `network`, the client's own part of it.
        `max_bytes`: limit of an operation in fragments, and of unread answers."""
        self.connection, self.peer = connection, peer
        self.sender: SendLoop[Delivery, EncodedMessage] = SendLoop(
            connection, peer, max_bytes, counts, self._encoded
        )
        self._network, self._caller, self._rosapi = network, caller, rosapi
        self._shared_subscriptions, self._mailbox, self._allowed, self._counts = (
            subscriptions,
            mailbox,
            allowed,
            counts,
        )
        self._lasting = lasting
        self._service_timeout_s = service_timeout_s
        self._session = RosbridgeSession(max_bytes)
        self._loop = asyncio.get_running_loop()
        self._subscriptions = Subscriptions()
        self._subscribed: dict[str, _Subscribed] = {}
        self._advertised = Advertisements(network, allowed)
        self._offered: dict[str, _Offered] = {}
        self._asked: dict[str, _Asked] = {}
        self._asked_before = 0
        self._goals: dict[Id, _Goal] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._gone = False
        self._warned = False

    async def __aenter__(self) -> RosbridgeClient:
        await self.sender.__aenter__()
        return self

    async def __aexit__(self, *_exception: object) -> None:
        self._leave()
        await self.sender.__aexit__()

    # -- to the client ---------------------------------------------------------------------------

    def send(self, *frames: forms.Frame) -> None:
        """Send a control frame: at once, or before all waiting publications."""
        self.sender.send(*frames)

    def _encoded(self, stream: ClientStream, sample: EncodedMessage) -> tuple[forms.Frame, ...]:
        subscribed = self._subscribed.get(stream.topic)
        return () if subscribed is None else subscribed.subscription.encoded(sample, stream)

    def _refuse(self, refused: RefusedOperation) -> None:
        """Report the reason: in the answer if the operation has one, and as a status."""
        self._counts["refused"] += 1
        level = logging.DEBUG if self._warned else logging.WARNING
        self._warned = True
        _log.log(level, "%s: %s%s", self.peer, refused.op and f"{refused.op}: ", refused.reason)
        if refused.op == "call_service":
            self.send(forms.service_refusal(refused.id, refused.name, refused.reason))
        elif refused.op == "send_action_goal":
            self.send(
                forms.action_refusal(refused.id, refused.name, refused.reason, GoalStatus.ABORTED)
            )
        status = self._session.status("error", refused.id, refused.reason)
        if status is not None:
            self.send(status)

    def tell_refused(self, command: str, reason: str) -> None:
        """Report to the client that an arm has refused its message."""
        if not self._gone:
            self._refuse(RefusedOperation(reason, "publish", None, command))

    # -- from the client -------------------------------------------------------------------------

    def receive(self, frame: forms.Frame) -> None:
        """Handle a frame; an impossible request is refused with a reason."""
        asked = self._session.receive(frame, self._loop.time())
        if asked is None:
            return
        if isinstance(asked, RefusedOperation):
            self._refuse(asked)
            return
        op, handle, name = _HANDLERS[type(asked)]
        try:
            handle(self, asked)
        except _REFUSALS as error:
            self._refuse(RefusedOperation(str(error), op, asked.id, getattr(asked, name)))

    # -- topics ----------------------------------------------------------------------------------

    def _subscribe(self, asked: Subscribe) -> None:
        topic = self._advertised.topic(asked.topic)
        if len(self._subscriptions) >= MAX_SUBSCRIPTIONS:
            raise RefusedError(f"there are {MAX_SUBSCRIPTIONS} subscriptions; no more are taken")
        before = self._subscribed.get(asked.topic)
        known = self._network.topics().get(topic)
        present = before.subscription.type if before else known.type if known else ""
        present = present or (LOG if topic == ROSOUT else "")
        type_name: str | None = agreed_type(topic, asked.type, present)
        if not type_name:
            if asked.compression != "cbor-raw":
                raise RefusedError(f"{topic}: no node has this topic yet; give its type")
            type_name = None
        elif asked.compression != "cbor-raw":
            message_type(type_name)
        latched = known is not None and known.latched
        delivery = _whole(self._subscriptions.add(asked), latched)
        if before is not None:
            before.stream.delivery = delivery
            if not latched and before.subscription.type == type_name:
                return
        stream = before.stream if before else TopicQueue(asked.topic, delivery)
        try:
            subscription = self._shared_subscriptions.join(
                topic, type_name, latched, stream, self.sender
            )
        except NetworkError:
            self._subscriptions.remove(Unsubscribe(asked.id, asked.topic))
            raise
        if before is not None:
            self._shared_subscriptions.leave(before.subscription, stream)
        self._subscribed[asked.topic] = _Subscribed(stream, subscription, latched)

    def _unsubscribe(self, asked: Unsubscribe) -> None:
        delivery = self._subscriptions.remove(asked)
        subscribed = self._subscribed.get(asked.topic)
        if subscribed is None:
            return
        if delivery is not None:
            subscribed.stream.delivery = _whole(delivery, subscribed.latched)
            return
        del self._subscribed[asked.topic]
        self._shared_subscriptions.leave(subscribed.subscription, subscribed.stream)
        self.sender.outbox.forget(subscribed.stream)

    def _advertise(self, asked: Advertise) -> None:
        topic = self._advertised.topic(asked.topic)
        self._advertised.add(topic, asked.type, asked.latch, asked.id)

    def _unadvertise(self, asked: Unadvertise) -> None:
        self._advertised.remove(checked_name(asked.topic), asked.id)

    def _publish(self, asked: Publish) -> None:
        topic = self._advertised.topic(asked.topic)
        if is_stale(topic, self.connection.waited_s):
            self._counts["stale"] += 1
            return
        advertised = self._advertised.get(topic)
        if advertised is None:
            if not (asked.type or self._advertised.type_of(topic)):
                raise RefusedError(f"{topic} has no type yet: advertise it before you publish")
            advertised = self._advertised.add(topic, asked.type, asked.latch, None)
        since_ns = self.connection.since_ns
        message = completed(advertised.type, asked.message, Stamp.of_ns(since_ns))
        advertised.publisher.publish(codec_of(advertised.type).encode(message), since_ns)

    # -- services --------------------------------------------------------------------------------

    def _call_service(self, asked: CallService) -> None:
        service = self._service(asked.service, offered=False)
        self._check_calls()
        if service in ROSAPI_SERVICES:  # rosapi moves no arm.
            request = service_type(ROSAPI_SERVICES[service]).request
            args = _by_name(request, asked.args)
            answer = partial(self._rosapi.answer, service, args)
            self._start(self._answer(asked, ROSAPI_SERVICES[service], answer))
            return
        known = self._network.services().get(service)
        if known is None:
            raise RefusedError(f"Service {asked.service} does not exist")
        if known.type not in READING_SERVICES:
            self._check_fresh(service)
        if not self._allowed.call(known.type):
            raise RefusedError(f"{service}: use rosapi for the parameters that clients may use")
        request = service_type(known.type).request
        whole = completed(request, _by_name(request, asked.args), Stamp.of_ns(time.time_ns()))
        timeout_s = asked.timeout_s or self._service_timeout_s
        future = self._caller.start(service, known.type, whole, timeout_s)
        task = self._start(self._answer(asked, known.type, lambda: future))
        task.add_done_callback(lambda _task: future.cancel())

    async def _answer(
        self, asked: CallService, type_name: str, answer: Callable[[], Awaitable[Message]]
    ) -> None:
        try:
            response = await answer()
            frames = forms.service_response(
                asked.id,
                asked.service,
                f"{type_name}_Response",
                response,
                asked.compression,
                asked.fragment_size,
            )
        except _REFUSALS as error:
            self._refuse(RefusedOperation(str(error), "call_service", asked.id, asked.service))
            return
        self.send(*frames)

    def _advertise_service(self, asked: AdvertiseService) -> None:
        service = self._service(asked.service, offered=True)
        type_name = service_type(full_name(asked.type, "srv")).name
        if service in self._offered:
            self._stop_offering(service)
        elif service in self._network.services():
            raise RefusedError(f"{service} is already offered by another client")
        if len(self._offered) >= MAX_OFFERED:
            raise RefusedError(f"{MAX_OFFERED} services are offered; no more are taken")

        def hear(request: bytes, answered: Answered) -> None:
            self._mailbox.put(partial(self._ask, service, asked, request, answered))

        handle = self._network.serve(service, type_name, hear)
        self._offered[service] = _Offered(type_name, handle)

    def _unadvertise_service(self, asked: UnadvertiseService) -> None:
        service = checked_name(asked.service)
        if service not in self._offered:
            raise RefusedError(f"{service} is not offered by this client")
        self._stop_offering(service)

    def _stop_offering(self, service: str) -> None:
        self._offered.pop(service).handle.close()
        for identity in [each for each, asked in self._asked.items() if asked.service == service]:
            self._answered(identity, Failure(f"{service} is offered no longer"))

    def _ask(
        self, service: str, advertised: AdvertiseService, data: bytes, answered: Answered
    ) -> None:
        """Pass a request on to the client."""
        offered = self._offered.get(service)
        if offered is None:
            answered(Failure(f"{service} is offered no longer"))
            return
        kind = service_type(offered.type)
        request = codec_of(kind.request).decode(data)
        if isinstance(request, MalformedCdr):
            self._counts["unreadable"] += 1
            answered(Failure(request.reason))
            return
        if len(self._asked) >= MAX_ASKED:
            answered(Failure(f"{service} has {MAX_ASKED} requests that it did not answer"))
            return
        self._asked_before += 1
        identity = f"call_service:{service}:{self._asked_before}"
        late = Failure(f"{service} gave no answer in {self._service_timeout_s:g} s")
        timer = self._loop.call_later(self._service_timeout_s, self._answered, identity, late)
        self._asked[identity] = _Asked(service, offered.type, answered, timer)
        self.send(
            forms.service_request(
                identity, advertised.service, advertised.type, kind.request, request
            )
        )

    def _service_response(self, asked: ServiceResponse) -> None:
        waiting = self._asked.get(str(asked.id))
        if waiting is None:
            raise RefusedError(f"no request with the id {shown(asked.id)} waits for an answer")
        if not asked.result:
            self._answered(str(asked.id), Failure(f"{waiting.service}: {shown(asked.values)}"))
            return
        response = service_type(waiting.type).response
        try:
            message = completed(response, _by_name(response, asked.values))
            data = codec_of(response).encode(message)
        except (MessageError, CdrError) as error:
            self._answered(str(asked.id), Failure(f"{waiting.service}: {error}"))
            raise
        self._answered(str(asked.id), data)

    def _answered(self, identity: str, answer: bytes | Failure) -> None:
        waiting = self._asked.pop(identity, None)
        if waiting is not None:
            waiting.timer.cancel()
            waiting.answered(answer)

    def _service(self, name: str, *, offered: bool) -> str:
        service = checked_name(name)
        if service in ROSAPI_SERVICES and not offered:
            return service
        if service in ROSAPI_SERVICES or not self._allowed.service(service):
            raise RefusedError(f"{service} is not among the services that clients may use")
        return service

    def _check_fresh(self, name: str) -> None:
        """Raise RefusedError if the client's present request waited too long to act on."""
        waited_s = self.connection.waited_s
        if is_stale(name, waited_s):
            self._counts["stale"] += 1
            raise RefusedError(stale_words(name, waited_s))

    def _check_calls(self) -> None:
        if len(self._tasks) >= MAX_CALLS:
            raise RefusedError(f"{MAX_CALLS} calls have no answer yet; no more are taken")

    def _start(self, coroutine: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        task = self._loop.create_task(coroutine)
        self._tasks.add(task)
        task.add_done_callback(self._ended)
        return task

    def _ended(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (fault := task.exception()) is not None:
            _log.error(
                "%s: answer failed: internal error of this server", self.peer, exc_info=fault
            )

    # -- actions ---------------------------------------------------------------------------------

    def _send_goal(self, asked: SendActionGoal) -> None:
        action = self._service(asked.action, offered=False)
        self._check_fresh(action)
        self._check_calls()
        kind = action_type(full_name(asked.type, "action"))
        if asked.id in self._goals:
            raise RefusedError(f"the goal {shown(asked.id)} is under way")
        known = self._network.services().get(f"{action}/_action/send_goal")
        if known is None:
            raise RefusedError(f"Action {asked.action} does not exist")
        if known.type != kind.send_goal.name:
            found = known.type.removesuffix("_SendGoal")
            raise RefusedError(f"{action} is of type {found}, not {kind.name}")
        goal = completed(kind.goal, _by_name(kind.goal, asked.args), Stamp.of_ns(time.time_ns()))
        goal_id = os.urandom(_GOAL_ID_BYTES)
        listening: Handle | None = None
        if asked.feedback:
            topic = f"{action}/_action/feedback"
            hear = partial(self._hear_feedback, asked, kind.feedback, goal_id)
            listening = self._network.subscribe(topic, kind.feedback, hear)
        try:
            accepted = self._caller.start(
                f"{action}/_action/send_goal",
                kind.send_goal.name,
                {"goal_id": {"uuid": goal_id}, "goal": goal},
                self._service_timeout_s,
            )
        except _REFUSALS:
            if listening is not None:
                listening.close()
            raise
        under_way = self._goals[asked.id] = _Goal(asked.id, action, goal_id, accepted)
        accepted.add_done_callback(lambda _accepted: self._answered_goal(under_way))
        task = self._start(self._follow_goal(asked, action, kind, under_way))

        def ended(_task: asyncio.Task[None]) -> None:
            self._goals.pop(asked.id, None)
            if listening is not None:
                listening.close()

        task.add_done_callback(ended)

    async def _follow_goal(
        self, asked: SendActionGoal, action: str, kind: ActionType, goal: _Goal
    ) -> None:
        try:
            # Shielded: it is waited for also when the client is gone.
            if not (await asyncio.shield(goal.accepted))["accepted"]:
                raise RefusedError(f"{action} did not accept the goal")
            ended = await self._caller.start(
                f"{action}/_action/get_result",
                kind.get_result.name,
                {"goal_id": {"uuid": goal.goal_id}},
                None,
            )
            result, status = ended["result"], ended["status"]
            self.send(forms.action_result(asked.id, asked.action, kind.result, result, status))
        except _REFUSALS as error:
            self._refuse(RefusedOperation(str(error), "send_action_goal", asked.id, asked.action))

    def _hear_feedback(
        self, asked: SendActionGoal, type_name: str, goal_id: bytes, cdr: bytes, _stamp_ns: int
    ) -> None:
        """Handle feedback. In any thread."""
        name, message = decoded(type_name, cdr)
        if not isinstance(message, MalformedCdr) and message["goal_id"]["uuid"] == goal_id:
            inner = name.removesuffix("Message")
            tell = partial(self._tell_feedback, asked, inner, message["feedback"])
            self._mailbox.put(tell)

    def _tell_feedback(self, asked: SendActionGoal, inner: str, feedback: Message) -> None:
        # While the client does not read, it is left out: the next one has newer figures.
        if asked.id in self._goals and self.sender.free:
            self.send(forms.action_feedback(asked.id, asked.action, inner, feedback))

    def _cancel_goal(self, asked: CancelActionGoal) -> None:
        goal = self._goals.get(asked.id)
        if goal is None:
            raise RefusedError(f"no goal {shown(asked.id)} is under way")
        self._cancel(goal)

    def _answered_goal(self, goal: _Goal) -> None:
        """Cancel an answered goal that was canceled before its server knew it, and a goal whose
        answer was too late, which no client follows."""
        unknown = goal.accepted.exception() is not None
        if unknown or (goal.canceled and goal.accepted.result()["accepted"]):
            self._cancel(goal)

    def _answered_cancel(self, goal: _Goal, answer: asyncio.Future[Message]) -> None:
        """Report that the goal goes on; otherwise its result reports its outcome."""
        error = answer.exception()
        if error is not None:
            self._not_canceled(goal, str(error))
        elif answer.result()["return_code"] == CancelCode.REJECTED:
            self._not_canceled(goal, f"{goal.action} does not cancel this goal")

    def _not_canceled(self, goal: _Goal, reason: str) -> None:
        if self._gone:
            _log.warning("%s: its goal may go on: %s", self.peer, reason)
        else:
            self._refuse(RefusedOperation(reason, "cancel_action_goal", goal.name, goal.action))

    def _cancel(self, goal: _Goal) -> None:
        """Request a cancellation from the action's server at once and, if it has not accepted the
        goal yet, again when it has: until then most servers do not know it. The goal's result shows
        the outcome."""
        goal.canceled = True
        request = {"goal_info": {"goal_id": {"uuid": goal.goal_id}}}
        service = f"{goal.action}/_action/cancel_goal"
        whole = completed(f"{CANCEL_TYPE}_Request", request)
        try:
            answer = self._lasting.start(service, CANCEL_TYPE, whole, self._service_timeout_s)
        except NetworkError as error:
            self._not_canceled(goal, str(error))
        else:
            answer.add_done_callback(partial(self._answered_cancel, goal))

    # -- the end ---------------------------------------------------------------------------------

    def _leave(self) -> None:
        """Remove all endpoints of the client; goals under way are canceled."""
        if self._gone:
            return
        self._gone = True
        self.sender.close()
        for goal in list(self._goals.values()):
            self._cancel(goal)
        for task in list(self._tasks):
            task.cancel()
        for subscribed in self._subscribed.values():
            self._shared_subscriptions.leave(subscribed.subscription, subscribed.stream)
        self._advertised.close()
        for service in list(self._offered):
            self._stop_offering(service)
        self._subscribed.clear()


def _whole(delivery: Delivery, latched: bool) -> Delivery:
    """Return the delivery of a topic's messages to a client; of a latched topic, all of them."""
    depth = max(delivery.queue_length, LATCHED_DEPTH) if latched else delivery.queue_length
    return delivery._replace(queue_length=depth)


def _by_name(type_name: str, args: Any) -> Any:
    """Return a message's fields by name, from a client's object, list in their order, or nothing.
    Raises MessageError."""
    if args is None:
        return {}
    if not isinstance(args, list):
        return args
    names = [each.name for each in message_type(type_name).fields if each.name != DUMMY_MEMBER]
    if len(args) > len(names):
        raise MessageError(
            f"{type_name}: takes {len(names)} values at most ({', '.join(names)}), not {len(args)}"
        )
    return dict(zip(names, args, strict=False))


_HANDLERS: Mapping[type, tuple[str, Callable[[RosbridgeClient, Any], None], str]] = {
    Subscribe: ("subscribe", RosbridgeClient._subscribe, "topic"),
    Unsubscribe: ("unsubscribe", RosbridgeClient._unsubscribe, "topic"),
    Advertise: ("advertise", RosbridgeClient._advertise, "topic"),
    Unadvertise: ("unadvertise", RosbridgeClient._unadvertise, "topic"),
    Publish: ("publish", RosbridgeClient._publish, "topic"),
    CallService: ("call_service", RosbridgeClient._call_service, "service"),
    AdvertiseService: ("advertise_service", RosbridgeClient._advertise_service, "service"),
    UnadvertiseService: ("unadvertise_service", RosbridgeClient._unadvertise_service, "service"),
    ServiceResponse: ("service_response", RosbridgeClient._service_response, "service"),
    SendActionGoal: ("send_action_goal", RosbridgeClient._send_goal, "action"),
    CancelActionGoal: ("cancel_action_goal", RosbridgeClient._cancel_goal, "action"),
}
"""Name, handler and subject field of each operation."""
