"""Driver base of all Linux input devices: finds the node, reads it, requests its values."""

from __future__ import annotations

import threading
import time
from abc import abstractmethod
from typing import Any, ClassVar, TypeVar

from cardan.common.options import require
from cardan.drivers.access import obstacle, open_error, such
from cardan.drivers.base import FoundDevice, OperatorDevice
from cardan.drivers.evdev.core import EvdevCore
from cardan.drivers.evdev.links import EvdevLink, EvdevSocketLink, NodeLink
from cardan.drivers.evdev.nodes import (
    EvdevDeviceInfo,
    Node,
    describe,
    find_nodes,
    kernel_driver,
    take_snapshot,
)
from cardan.drivers.packet_socket import open_simulated
from cardan.drivers.reader_thread import ReaderMixin
from cardan.errors import DeviceAccessError, DeviceNotFoundError, DriverError

READ_TIMEOUT_S = 0.02
"""Longest wait for an event; a device that sends none meanwhile counts as read."""

ANSWER_TIMEOUT_S = 0.03
"""Timeout of a simulated device's sign of life, s. With the wait before it and `FEEDBACK_TIMEOUT_S`
it is below the longest time that a deflected device may go unread."""

SNAPSHOT_PERIOD_S = 0.02
"""Shortest time between two requests for all values of a device, s."""


def check_way(transport: str, path: str) -> None:
    """Raise OptionError unless transport and path go together."""
    good = transport != "socket" or path
    require(good, "path", path, "the path of the socket for transport 'socket'")


K = TypeVar("K", bound=EvdevCore)


class EvdevDevice(ReaderMixin[K], OperatorDevice):
    """An input device of one kind."""

    _permission_hint: ClassVar[str]

    def __init__(self, options: Any = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self._link: EvdevLink | None = None
        self._chosen: EvdevDeviceInfo | None = None
        """Device opened first since open(): no other replaces it when it is unplugged."""

    @classmethod
    def find(cls) -> list[FoundDevice]:
        """Return the devices of this kind, each with any obstacle to opening it. Never raises."""
        return [
            FoundDevice(
                node.name,
                node.identity,
                "evdev",
                node.path,
                obstacle(node.path, hint=cls._permission_hint),
            )
            for node in cls._nodes()
        ]

    @staticmethod
    @abstractmethod
    def _fits(keys: frozenset[int], axes: frozenset[int]) -> bool:
        """True if a device with these keys and axes is of the kind."""

    @staticmethod
    def _misfit(identity: str, keys: frozenset[int], axes: frozenset[int]) -> str:
        """Describe what a device that does not fit is, if that helps; else empty."""
        return ""

    @abstractmethod
    def _attend(self, link: EvdevLink) -> None:
        """Serve other needs of the open device after each read. May raise OSError."""

    def _before_release(self, link: EvdevLink) -> None:
        """Restore the device's initial state. May raise OSError."""

    # -- the reader ----------------------------------------------------------------------------

    def close(self) -> None:
        with self._opening:
            super().close()
            self._chosen = None

    def _connect(self) -> None:
        link, driver = self._open_link()
        try:
            description = describe(link, driver)
            axes = frozenset(description.axes)
            if not self._fits(description.keys, axes):
                misfit = self._misfit(description.identity, description.keys, axes)
                raise DeviceNotFoundError(
                    f"{description.name} ({self.options.path}) is not a {self._kind}: "
                    f"{misfit or 'leave path empty, or see `cardan devices`'}"
                )
            self._check_choice(description)
            snapshot = take_snapshot(link, description)
        except OSError as error:
            link.close()
            raise DeviceAccessError(
                f"the {self._kind} does not identify itself: {error.strerror or error}"
            ) from None
        except DriverError:
            link.close()
            raise
        self._link = link
        if self.options.transport == "evdev":
            self._chosen = description
        with self._lock:
            self._core.on_opened(description, snapshot, time.monotonic())

    def _serve(self, stop: threading.Event) -> None:
        link, core = self._link, self._core
        assert link is not None
        snapshot_due_s = 0.0
        while not stop.is_set():
            data = link.read(READ_TIMEOUT_S)
            there = True
            if data is None:
                with self._lock:
                    has_to_answer = core.has_to_answer
                there = not has_to_answer or link.answers(ANSWER_TIMEOUT_S)
            now_s = time.monotonic()
            if (callback := self.raw_packet_callback) is not None and data is not None:
                callback(data, False, "")
            with self._lock:
                if data is not None:
                    core.on_packet(data, now_s)
                elif there:
                    core.on_checked(now_s)
                else:
                    core.on_unanswered(now_s)
                needs_snapshot = core.needs_snapshot
            if needs_snapshot and now_s >= snapshot_due_s:
                self._ask(link, core.description)
                snapshot_due_s = time.monotonic() + SNAPSHOT_PERIOD_S
            self._notify()
            self._attend(link)

    def _ask(self, link: EvdevLink, description: EvdevDeviceInfo) -> None:
        snapshot = take_snapshot(link, description)
        with self._lock:
            self._core.on_snapshot(snapshot, time.monotonic())

    def _release(self) -> None:
        link, self._link = self._link, None
        if link is None:
            return
        try:
            self._before_release(link)
        except OSError:
            pass  # the device is gone, and its values with it
        finally:
            link.close()

    # -- finding and opening -------------------------------------------------------------------

    @classmethod
    def _nodes(cls, *, fit: bool = True) -> list[Node]:
        return [node for node in find_nodes() if cls._fits(node.keys, node.axes) is fit]

    def _open_link(self) -> tuple[EvdevLink, str]:
        """Open the device that the options select; return it with the name of its kernel driver."""
        options = self.options
        if options.transport == "socket":
            return open_simulated(f"the simulated {self._kind}", options.path, EvdevSocketLink), ""
        if options.path:
            return self._open_node(options.path)
        refusals: list[str] = []
        nodes = self._nodes()
        chosen = self._chosen
        for node in nodes:
            if (
                options.name.lower() in node.name.lower()
                if chosen is None
                else node.is_of(chosen.name, chosen.identity)
            ):
                try:
                    return self._open_node(node.path)
                except DeviceAccessError as error:
                    refusals.append(str(error))
        if refusals:
            raise DeviceAccessError("; ".join(refusals))
        there = ", ".join(node.name for node in nodes)
        if chosen is not None:
            raise DeviceNotFoundError(
                f"{chosen.name} is not plugged in"
                + (f"; there is {there}: start again to use it" if there else "")
            )
        misfits = "".join(
            f"; {node.name} ({node.path}) is unsuitable: {misfit}"
            for node in self._nodes(fit=False)
            if (misfit := self._misfit(node.identity, node.keys, node.axes))
        )
        raise DeviceNotFoundError(
            f"no {self._kind}{such(options, 'name')} is plugged in"
            + (f"; there are: {there}" if there else ": see `cardan devices`")
            + misfits
        )

    def _check_choice(self, description: EvdevDeviceInfo) -> None:
        """Raise an error unless this is the device that was opened first: node numbers are
        reused."""
        chosen = self._chosen
        if chosen is not None and (chosen.name, chosen.identity) != (
            description.name,
            description.identity,
        ):
            raise DeviceNotFoundError(
                f"{chosen.name} is not plugged in; at {self.options.path} there is "
                f"{description.name}: start again to use it"
            )

    def _open_node(self, path: str) -> tuple[EvdevLink, str]:
        try:
            return NodeLink(path), kernel_driver(path)
        except OSError as error:
            raise DeviceAccessError(open_error(path, error, self._permission_hint)) from None
