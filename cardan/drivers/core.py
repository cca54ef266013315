"""Base of all operator device cores: link, buttons, counts, and their diagnosis."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Mapping

from cardan.drivers.buttons import ButtonEdges
from cardan.drivers.shaping import Shaper
from cardan.types import (
    NEUTRAL,
    NEVER_S,
    Axes,
    ButtonEvent,
    DeviceLink,
    DeviceState,
    Inertia,
    Pose,
    Wrench,
)

MOST_KINDS = 32
"""Most kinds by which unusable reports are counted: a foreign report chooses its own words."""


class DeviceCore(ABC):
    """Interpreter of a device's reports, without any I/O. Times are monotonic, s.

    A device's own core processes its reports by its own rules of rest and silence. It calls
    `_begin` when the device was opened, `_invalidate_input` or `_fall_silent` when the known state
    has become void, and sets `_link` to LIVE when the device was seen at rest. After every change
    it sets `_cached` to None. For values besides buttons a core overrides the methods below.
    """

    # CPython stores up to 29 attributes of an object in a fast place, and the SpaceMouse's core has
    # as many: one more slows each of its reports by an eighth.

    _shaper: Shaper
    """Only of devices with deflections."""

    def __init__(self) -> None:
        self._buttons = ButtonEdges()
        self._link = DeviceLink.CLOSED
        self._reason = "not opened"
        """Reason why the link is not LIVE."""
        self._open = False
        self._heard = False
        self._stamp_s = NEVER_S
        """Time before which reports of rest do not count, s."""
        self._ignore_rest_until_s = NEVER_S
        """Reports of rest before this do not count."""
        self._battery: float | None = None
        """Battery charge, 0..1."""
        self._counts: Counter[str] = Counter()
        self._malformed: Counter[str] = Counter()
        """Unusable reports, by cause."""
        self._cached: DeviceState | None = None

    # -- what a core must and may define --------------------------------------------------------

    @property
    @abstractmethod
    def _counters(self) -> Mapping[str, str]:
        """The counters, and the text behind each count."""

    @abstractmethod
    def _watch(self, now_s: float) -> None:
        """Check for silence: called whenever the state is read."""

    @abstractmethod
    def _drop_input(self, now_s: float) -> None:
        """Discard deflections and pressed buttons, because they do not count any more."""

    def _axes(self, now_s: float) -> Axes:
        """The deflections while the link is LIVE."""
        return NEUTRAL

    def _pose(self) -> Pose | None:
        """Pose of the operator's device while the link is LIVE."""
        return None

    def _wrench(self) -> Wrench | None:
        """Measured force and torque, whatever the link."""
        return None

    def _inertia(self, now_s: float) -> Inertia | None:
        """Inertial readings while the device reports them."""
        return None

    def _why(self) -> str:
        """Return why the link is not LIVE, with advice."""
        return self._reason

    def _notes(self, now_s: float) -> list[str]:
        """Return further warnings, worst first."""
        return []

    def _figures(self, now_s: float) -> dict[str, float]:
        """Return live figures by name, besides the counts."""
        return {}

    def _tally(self) -> Mapping[str, int]:
        """The counts by the names in `_counters`."""
        return {key: self._counts[key] for key in self._counters}

    # -- events of the device -------------------------------------------------------------------

    def on_lost(self, reason: str, now_s: float) -> None:
        """Handle a missing or unreadable device: link LOST, axes zero, buttons released."""
        self._end(DeviceLink.LOST, reason, now_s)

    def on_closed(self, now_s: float) -> None:
        """Handle a close on request: link CLOSED, axes zero, buttons released."""
        self._end(DeviceLink.CLOSED, "closed", now_s)

    # -- reports --------------------------------------------------------------------------------

    @property
    def heard(self) -> bool:
        """True once any usable report came since the device was opened."""
        return self._heard

    def state(self, now_s: float) -> DeviceState:
        """Return the newest state as of `now_s`."""
        self._watch(now_s)
        if self._cached is None:
            live = self._link is DeviceLink.LIVE
            self._cached = DeviceState(
                self._stamp_s,
                self._link,
                self._axes(now_s) if live else NEUTRAL,
                self._buttons.held,
                self._pose() if live else None,
                self._battery,
                "" if live else self._why(),
                self._wrench(),
                self._inertia(now_s),
                self._buttons.masked,
            )
        return self._cached

    def events(self) -> list[ButtonEvent]:
        """Return button edges since the last call, oldest first."""
        return self._buttons.events() if self._buttons.queued else []

    def metrics(self, now_s: float) -> dict[str, float]:
        """Live figures by name: ages in s (inf: never), and counts."""
        return {
            **self._figures(now_s),
            **self._tally(),
            "lost_edges": self._buttons.lost_edges,
        }

    def protocol_errors(self) -> dict[str, int]:
        """Return counts of reports that could not be decoded, by kind."""
        return {"malformed": self._malformed.total()}

    def diagnosis(self, now_s: float) -> list[str]:
        """Return problems and other warnings, worst first."""
        words = [reason] if (reason := self.state(now_s).reason) else []
        words += self._notes(now_s)
        if self._buttons.lost_edges:
            words.append(f"{self._buttons.lost_edges} button edges dropped: no program reads them")
        counts = self._tally()
        words += [f"{counts[key]} {text}" for key, text in self._counters.items() if counts[key]]
        words += [f"{count} {what}, ignored" for what, count in self._malformed.most_common()]
        return words

    # -- for a device's own core ---------------------------------------------------------------

    def _begin(self, reason: str, now_s: float) -> None:
        """Start after the device was opened (again): the previous state is void."""
        self._open = True
        self._heard = False
        self._battery = None
        self._invalidate_input(DeviceLink.NEEDS_NEUTRAL, reason, now_s)

    def _end(self, link: DeviceLink, reason: str, now_s: float) -> None:
        """Record that no device is open any more."""
        self._open = False
        self._invalidate_input(link, reason, now_s)

    def _invalidate_input(self, link: DeviceLink, reason: str, now_s: float) -> None:
        """Set `link`, a state in which earlier deflections and buttons are void."""
        self._link, self._reason = link, reason
        self._drop_input(now_s)
        self._buttons.release_all(now_s)
        self._cached = None

    def _fall_silent(self, reason: str, now_s: float) -> None:
        """Handle a silence: link STALE; counted for a device that was heard before."""
        self._counts["silences"] += self._heard
        self._invalidate_input(DeviceLink.STALE, reason, now_s)

    def _resume(self, reason: str, settle_s: float, now_s: float) -> None:
        """Resume after a silence: the device counts once it is seen at rest.

        Reports in the next `settle_s` are no evidence: they may have been queued.
        """
        self._link, self._reason = DeviceLink.NEEDS_NEUTRAL, reason
        self._ignore_rest_until_s = now_s + settle_s
        self._cached = None

    def _on_malformed(self, reason: str, report_id: int = -1) -> None:
        """Count a report that cannot be decoded; `report_id` is -1 if it has none."""
        of_id = f" (id {report_id:#04x})" if report_id >= 0 else ""
        what = f"reports {reason}{of_id}"
        if what not in self._malformed and len(self._malformed) >= MOST_KINDS:
            what = "reports that are wrong in yet other ways"
        self._malformed[what] += 1
