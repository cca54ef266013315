"""Authority over an arm: one source at a time may move it."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Annotated, ClassVar, NamedTuple

from cardan.common.bounds import AUTHORITY_LEASE_S
from cardan.common.options import Options
from cardan.errors import ConfigurationError
from cardan.types import NEVER_S

OPERATOR = "device"
"""The operator device of the session: its name in files, in records and on the network."""

VERBS = "verbs"
"""The verbs and nameless streams of this process."""

LEASE_S = 2.0
"""Default time until the authority of a source that does not renew it expires: longer than any
network's pause that an operator would sit out, short enough for others to wait for."""


class AuthorityPolicy(enum.Enum):
    """Policy for taking the authority from another source. Stop needs no authority."""

    OPERATOR = "device"
    """Re-arming the operator device takes it from any source; others when it is free."""
    FIRST = "first"
    """Any source takes it when it is free, the operator device included."""
    NAMED = "named"
    """Reserved for the named source and the one that this hands it over to; the name of a network
    ("ros2") includes each of its nodes ("ros2 /joystick")."""


@dataclass(frozen=True, kw_only=True)
class AuthorityOptions(Options):
    """``[authority]``: sources that may move the arm, and their precedence."""

    RENAMED: ClassVar = {f"{key} = 'hand'": f"{OPERATOR!r}" for key in ("policy", "named")}

    policy: AuthorityPolicy = AuthorityPolicy.OPERATOR
    named: str = ""
    """The source that may have it if `policy` is NAMED."""
    lease_s: Annotated[float, AUTHORITY_LEASE_S] = LEASE_S
    """Time until the authority of a source that does not renew it expires, s."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.policy is AuthorityPolicy.NAMED) is not bool(self.named):
            raise ConfigurationError(
                "named",
                'policy = "named" needs the source that it is for ("device", "verbs", or the owner '
                "of a stream); no other policy has one",
            )


class AuthorityState(NamedTuple):
    """The source that has the authority, the time since when, and the last refusal."""

    owner: str
    """Empty: no source."""
    since_s: float
    """Local monotonic time."""
    refused: str
    """The last refusal; empty before the first."""


class Authority:
    """The one source that may move the arm, and its lease. All times are the robot's stamps, s."""

    def __init__(self, options: AuthorityOptions | None = None, network: str = "") -> None:
        """`network`: first word of the names of sources on the arm's network, reserved for these;
        empty: the arm takes no commands from a network."""
        options = options or AuthorityOptions()
        self.policy, self.named, self.lease_s = options.policy, options.named, options.lease_s
        self.network = network
        self.owner = ""
        """The source that has it; empty: none."""
        self._since_s = self._renewed_s = NEVER_S
        self._handed_to = ""
        """Source that the authority was handed over to, until it uses it."""
        self._refused = ""

    def state(self) -> AuthorityState:
        """For status, snapshot and log."""
        return AuthorityState(self.owner, self._since_s, self._refused)

    def expire(self, now_s: float, busy: bool) -> None:
        """Free the authority of an owner that has not renewed it; one whose motion is `busy`
        keeps it."""
        if busy:
            self._renewed_s = now_s
        elif now_s - self._renewed_s > self.lease_s:
            self.owner = self._handed_to = ""

    def refuses(self, source: str) -> str:
        """Return why `source` may not take it now; empty when it may."""
        if source == self.owner:
            return ""
        if self.owner and not (self.policy is AuthorityPolicy.OPERATOR and source == OPERATOR):
            return f"{self.owner!r} has authority over the arm"
        if self.policy is AuthorityPolicy.NAMED and not self._is_named(source):
            return f"authority over the arm is reserved for {self.named!r}"
        return ""

    def _is_named(self, source: str) -> bool:
        """Return whether the arm is reserved for `source`, or for its network."""
        if source in (self.named, self._handed_to):
            return True
        is_network = bool(self.network) and self.named == self.network
        return is_network and source.startswith((f"{self.named} /", f"{self.named} #"))

    def take(self, source: str, now_s: float) -> str:
        """Give it to `source`, or renew it; return why not, or ""."""
        refusal = self.refuses(source)
        if refusal:
            self._refused = f"{source}: {refusal}"
            return refusal
        if source != self.owner:
            self.owner, self._since_s, self._handed_to = source, now_s, ""
        self._renewed_s = now_s
        return ""

    def hand_over(self, source: str, to: str, now_s: float) -> str:
        """Pass it from `source`, its owner, to `to`; return why not, or ""."""
        if source != self.owner:
            return f"{source!r} has no authority over the arm to hand over"
        self.owner, self._since_s, self._renewed_s, self._handed_to = to, now_s, now_s, to
        return ""

    def release(self, source: str) -> None:
        """Free the authority of `source`; no effect on that of another."""
        if source == self.owner:
            self.owner = self._handed_to = ""
