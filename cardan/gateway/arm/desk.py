"""Carries out verbs by name, and waits for what takes time, beside the loop."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from cardan.gateway.arm.authority import VERBS
from cardan.gateway.arm.checks import checked_sequence, checked_source, checked_timeout
from cardan.gateway.arm.codes import Begins, Parameter, State
from cardan.gateway.arm.link import LoopLink
from cardan.gateway.arm.motion import Motion, Outcome, Rehearsal
from cardan.gateway.arm.repeating import REPEATED

if TYPE_CHECKING:  # Imports Pinocchio, which sessions without an arm's model do without.
    from cardan.gateway.arm.verbs import ArmVerbs

REST_TIMEOUT_S = 10.0
"""Robot time within which any motion has braked to rest."""

SLOWS_S = 0.5
"""Longest wait of a rehearsal for an arm that slows down: a stream's ramp takes half of it."""


class VerbDesk:
    """Carries out the requests of any thread at the verbs of one arm.

    A verb that takes over from a motion under way blocks until that one is braked to rest; if from
    there it turns out impossible, it is refused and the arm stays at rest.
    """

    def __init__(self, verbs: ArmVerbs, link: LoopLink) -> None:
        self.verbs, self.link = verbs, link
        self._starting = threading.RLock()
        """One request that may wait for the arm to rest at a time."""

    def perform(
        self,
        verb: str,
        source: str = VERBS,
        value: Any = None,
        sequence: int | None = None,
        stamp_s: float | None = None,
        begins: Begins | None = None,
    ) -> Any:
        """Carry out `verb` for `source`; `value` is its argument, where it has one. `sequence`,
        `stamp_s` and `begins` are of streamed commands: see :meth:`ArmVerbs.stream`.

        Answers what the verb answers. Raises MotionRefusedError, ConfigurationError, or, where the
        loop does not run, MotionLoopError.
        """
        checked_source(verb, source)
        if sequence is not None:
            checked_sequence(verb, sequence)
        if verb not in WITHOUT_LOOP:
            self.link.require()
        if verb not in TOLD_OF:
            self.verbs.controller.note("verb", f"{verb} of {source!r}")
        if verb in _PERFORMED:
            return _PERFORMED[verb](self, source, value)
        owner = "" if source == VERBS else source
        return self.verbs.stream(
            verb, value, owner=owner, sequence=sequence, stamp_s=stamp_s, begins=begins
        )

    def start(self, verb: Callable[[], Motion]) -> Motion:
        """Start a motion, after the one before has come to rest."""
        with self._starting:
            self.link.require()
            motion = verb()
            while motion.outcome is Outcome.WAITING:
                self.link.require()
                if self.verbs.start_pending() is None:
                    self.link.wait()
            if motion.error is not None:
                raise motion.error
            return motion

    def settled(self, change: Callable[[], None]) -> None:
        """Make a `change` that needs rest, after an arm on its way there has come to it."""
        with self._starting:
            self.link.require()
            verbs = self.verbs
            began_s = verbs.stamp_s
            while (
                verbs.status().braking
                and verbs.state is State.NOT_CONTROLLING
                and verbs.stamp_s - began_s < REST_TIMEOUT_S
            ):
                self.link.require()
                self.link.wait()
            change()

    def rehearsed(self, look: Callable[[], Rehearsal]) -> Rehearsal:
        """`look` at a motion from where an arm that slows down comes to rest."""
        verbs = self.verbs
        began_s = verbs.stamp_s
        while verbs.body.moving and verbs.stamp_s - began_s < SLOWS_S:
            self.link.require()
            self.link.wait()
        return look()

    def wait(self, timeout_s: float) -> bool:
        """Wait until the last movj, relj or movl has ended; True when it arrived."""
        verbs = self.verbs
        motion = verbs.waited_for
        if motion is None or not motion.ends:
            return True
        began_s = verbs.stamp_s
        period_s = 1e-3 * verbs.get_parameter(Parameter.WAIT_PERIOD)
        while not motion.over:
            self.link.require()
            if timeout_s > 0.0 and verbs.stamp_s - began_s > timeout_s:
                verbs.stop()
                return False
            self.link.wait(period_s)
        return motion.outcome is Outcome.DONE


def _wait(desk: VerbDesk, _source: str, timeout_s: Any) -> bool:
    return desk.wait(checked_timeout("wait", timeout_s))


WITHOUT_LOOP = frozenset(
    {"stop", "wait", "acquire", "hand_over", "release"}
    | {"get_parameter", "get_parameters", "status"}
)
"""What is done also while no loop drives the arm; a `wait` for what still moves is not."""

TOLD_OF = frozenset(
    {
        "stat",
        "inv",
        "rehearse_line",
        "rehearse_joints",
        "wait",
        "status",
        "get_parameter",
        "get_parameters",
        "stop",
        "acknowledge",
    }
    | REPEATED
)
"""What changes nothing, or nothing of which the controller's witness is not told as it happens."""

_PERFORMED: dict[str, Callable[[VerbDesk, str, Any], Any]] = {
    "stat": lambda desk, _source, _value: desk.verbs.stat(),
    "inv": lambda desk, _source, xd: desk.verbs.inv(xd),
    "rehearse_line": lambda desk, _source, xd: desk.rehearsed(lambda: desk.verbs.rehearse_line(xd)),
    "rehearse_joints": lambda desk, _source, q: desk.rehearsed(
        lambda: desk.verbs.rehearse_joints(q)
    ),
    "movj": lambda desk, source, xd: desk.start(lambda: desk.verbs.movj(xd, source=source)),
    "relj": lambda desk, source, xd: desk.start(lambda: desk.verbs.relj(xd, source=source)),
    "movl": lambda desk, source, xd: desk.start(lambda: desk.verbs.movl(xd, source=source)),
    "trajectory": lambda desk, source, wanted: desk.start(
        lambda: desk.verbs.trajectory(wanted, source=source)
    ),
    "movv": lambda desk, source, xdot: desk.start(lambda: desk.verbs.movv(xdot, source=source)),
    "gcmp": lambda desk, source, _value: desk.start(lambda: desk.verbs.gcmp(source=source)),
    "forc": lambda desk, source, fd: desk.start(lambda: desk.verbs.forc(fd, source=source)),
    "wait": _wait,
    "stop": lambda desk, source, _value: desk.verbs.stop(source=source),
    "tool": lambda desk, source, x: desk.settled(lambda: desk.verbs.tool(x, source=source)),
    "act": lambda desk, source, code: desk.verbs.act(code, source=source),
    "acknowledge": lambda desk, _source, _value: desk.verbs.acknowledge(),
    "acquire": lambda desk, source, _value: desk.verbs.acquire(source=source),
    "hand_over": lambda desk, source, to: desk.verbs.hand_over(to, source=source),
    "release": lambda desk, source, _value: desk.verbs.release(source),
    "get_parameter": lambda desk, _source, key: desk.verbs.get_parameter(key),
    "get_parameters": lambda desk, _source, _value: desk.verbs.get_parameters(),
    "set_parameters": lambda desk, source, values: desk.settled(
        lambda: desk.verbs.set_parameters(values, source=source)
    ),
    "status": lambda desk, _source, _value: desk.verbs.status(),
}
