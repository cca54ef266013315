"""Server that carries out verbs by name, and waits for slow ones, beside the loop."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from cardan.gateway.arm.loop_link import LoopLink
from cardan.gateway.arm.status import VERBS
from cardan.gateway.arm.validation import checked_sequence, checked_source, checked_timeout
from cardan.gateway.arm.verb_results import Motion, Outcome, Rehearsal
from cardan.gateway.arm.verb_table import NOTHING, VERB_TABLE
from cardan.gateway.arm.vocab import Begins, Parameter, State

if TYPE_CHECKING:  # Imports Pinocchio, which sessions without an arm's model do without.
    from cardan.gateway.arm.verb_methods import ArmVerbs

REST_TIMEOUT_S = 10.0
"""Robot time within which any motion has braked to rest."""

SLOWS_S = 0.5
"""Longest wait of a rehearsal for a decelerating arm: a stream's ramp takes half of it."""


class VerbServer:
    """Carries out the requests of any thread at the verbs of one arm.

    A verb that takes over from a motion under way blocks until that one is braked to rest; if the
    new motion is impossible from there, it is refused and the arm stays at rest.
    """

    def __init__(self, verbs: ArmVerbs, link: LoopLink) -> None:
        self.verbs, self.link = verbs, link
        self._starting = threading.RLock()
        """Held by the request that may wait for the arm to rest; others follow one at a time."""

    def perform(
        self,
        verb: str,
        source: str = VERBS,
        value: Any = None,
        sequence: int | None = None,
        stamp_s: float | None = None,
        begins: Begins | None = None,
    ) -> Any:
        """Carry out `verb` for `source`; `value` is its argument, if it has one. `sequence`,
        `stamp_s` and `begins` belong to streamed commands: see :meth:`ArmVerbs.stream`.

        Returns the verb's result. Raises MotionRefusedError, ConfigurationError, or, if the loop
        does not run, MotionLoopError.
        """
        checked_source(verb, source)
        if sequence is not None:
            checked_sequence(verb, sequence)
        known = VERB_TABLE[verb]
        if not known.without_loop:
            self.link.require()
        if known.changes and not known.recorded:
            self.verbs.controller.record_request("verb", f"{verb} of {source!r}")
        if known.preset is not None:
            owner = "" if source == VERBS else source
            return self.verbs.stream(
                verb, value, owner=owner, sequence=sequence, stamp_s=stamp_s, begins=begins
            )
        if verb == "wait":
            return self.wait(checked_timeout(verb, value))
        call = getattr(self.verbs, verb)
        if known.takes is not NOTHING:
            call = partial(call, value)
        if known.changes or verb == "stop":
            call = partial(call, source=source)
        if known.begins_motion:
            return self.start(call)
        if known.at_rest:
            return self.settled(call)
        return self.rehearsed(call) if known.answers is Rehearsal else call()

    def start(self, verb: Callable[[], Motion]) -> Motion:
        """Start a motion, after the previous one has come to rest."""
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
        """Apply a `change` that needs rest, after a decelerating arm has come to rest."""
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
        """Return the rehearsal by `look` from where a decelerating arm comes to rest."""
        verbs = self.verbs
        began_s = verbs.stamp_s
        while verbs.commanded.moving and verbs.stamp_s - began_s < SLOWS_S:
            self.link.require()
            self.link.wait()
        return look()

    def wait(self, timeout_s: float) -> bool:
        """Wait until the last movj, relj, movl or retract has ended; return whether it arrived."""
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
