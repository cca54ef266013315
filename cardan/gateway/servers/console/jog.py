"""Streams a page's jog commands to an arm, as a source of its own name, by the arm's `ask`.

A single request is under way at a time, and after it the newest command is sent: nothing waits in a
queue. The arm's own controller limits, checks and refuses; a refusal ends the hold, except for the
first commands of a page whose clock it does not know yet.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from cardan.bus.network import NetworkError, ServiceInfo
from cardan.errors import CardanError
from cardan.gateway.arm.backlog import UNKNOWN_CLOCK
from cardan.gateway.arm.requests import (
    PacketError,
    Reply,
    Request,
    decode_answer,
    encode_request,
)
from cardan.gateway.arm.vocab import Begins, Parameter, Stream
from cardan.gateway.servers.calls import CallError, ServiceCaller
from cardan.gateway.servers.console.hold_to_run import FRESH_S
from cardan.protocols.handheld.frames import JogJoints, JogTwist
from cardan.types import NEVER_S, Twist, Vector3

ASK_SERVICE, ASK_TYPE = "ask", "cardan_msgs/srv/Ask"

ANSWER_S = 1.0
"""Longest wait for the answer to a streamed command."""

BEGIN_S = 5.0
"""Longest wait if the arm's model may have to be opened first, or another stream ended."""

LEAVE_S = 0.5
"""Longest wait for the answer when a page goes."""

_STEP_S = 1e-6
"""Smallest increase of the stamps of one sender."""

_NOWHERE = Vector3(0.0, 0.0, 0.0)


class Wish(NamedTuple):
    """Jog command of a page for an arm."""

    body: JogTwist | JogJoints
    made_s: float

    @property
    def verb(self) -> str:
        return "twist" if isinstance(self.body, JogTwist) else "joints"

    @property
    def moves(self) -> bool:
        """True if it requests motion."""
        body = self.body
        if isinstance(body, JogTwist):
            return any((*body.linear, *body.angular))
        return any(body.rates)

    @property
    def value(self) -> Any:
        """Argument of its verb."""
        body = self.body
        if isinstance(body, JogTwist):
            return Twist(body.linear, body.angular, body.frame)
        return list(body.rates)

    def at_rest(self, now_s: float) -> Wish:
        """Return the command without motion."""
        body = self.body
        if isinstance(body, JogTwist):
            return Wish(JogTwist(_NOWHERE, _NOWHERE, body.frame), now_s)
        return Wish(JogJoints((0.0,) * len(body.rates)), now_s)


class ArmJog:
    """The stream of one operator to one arm, in a loop, between `open` and `close`."""

    def __init__(
        self, arm: str, source: str, caller: ServiceCaller, refused: Callable[[str], None]
    ) -> None:
        """`arm`: full name of its node. `refused(why)`: called for a refused command of a hold."""
        self.arm, self.source = arm, source
        self.stale = 0
        """Count of commands that were too old at their turn."""
        self._caller, self._tell_refused = caller, refused
        self._loop = asyncio.get_running_loop()
        self._something = asyncio.Event()
        self._wish: Wish | None = None
        self._sent: Wish | None = None
        """The newest command of this hold that was sent."""
        self._held = False
        """True while the operator requests motion."""
        self._begun = False
        """True once the arm has accepted a command of this hold."""
        self._verb = ""
        """Verb of the newest command that the arm has accepted."""
        self._stamp_s = NEVER_S
        self._ids = itertools.count(1)
        self._task: asyncio.Task[None] | None = None

    def open(self) -> None:
        """Begin to stream the newest command."""
        self._task = self._loop.create_task(self._run())

    def begin(self) -> None:
        """Begin a new hold."""
        self._begun, self._sent = False, None

    def move(self, wish: Wish) -> None:
        """Set the operator's present command."""
        self._wish, self._held = wish, True
        self._something.set()

    def rest(self) -> None:
        """Clear the operator's command."""
        self._wish, self._held = None, False
        if self._sent is not None:
            self._wish = self._sent.at_rest(self._loop.time())
            self._something.set()

    async def close(self) -> None:
        """Bring its motion to rest, and give up the authority."""
        task, self._task = self._task, None
        if task is None:
            return
        task.cancel()
        asked: list[tuple[str, Any, float | None]] = [("release", None, None)]
        if self._sent is not None:
            wish = self._sent.at_rest(self._loop.time())
            asked.insert(0, (wish.verb, wish.value, self._stamp(wish)))
        # Both leave at once: nothing waits for an answer that may not come.
        answers = asyncio.gather(*(self._ask(*each) for each in asked), return_exceptions=True)
        with contextlib.suppress(asyncio.TimeoutError):
            await asyncio.wait_for(answers, LEAVE_S)

    async def _run(self) -> None:
        while True:
            await self._something.wait()
            self._something.clear()
            wish, self._wish = self._wish, None
            if wish is None:
                continue
            try:
                why = await self._send(wish)
            except (CardanError, CallError, NetworkError) as error:
                why = str(error)
            if why and wish.moves and not (UNKNOWN_CLOCK in why and not self._begun):
                self._tell_refused(why)

    async def _send(self, wish: Wish) -> str:
        """Send a command; return why the arm refuses it, or ""."""
        if not wish.moves and self._sent is None:
            return ""  # Zero begins nothing.
        if not self._begun and wish.moves and self._verb not in ("", wish.verb):
            # Its own stream of the other kind is chosen still, and at rest.
            await self._ask("set_parameters", {Parameter.STREAM: float(Stream.NONE)})
            self._verb = ""
            if self._wish is not None or not self._held:
                return ""  # The control was released meanwhile, or the command has changed.
        if wish.moves and self._loop.time() - wish.made_s > FRESH_S:
            self.stale += 1
            return ""
        self._sent = wish if wish.moves else None
        begins = Begins.NEW if wish.moves and not self._begun else None
        why = str(await self._ask(wish.verb, wish.value, self._stamp(wish), begins) or "")
        if not why:
            self._begun, self._verb = True, wish.verb
        return why

    def _stamp(self, wish: Wish) -> float:
        """Return its time of making. The estimate of the page's clock changes, and stamps must
        grow."""
        self._stamp_s = max(wish.made_s, self._stamp_s + _STEP_S)
        return self._stamp_s

    async def _ask(
        self, verb: str, value: Any, stamp_s: float | None = None, begins: Begins | None = None
    ) -> Any:
        """Call the arm and return the verb's result. Raises CardanError, CallError or
        NetworkError."""
        timeout_s = BEGIN_S if begins is not None or stamp_s is None else ANSWER_S
        number = next(self._ids)
        sequence = None if stamp_s is None else number
        request = Request(
            number, self.source, verb, value, sequence, stamp_s=stamp_s, begins=begins
        )
        data = {"request": encode_request(request).decode()}
        service = f"{self.arm}/{ASK_SERVICE}"
        answer = await self._caller.start(service, ASK_TYPE, data, timeout_s)
        reply = decode_answer(answer["reply"].encode())
        if not isinstance(reply, Reply) or reply.id != number:
            raise PacketError(f"{verb}: the arm's reply is invalid")
        if reply.error is not None:
            raise reply.error
        return reply.result


def why_no_arm(arm: str, services: Mapping[str, ServiceInfo]) -> str:
    """Return why no arm of this name takes commands; empty: it does."""
    if f"{arm}/{ASK_SERVICE}" in services:
        return ""
    there = [
        name.removesuffix(f"/{ASK_SERVICE}")
        for name, service in services.items()
        if service.type == ASK_TYPE
    ]
    return f"there is no arm {arm} that takes commands; there are: {', '.join(there) or 'none'}"
