"""Simulated page on the bus, or as a page of a console server."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from cardan.protocols.handheld.frames import BodyPart
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import default_message
from cardan.sim_peers.backends.base import DeviceBackend
from cardan.sim_peers.backends.bus import BusBackend, BusPeerOptions
from cardan.sim_peers.base import load_script
from cardan.sim_peers.command import PeerCommand, option
from cardan.sim_peers.device_peer import DevicePeer
from cardan.sim_peers.handheld.console import ConsolePage
from cardan.sim_peers.handheld.core import FAULTS, HandheldKind, SimulatedHandheld
from cardan.sim_peers.spacemouse.motion_script import SCRIPT_VERBS, SCRIPTS, ScriptedPuck

FRAME = "cardan_msgs/msg/OperatorFrame"


@dataclass(frozen=True, kw_only=True)
class PagePeerOptions(BusPeerOptions):
    """Options of :class:`PagePeer`, beside script, faults and seed."""

    console: str = option(
        "",
        "Be a page of this console instead (ws://127.0.0.1:8443); its token is read from the "
        "environment's CARDAN_SERVER_TOKEN.",
        metavar="URL",
    )

    @property
    def kind(self) -> HandheldKind:
        """Kind of device of the page."""
        return "phone"

    @property
    def body_part(self) -> BodyPart:
        """Body part that carries the device."""
        return BodyPart.RIGHT


@dataclass(frozen=True, kw_only=True)
class XrPeerOptions(PagePeerOptions):
    """Options of the page of a headset."""

    part: Literal["right", "left", "viewer"] = option("right", "Which hand, or the viewer.")

    @property
    def kind(self) -> HandheldKind:
        return "xr"

    @property
    def body_part(self) -> BodyPart:
        return BodyPart[self.part.upper()]


def page_on_bus(device: SimulatedHandheld, options: PagePeerOptions) -> BusBackend:
    """Return the backend of a page whose frames a console has already passed on to the bus."""

    def feel(feedback: Mapping[str, Any]) -> None:
        device.rumble = feedback["intensity"]

    topic = f"/{options.kind}"
    return BusBackend(
        options,
        "console_client",
        (topic, FRAME),
        f"{topic}/feedback",
        feel,
        lambda frame: wrapped(frame, device.age_s),
    )


class ConsoleBackend(DeviceBackend[bytes]):
    """Backend that is a page of a console."""

    def __init__(self, device: SimulatedHandheld, options: PagePeerOptions) -> None:
        self._device, self._options = device, options
        self._page: ConsolePage | None = None

    @property
    def endpoint(self) -> str:
        """URL of the console."""
        return self._options.console

    @property
    def there(self) -> bool:
        """True if the page is open."""
        return self._page is not None

    def appear(self) -> None:
        """Open the page. Raises DriverError."""
        self._page = ConsolePage(self._options.console, f"/{self._options.kind}")

    def vanish(self) -> None:
        """Close it."""
        page, self._page = self._page, None
        if page is not None:
            page.close()

    def send(self, messages: Sequence[bytes]) -> None:
        """Send frames."""
        if self._page is not None:
            for data in messages:
                self._page.send(data, self._device.age_s)

    @property
    def due_s(self) -> float:
        """Time of the page's next turn; every turn of the loop without one."""
        return 0.0 if self._page is None else self._page.due_s

    def run_due(self, now_s: float) -> None:
        """Handle the server's messages."""
        if self._page is None or now_s < self._page.due_s:
            return
        self._page.run_due(now_s)
        if self._page.ready:
            self.shell.begin()
        self._device.rumble = self._page.rumble


def wrapped(frame: bytes, age_s: float) -> bytes:
    """Return a frame in the form that the console's server publishes."""
    message = default_message(FRAME)
    return codec_of(FRAME).encode({**message, "age": age_s, "frame": frame})


class PagePeer(DevicePeer[SimulatedHandheld, bytes]):
    """A simulated page. Raises ScriptError for a script or a fault."""

    def __init__(self, options: PagePeerOptions | None = None) -> None:
        options = PagePeerOptions() if options is None else options
        device = SimulatedHandheld(options.kind, options.faults, options.seed, options.body_part)
        steps = load_script(options.script, SCRIPTS, SCRIPT_VERBS)
        motion = ScriptedPuck(steps, device.model)
        made = ConsoleBackend if options.console else page_on_bus
        super().__init__(device, motion, made(device, options), options)  # type: ignore[arg-type]


class PhonePageCommand(PeerCommand[PagePeerOptions]):
    """A page of the console with a phone's orientation and touch."""

    Options, Peer = PagePeerOptions, PagePeer
    page = "simulated-peers.md"
    example = "--listen 127.0.0.1:7447"
    speaks = "[operator frames](phone.md#operator-frames-byte-for-byte), Zenoh"
    epilog = "Prints READY and the Zenoh endpoint that others connect to once it serves."
    faults, scripts, verbs = FAULTS, SCRIPTS, SCRIPT_VERBS


class XrPageCommand(PhonePageCommand):
    """A page of the console with a headset's controllers, or a phone with AR."""

    Options = XrPeerOptions
