"""Operations of a page beside rosbridge: its operator frames, their channels, and its clock.

Text messages are rosbridge's, except operations that begin with "cardan." and the message of the
public page `teleop`; binary messages are operator frames. docs/phone.md has the operations.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections import Counter, deque
from collections.abc import Awaitable, Callable, Coroutine, Mapping, Sequence
from functools import partial
from typing import Any, Final

from cardan import __version__
from cardan.bus.network import Handle, Network, NetworkError, PublisherHandle
from cardan.common.clocks import RemoteClock
from cardan.common.troubles import codes_of
from cardan.errors import shown
from cardan.gateway.arm.validation import LONGEST_NAME
from cardan.gateway.servers.allow_list import Allowed
from cardan.gateway.servers.calls import Mailbox, ServiceCaller
from cardan.gateway.servers.console.cameras import UNSHOWN_S, Camera, Cameras, Unshown
from cardan.gateway.servers.console.channels import (
    FRAME_TYPE,
    IMU_TYPE,
    JOY_TYPE,
    ArmChannel,
    Channel,
    DeviceChannel,
    ImuChannel,
    JoyChannel,
    SharedPublisher,
)
from cardan.gateway.servers.console.commands import OrderError, carry_out, words_of
from cardan.gateway.servers.console.demos import Demos
from cardan.gateway.servers.console.hold_to_run import FRESH_S, LONGEST_S, Hold
from cardan.gateway.servers.console.jog import ASK_SERVICE, ArmJog, why_no_arm
from cardan.gateway.servers.console.records import OpenRecord, Records, RecordsError
from cardan.gateway.servers.publishing import RefusedError
from cardan.gateway.servers.tokens import Role
from cardan.protocols.handheld.frames import (
    MalformedFrame,
    OperatorFrame,
    decode_frame,
    encode_frame,
)
from cardan.protocols.handheld.teleop import TeleopLog, decode_teleop
from cardan.protocols.rate import RateLimit
from cardan.protocols.ros2.cdr import MalformedCdr, codec_of
from cardan.protocols.ros2.messages import Stamp
from cardan.protocols.ros2.names import RosNameError, checked_name
from cardan.protocols.rosbridge.forms import Frame, object_text

FEEDBACK_TYPE: Final = "sensor_msgs/msg/JoyFeedback"

REQUEST_TOPIC: Final = "authority/request"
REQUEST_TYPE: Final = "cardan_msgs/msg/AuthorityRequest"
"""Type of the requests, below an arm's node, to its owner for the authority over it."""

REFUSED: Final = "refused"
"""Answer of an owner that keeps the authority; giving it up is visible to all."""

PERIOD_S: Final = 0.5
"""Period of reading a page's clock, and of sending figures to it."""

MOST_FRAMES_PER_S: Final = 500
"""Highest frame rate of a page; two hands at 120 Hz need half of it."""

MOST_CHANNELS: Final = 16

TELEOP_CHANNEL: Final = 255
TELEOP_TOPIC: Final = "/xr"
"""Topic of the poses of a page of `teleop`, which opens no channel."""

MOST_PERSON: Final = 30
"""Most characters of a person's name."""

MOST_TEXT: Final = 4096
"""Most characters of an operation."""

MOST_MESSAGE: Final = 1000
"""Most characters of a message whose codes are requested."""

_RATE_S: Final = 1.0
"""Time over which the rate of frames is measured."""


async def _whole(action: Coroutine[Any, Any, None]) -> None:
    """Finish an action even if the page that requested it leaves meanwhile."""
    task = asyncio.ensure_future(action)
    task.add_done_callback(lambda done: done.cancelled() or done.exception())
    await asyncio.shield(task)


async def _at_once() -> None:
    """Return at once."""


class FrameStatistics:
    """Statistics of a page's frames, for display on it."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        """Counts of frames that were not read: "malformed", "too many"."""
        self._times_s: deque[float] = deque(maxlen=MOST_FRAMES_PER_S)
        self.age_s: float | None = None
        """Age of the newest frame, s."""

    def record(self, now_s: float, age_s: float | None) -> None:
        """Record a frame."""
        self._times_s.append(now_s)
        self.age_s = age_s

    def rate_hz(self, now_s: float) -> float:
        """Return the number of frames in the last second."""
        while self._times_s and now_s - self._times_s[0] > _RATE_S:
            self._times_s.popleft()
        return len(self._times_s) / _RATE_S


class PageOperator:
    """Operator of a page: ``async with PageOperator(...) as one: one.receive(frame, waited_s)``."""

    def __init__(
        self,
        network: Network,
        caller: ServiceCaller,
        mailbox: Mailbox,
        allowed: Allowed,
        role: Role,
        source: str,
        send: Callable[[str | bytes], None],
        counts: Counter[str],
        calm: Callable[[], Awaitable[None]] = _at_once,
        records: Records | None = None,
        cameras: Cameras | None = None,
        demos: Demos | None = None,
        hold_s: float = LONGEST_S,
    ) -> None:
        """`source`: name of this page in the authority of arms, two words; the person's name comes
        between them if the page gives one. `counts`: the server's; `calm` waits until the page has
        read all messages; `records`, `cameras`, `demos`: of this machine; `hold_s`: longest jogging
        of an arm without a sign of the person."""
        self.source = self._nameless = source
        self.clock = RemoteClock()
        self.figures = FrameStatistics()
        self.channels: dict[int, Channel] = {}
        self._network, self._caller, self._mailbox = network, caller, mailbox
        self._allowed, self._role, self._send, self._counts = allowed, role, send, counts
        self._loop = asyncio.get_running_loop()
        self._rate = RateLimit(MOST_FRAMES_PER_S)
        self._timers: dict[int, asyncio.TimerHandle] = {}
        self._hold_s = hold_s
        self._teleop_frames = 0
        self._publishers: dict[tuple[str, str], SharedPublisher] = {}
        self._task: asyncio.Task[None] | None = None
        self._closing: set[asyncio.Task[None]] = set()
        self._orders: set[asyncio.Task[None]] = set()
        self._viewer_informed = False
        self._requests: dict[str, PublisherHandle] = {}
        """Publishers of requests for the authority, by topic."""
        self._calm, self._records = calm, records
        self._shown: OpenRecord | None = None
        self._cameras = Cameras(()) if cameras is None else cameras
        self._demos = Demos() if demos is None else demos
        self._watching: asyncio.Task[None] | None = None
        self._unshown: Unshown | None = None
        self._picture = 0
        """Number of the newest picture that was sent, of any camera."""

    async def __aenter__(self) -> PageOperator:
        self._task = self._loop.create_task(self._tell())
        return self

    async def __aexit__(self, *_exception: object) -> None:
        if self._task is not None:
            self._task.cancel()
        for timer in self._timers.values():
            timer.cancel()
        for order in self._orders:
            order.cancel()
        for publisher in self._requests.values():
            publisher.close()
        if self._watching is not None:
            self._watching.cancel()
        channels, self.channels = list(self.channels.values()), {}
        ends = [*(each.close() for each in channels), *self._closing]
        if self._shown is not None:
            ends.append(self._shown.close())
        await asyncio.gather(*ends, return_exceptions=True)

    # -- from the page ---------------------------------------------------------------------------

    def receive(self, data: Frame, waited_s: float) -> bool:
        """Handle a frame that waited at the socket; return False if it is rosbridge's."""
        if isinstance(data, bytes):
            self._operate(data)
            return True
        if len(data) > MOST_TEXT:
            return False
        if '"cardan.' in data:
            return self._asked(data)
        pose = decode_teleop(data)
        if pose is None:
            return False
        if isinstance(pose, MalformedFrame):
            self._malformed(pose.reason)
        elif not isinstance(pose, TeleopLog):
            self._teleop_frames += 1
            now_s = self._loop.time()
            number, time_us = self._teleop_frames % 2**32, int(now_s * 1e6)
            frame = pose.frame(number, time_us, TELEOP_CHANNEL)
            self._teleop(frame, now_s - waited_s, now_s)
        return True

    def _operate(self, data: bytes) -> None:
        now_s = self._loop.time()
        if self._rate.exceeded(now_s):
            self._drop("too many")
            return
        frame = decode_frame(data)
        if isinstance(frame, MalformedFrame):
            self._malformed(frame.reason)
            return
        made_s = self.clock.here_s(1e-6 * frame.time_us)
        self.figures.record(now_s, None if made_s is None else now_s - made_s)
        self._take(frame, data, made_s, now_s)

    def _teleop(self, frame: OperatorFrame, made_s: float, now_s: float) -> None:
        if TELEOP_CHANNEL not in self.channels:
            try:
                self._open(TELEOP_CHANNEL, {"device": TELEOP_TOPIC})
            except (RefusedError, RosNameError, NetworkError) as error:
                self._refuse(str(error))
                return
        self.figures.record(now_s, None)
        self._take(frame, encode_frame(frame), made_s, now_s)

    def _take(self, frame: OperatorFrame, data: bytes, made_s: float | None, now_s: float) -> None:
        channel = self.channels.get(frame.channel)
        if channel is None:
            if self._role < Role.OPERATOR:
                if not self._viewer_informed:
                    self._viewer_informed = True
                    self._refuse(_VIEWER)
            else:
                self._drop("without a channel")
            return
        counted = sum(channel.hold.counts.values())
        try:
            channel.take(frame, data, made_s, now_s)
        except RefusedError as error:
            self._malformed(str(error))
            return
        self._counts["frames"] += 1
        self._counts["frames dropped"] += sum(channel.hold.counts.values()) - counted
        self._watch(frame.channel, channel)
        self._tell_channel(frame.channel, channel, now_s, only_news=True)

    def _watch(self, number: int, channel: Channel) -> None:
        """End the hold in time unless a frame arrives."""
        if (timer := self._timers.pop(number, None)) is not None:
            timer.cancel()
        until_s = channel.hold.until_s
        if until_s is not None:
            self._timers[number] = self._loop.call_at(until_s, self._lapsed, number, channel)

    def _lapsed(self, number: int, channel: Channel) -> None:
        self._timers.pop(number, None)
        # A timer of the loop may come a clock tick early.
        self._look(number, channel, channel.hold.until_s or 0.0)

    def _look(self, number: int, channel: Channel, at_s: float = 0.0) -> None:
        """End the hold if its time is over, now or at `at_s`."""
        now_s = self._loop.time()
        if channel.hold.look(max(now_s, at_s)):
            channel.lapse()
            self._tell_channel(number, channel, now_s)

    def _drop(self, what: str) -> None:
        self.figures.counts[what] += 1
        self._counts["frames dropped"] += 1

    def _malformed(self, why: str) -> None:
        self._drop("malformed")
        if self.figures.counts["malformed"] == 1:
            self._refuse(f"frames {why}" if not why.startswith("channel") else why)

    # -- operations ------------------------------------------------------------------------------

    def _asked(self, text: str) -> bool:
        try:
            table = json.loads(text)
        except (ValueError, RecursionError):
            return False
        op = table.get("op") if isinstance(table, dict) else None
        if not isinstance(op, str) or not op.startswith("cardan."):
            return False
        identity = table.get("id")
        if not isinstance(identity, (str, int)):
            identity = None
        try:
            do = _OPERATIONS.get(op)
            if do is None:
                raise RefusedError(f"there is no operation {shown(op)}")
            do(self, table, identity)
        except (RefusedError, RosNameError, NetworkError) as error:
            self._counts["refused"] += 1
            self._refuse(str(error), identity, op)
        return True

    def _refuse(self, why: str, identity: str | int | None = None, asked: str = "") -> None:
        self._send(object_text(op="cardan.refused", id=identity, asked=asked or None, why=why))

    def _hello(self, table: Mapping[str, Any], identity: str | int | None) -> None:
        # A source that moves an arm keeps its name.
        if "name" in table and not self.channels:
            name = table["name"]
            if not isinstance(name, str) or len(name) > MOST_PERSON or not name.isprintable():
                raise RefusedError(
                    f"name is {shown(name)}, must have at most {MOST_PERSON} printable characters"
                )
            what, _, peer = self._nameless.partition(" ")
            room = LONGEST_NAME - len(self._nameless) - 1
            self.source = " ".join(filter(None, (what, name.strip()[:room].strip(), peer)))
        self._send(
            object_text(
                op="cardan.hello",
                id=identity,
                version=__version__,
                role=self._role.word,
                source=self.source,
                fresh_ms=1e3 * FRESH_S,
                server_us=self._now_us(),
            )
        )

    def _ping(self, table: Mapping[str, Any], identity: str | int | None) -> None:
        page = table.get("page_us")
        self._send(
            object_text(op="cardan.pong", id=identity, page_us=page, server_us=self._now_us())
        )

    def _pong(self, table: Mapping[str, Any], _identity: str | int | None) -> None:
        asked, page = _number(table, "server_us"), _number(table, "page_us")
        self.clock.heard(1e-6 * asked, 1e-6 * page, self._loop.time())

    def _open_channel(self, table: Mapping[str, Any], identity: str | int | None) -> None:
        number = table.get("channel")
        if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number <= 255:
            raise RefusedError(f"channel is {shown(number)}, must be 0 to 255")
        channel = self.channels.get(number)
        if isinstance(channel, ArmChannel) and table.get("arm") == channel.target:
            # Closing it would give up the authority that the page has just taken for it.
            channel.lapse()
            channel.hold = Hold(self._hold_s)
            self._watch(number, channel)
        else:
            self._end(number)
            if len(self.channels) >= MOST_CHANNELS:
                raise RefusedError(f"{MOST_CHANNELS} channels are open; close one first")
            channel = self._open(number, table)
        self._send(
            object_text(op="cardan.opened", id=identity, channel=number, target=channel.target)
        )
        self._tell_channel(number, channel, self._loop.time())

    def _open(self, number: int, table: Mapping[str, Any]) -> Channel:
        if self._role < Role.OPERATOR:
            raise RefusedError(_VIEWER)
        given = [key for key in _TARGETS if isinstance(table.get(key), str)]
        if len(given) != 1:
            raise RefusedError(
                f"a channel is opened for one of {', '.join(_TARGETS)}: give an arm by the full "
                "name of its node, another one by its topic"
            )
        (key,) = given
        self.channels[number] = channel = _TARGETS[key](self, number, checked_name(table[key]))
        return channel

    def _arm_channel(self, number: int, arm: str) -> Channel:
        if not self._allowed.service(f"{arm}/{ASK_SERVICE}"):
            raise RefusedError(f"{arm} is not among what clients may use")
        if why := why_no_arm(arm, self._network.services()):
            raise RefusedError(why)
        jog = ArmJog(arm, self.source, self._caller, partial(self._not_taken, number))
        return ArmChannel(jog, self._hold_s)

    def _device_channel(self, number: int, topic: str) -> Channel:
        return DeviceChannel(topic, *self._both_ways(number, topic, FRAME_TYPE, "feedback"))

    def _joy_channel(self, number: int, topic: str) -> Channel:
        return JoyChannel(topic, *self._both_ways(number, topic, JOY_TYPE, "set_feedback"))

    def _imu_channel(self, number: int, topic: str) -> Channel:
        if not self._allowed.topic(topic):
            raise RefusedError(f"{topic} is not among the topics that clients may use")
        return ImuChannel(topic, self._publisher(topic, IMU_TYPE))

    def _both_ways(
        self, number: int, topic: str, type_name: str, back: str
    ) -> tuple[PublisherHandle, Handle]:
        """Return the publisher of a topic, and the subscription to the driver's feedback."""
        if not self._allowed.topic(topic):
            raise RefusedError(f"{topic} is not among the topics that clients may use")
        publisher = self._publisher(topic, type_name)
        codec = codec_of(FEEDBACK_TYPE)

        def heard(cdr: bytes, _stamp_ns: int) -> None:
            message = codec.decode(cdr)
            if not isinstance(message, MalformedCdr):
                self._mailbox.put(partial(self._feel, number, message["intensity"]))

        try:
            feedback = self._network.subscribe(f"{topic}/{back}", FEEDBACK_TYPE, heard)
        except NetworkError:
            publisher.close()
            raise
        return publisher, feedback

    def _publisher(self, topic: str, type_name: str) -> SharedPublisher:
        key = topic, type_name
        if key not in self._publishers:
            self._publishers[key] = SharedPublisher(
                self._network.advertise(topic, type_name, False),
                lambda: self._publishers.pop(key, None),
            )
        return self._publishers[key].used()

    def _renew(self, table: Mapping[str, Any], _identity: str | int | None) -> None:
        """Renew a hold: the person is present."""
        number = table.get("channel")
        if not isinstance(number, int) or number not in self.channels:
            raise RefusedError(f"channel {shown(number)} is not open")
        channel = self.channels[number]
        # A frame that came too late renews nothing.
        self._look(number, channel)
        channel.hold.renew(self._loop.time())
        self._watch(number, channel)

    def _close_channel(self, table: Mapping[str, Any], _identity: str | int | None) -> None:
        number = table.get("channel")
        if number not in self.channels:
            raise RefusedError(f"channel {shown(number)} is not open")
        self._end(int(number))

    def _end(self, number: int) -> None:
        if (timer := self._timers.pop(number, None)) is not None:
            timer.cancel()
        channel = self.channels.pop(number, None)
        if channel is not None:
            self._finish(channel.close())

    def _finish(self, closing: Coroutine[Any, Any, None]) -> None:
        task = self._loop.create_task(closing)
        self._closing.add(task)
        task.add_done_callback(self._closing.discard)

    def _not_taken(self, number: int, why: str) -> None:
        """Handle the arm's refusal of a hold's request."""
        channel = self.channels.get(number)
        if channel is not None:
            channel.hold.lose(why)
            channel.lapse()
            self._watch(number, channel)
            self._tell_channel(number, channel, self._loop.time())

    def _ask_authority(self, table: Mapping[str, Any], _identity: str | int | None) -> None:
        """Request the authority over an arm from its owner."""
        self._tell_authority(table, self.source, _name(table, "owner"), "")

    def _keep_authority(self, table: Mapping[str, Any], _identity: str | int | None) -> None:
        """Refuse the authority to a source that requested it."""
        self._tell_authority(table, _name(table, "source"), self.source, REFUSED)

    def _tell_authority(
        self, table: Mapping[str, Any], source: str, owner: str, answer: str
    ) -> None:
        if self._role < Role.OPERATOR:
            raise RefusedError(_VIEWER)
        arm = checked_name(_name(table, "arm"))
        topic = f"{arm}/{REQUEST_TOPIC}"
        if not self._allowed.topic(topic):
            raise RefusedError(f"{topic} is not among the topics that clients may use")
        publisher = self._requests.get(topic)
        if publisher is None:
            if why := why_no_arm(arm, self._network.services()):
                raise RefusedError(why)
            publisher = self._network.advertise(topic, REQUEST_TYPE, False)
            self._requests[topic] = publisher
        stamp = Stamp.of_ns(time.time_ns())
        message = {
            "header": {"stamp": stamp._asdict(), "frame_id": ""},
            "source": source,
            "owner": owner,
            "answer": answer,
        }
        publisher.publish(codec_of(REQUEST_TYPE).encode(message))

    def _codes(self, table: Mapping[str, Any], identity: str | int | None) -> None:
        """Send the codes of a message that the page shows: `cardan explain` explains them."""
        text = table.get("text")
        if not isinstance(text, str) or len(text) > MOST_MESSAGE:
            raise RefusedError(f"text is {shown(text)}; allowed: up to {MOST_MESSAGE} characters")
        self._send(object_text(op="cardan.codes", id=identity, codes=codes_of(text)))

    def _order(self, table: Mapping[str, Any], identity: str | int | None) -> None:
        """Carry out an order by the daemon."""
        if self._role < Role.OPERATOR:
            raise RefusedError("a viewer may not command: connect with the token of an operator")
        if self._orders:
            raise RefusedError("wait: the previous command has not finished")
        try:
            words = words_of(table.get("do"), table.get("name"))
        except OrderError as error:
            raise RefusedError(str(error)) from None
        self._begin(self._carry_out(words, str(table.get("do")), identity))

    def _begin(self, order: Coroutine[Any, Any, None]) -> None:
        task = self._loop.create_task(order)
        self._orders.add(task)
        task.add_done_callback(self._orders.discard)

    async def _carry_out(self, words: Sequence[str], do: str, identity: str | int | None) -> None:
        try:
            result = await carry_out(words)
        except (OrderError, OSError) as error:
            self._refuse(str(error), identity, "cardan.daemon")
            return
        self._send(object_text(op="cardan.daemon", id=identity, do=do, result=result))

    def _demo(self, table: Mapping[str, Any], identity: str | int | None) -> None:
        """List the demos, start one, or end it."""
        do = table.get("do")
        if do not in ("list", "start", "stop"):
            raise RefusedError(f"do is {shown(do)}; allowed: list, start, stop")
        if self._role < Role.OPERATOR:
            raise RefusedError("a viewer may not start it: connect with the token of an operator")
        if self._orders:
            raise RefusedError("wait: the previous command has not finished")
        self._begin(self._do_demo(do, table.get("name"), identity))

    async def _do_demo(self, do: str, name: object, identity: str | int | None) -> None:
        demos = self._demos
        try:
            if do != "list":
                await _whole(demos.start(name) if do == "start" else demos.stop())
            found = await demos.table()
        except (OrderError, OSError) as error:
            self._refuse(str(error), identity, "cardan.demo")
            return
        self._send(object_text(op="cardan.demo", id=identity, **found))

    # -- records ---------------------------------------------------------------------------------

    def _stored(self) -> Records:
        if self._records is None:
            raise RefusedError("this server keeps no records: it has no folder for them")
        return self._records

    def _ask_records(self, table: Mapping[str, Any], identity: str | int | None) -> None:
        """List the records, begin one, or end it."""
        records, do = self._stored(), table.get("do")
        if do == "list":
            self._tell_records(records, identity)
            return
        if do not in ("record", "finish"):
            raise RefusedError(f"do is {shown(do)}; allowed: list, record, finish")
        if self._role < Role.OPERATOR:
            raise RefusedError("a viewer may not record: connect with the token of an operator")
        if self._orders:
            raise RefusedError("wait: the previous command has not finished")
        action = records.record if do == "record" else records.finish
        self._begin(self._record(action, records, identity))

    async def _record(
        self,
        action: Callable[[], Coroutine[Any, Any, None]],
        records: Records,
        identity: str | int | None,
    ) -> None:
        try:
            await _whole(action())
        except RecordsError as error:
            self._refuse(str(error), identity, "cardan.records")
            return
        self._tell_records(records, identity)

    def _tell_records(self, records: Records, identity: str | int | None) -> None:
        self._send(object_text(op="cardan.records", id=identity, **records.table()))

    def _replay(self, table: Mapping[str, Any], _identity: str | int | None) -> None:
        """Show a record to this page only."""
        do = table.get("do")
        if do == "order" and self._shown is not None:
            self._shown.order(table)
        elif do in ("open", "close"):
            if self._shown is not None:
                self._finish(self._shown.close())
                self._shown = None
            if do == "open":
                self._shown = self._show(table.get("name"))
        else:
            raise RefusedError(
                "no record is shown; open one first"
                if do == "order"
                else f"do is {shown(do)}; allowed: open, order, close"
            )

    def _show(self, name: object) -> OpenRecord:
        try:
            return OpenRecord(self._stored(), name, self._show_page, self._calm)
        except RecordsError as error:
            raise RefusedError(str(error)) from None

    def _show_page(self, said: Mapping[str, Any] | str) -> None:
        """Send a table, or the text between the braces of its JSON."""
        if isinstance(said, str):
            self._send(f'{{"op":"cardan.replay",{said}}}')
        else:
            self._send(object_text(op="cardan.replay", **said))

    # -- cameras ---------------------------------------------------------------------------------

    def _camera(self, table: Mapping[str, Any], identity: str | int | None) -> None:
        """List the cameras, or send the pictures of one, each a binary message, until another one
        is requested; take reports of shown pictures."""
        do, number = table.get("do"), table.get("camera")
        if do not in ("list", "open", "shown", "close"):
            raise RefusedError(f"do is {shown(do)}; allowed: list, open, shown, close")
        page_us = _number(table, "page_us") if do == "shown" or "page_us" in table else None
        if do == "shown" and page_us is not None:
            if self._unshown is not None:
                two, now_s = table.get("two") is True, time.monotonic()
                self._unshown.shown(table.get("picture"), page_us, two, now_s)
            return
        camera = self._cameras.camera(number)
        if do == "open" and camera is None:
            raise RefusedError(f"there is no camera {shown(number)}; docs/console.md: camera")
        if do != "list" and self._watching is not None:
            self._watching.cancel()
            self._watching = self._unshown = None
        if do == "open" and camera is not None:
            self._unshown = Unshown(page_us, time.monotonic())
            self._watching = self._loop.create_task(self._watch_camera(camera, self._unshown))
        names = self._cameras.names
        self._send(object_text(op="cardan.camera", id=identity, cameras=names))

    async def _watch_camera(self, camera: Camera, unshown: Unshown) -> None:
        changed, reported, number = asyncio.Event(), "", 0
        try:
            while True:
                camera.watch(changed)
                await changed.wait()
                await self._calm()
                changed.clear()
                if camera.why != reported:
                    reported = camera.why
                    self._send(object_text(op="cardan.camera", why=reported))
                if camera.newest and camera.number != number:
                    number = camera.number
                    self._send_picture(camera, unshown)
                rest = self._loop.call_later(UNSHOWN_S, camera.leave, changed)
                try:
                    await unshown.room.wait()
                finally:
                    rest.cancel()
        finally:
            camera.leave(changed)

    def _send_picture(self, camera: Camera, unshown: Unshown) -> None:
        """Send a picture, its description first, which arrives before a slow link has carried the
        rest."""
        self._picture += 1
        now_s = time.monotonic()
        self._send(
            object_text(
                op="cardan.camera",
                picture=self._picture,
                age_us=_us(now_s - camera.newest_s),
                page_us=unshown.page_us,
                held_us=_us(unshown.held_s(now_s)),
            )
        )
        self._send(camera.newest)
        unshown.sent(self._picture)

    # -- to the page -----------------------------------------------------------------------------

    def _feel(self, number: int, intensity: float) -> None:
        if number in self.channels:
            self._send(object_text(op="cardan.feedback", channel=number, intensity=intensity))

    async def _tell(self) -> None:
        """Request the page's time, and send its figures."""
        while True:
            self._send(object_text(op="cardan.ping", server_us=self._now_us()))
            await asyncio.sleep(PERIOD_S)
            now_s = self._loop.time()
            for number, channel in self.channels.items():
                self._tell_channel(number, channel, now_s)

    def _tell_channel(
        self, number: int, channel: Channel, now_s: float, only_news: bool = False
    ) -> None:
        hold, figures = channel.hold, self.figures
        news = hold.grip, hold.why
        if only_news and news == channel.reported:
            return
        channel.reported = news
        self._send(
            object_text(
                op="cardan.input",
                channel=number,
                grip=hold.grip.value,
                why=hold.why,
                rate_hz=figures.rate_hz(now_s),
                age_ms=_ms(figures.age_s),
                round_ms=_ms(self.clock.round_s),
                round_median_ms=_ms(self.clock.median_s),
                dropped={**hold.counts, **figures.counts},
                left_s=hold.left_s(now_s),
            )
        )

    def _now_us(self) -> int:
        return int(self._loop.time() * 1e6)


_VIEWER: Final = "a viewer may not move an arm: connect with the token of an operator"

_TARGETS: Final[Mapping[str, Callable[[PageOperator, int, str], Channel]]] = {
    "arm": PageOperator._arm_channel,
    "device": PageOperator._device_channel,
    "joy": PageOperator._joy_channel,
    "imu": PageOperator._imu_channel,
}

_OPERATIONS: Final[
    Mapping[str, Callable[[PageOperator, Mapping[str, Any], str | int | None], None]]
] = {
    "cardan.hello": PageOperator._hello,
    "cardan.ping": PageOperator._ping,
    "cardan.pong": PageOperator._pong,
    "cardan.open": PageOperator._open_channel,
    "cardan.renew": PageOperator._renew,
    "cardan.close": PageOperator._close_channel,
    "cardan.ask": PageOperator._ask_authority,
    "cardan.keep": PageOperator._keep_authority,
    "cardan.codes": PageOperator._codes,
    "cardan.daemon": PageOperator._order,
    "cardan.demo": PageOperator._demo,
    "cardan.records": PageOperator._ask_records,
    "cardan.replay": PageOperator._replay,
    "cardan.camera": PageOperator._camera,
}


def _name(table: Mapping[str, Any], key: str) -> str:
    value = table.get(key)
    if not isinstance(value, str) or not 0 < len(value) <= LONGEST_NAME or not value.isprintable():
        raise RefusedError(f"{key} is {shown(value)}, must be a name")
    return value


def _number(table: Mapping[str, Any], key: str) -> float:
    value = table.get(key)
    if not isinstance(value, (int, float)) or isinstance(value, bool) or not 0 <= value < 2**53:
        raise RefusedError(f"{key} is {shown(value)}, must be a time in µs")
    return float(value)


def _us(seconds: float) -> int:
    return int(1e6 * seconds)


def _ms(seconds: float | None) -> float | None:
    return None if seconds is None else round(1e3 * seconds, 1)
