"""Serves a simulated 3Dconnexion device: on a socket, by uhid or over USB/IP."""

from __future__ import annotations

import logging
import math
import selectors
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, TypeVar

from cardan.common import bounds
from cardan.errors import ConfigurationError, OptionError, ScriptError
from cardan.protocols.connexion.descriptors import descriptor_for
from cardan.protocols.connexion.devices import CONNEXION, MODELS, model_by_key
from cardan.sim_peers.backends.base import DeviceBackend
from cardan.sim_peers.backends.uhid import (
    BUS_BLUETOOTH,
    BUS_USB,
    UHID_PATH,
    HidIdentity,
    UhidBackend,
)
from cardan.sim_peers.backends.unix_socket import ReportSocket
from cardan.sim_peers.backends.usbip import UsbipBackend
from cardan.sim_peers.base import load_script
from cardan.sim_peers.command import PeerCommand, option
from cardan.sim_peers.device_peer import DeviceNodeOptions, DevicePeer
from cardan.sim_peers.spacemouse.core import SimulatedSpaceMouse
from cardan.sim_peers.spacemouse.faults import FAULTS
from cardan.sim_peers.spacemouse.keyboard import (
    KEYBOARD_HELP,
    KeyboardMotion,
    Terminal,
    status_line,
)
from cardan.sim_peers.spacemouse.motion_script import SCRIPT_VERBS, SCRIPTS, Puck, ScriptedPuck
from cardan.sim_peers.spacemouse.usb import SpaceMouseUsb

STATUS_PERIOD_S = 0.1
"""Period at which the user's status line is drawn."""
BLUETOOTH_MODELS = frozenset({"spacemouse-wireless-bt", "spacemouse-pro-wireless-bt"})
"""Models that need no cable and no receiver."""
UNFIT_FAULTS: Mapping[str, Mapping[str, str]] = {
    "--uhid": {
        "refuse": "the kernel opens the device, which cannot refuse",
        "newest-lost": "the kernel keeps the queue, and always loses the newest",
    },
    "--usbip": {"newest-lost": "the host's kernel keeps the queue, and always loses the newest"},
}
"""Faults that a backend cannot have, with the reason."""

BUS_ID = bounds.Text(r"[^\0]+", "a name of 1 to 31 bytes", 31)

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class PuckPeerOptions(DeviceNodeOptions):
    """Options of the motion source of a device that has a cap."""

    keyboard: bool = option(False, "Move it with this terminal's keys.")
    """Use the keyboard instead of the script."""
    jitter_lsb: Annotated[int, bounds.NOISE_COUNTS] = 1
    """Noise on every axis while deflected, counts."""


@dataclass(frozen=True, kw_only=True)
class SpaceMousePeerOptions(PuckPeerOptions):
    """Model, motion source and one of three backends of a simulated device."""

    model: str = option(
        "spacenavigator",
        "Device model; see --list-models.",
        metavar="NAME",
        listed=[
            (model.key, f"{model.vendor_id:04x}:{model.product_id:04x}  {model.name}")
            for model in MODELS
        ],
    )
    hid: str = option("", "Unix seqpacket socket: each packet one raw HID report.", metavar="PATH")
    uhid: bool = option(False, "A HID device of this machine's kernel (/dev/uhid).")
    usbip: Annotated[int, bounds.ANY_PORT] | None = option(
        None, "A USB device by USB/IP at this port of 127.0.0.1; 0: any.", metavar="PORT"
    )
    """The tool ``usbip`` expects 3240 unless told otherwise."""
    uhid_path: str = UHID_PATH
    """The kernel's file."""
    physical_path: str = "cardan/uhid"
    """Physical location that the kernel gets for the device of `uhid`, to distinguish several."""
    host: Annotated[str, bounds.LISTEN_HOST] = "127.0.0.1"
    """Address to listen on for USB/IP."""
    bus_id: Annotated[str, BUS_ID] = "1-1"
    """Bus ID by which the host attaches the device over USB/IP."""


P = TypeVar("P", bound=Puck)


class PuckPeer(DevicePeer[P, bytes]):
    """Simulated device with a cap, moved by the keyboard or by a script that begins at `script_s`
    of the device's time.

    Raises ScriptError for an unknown or unsuitable script.
    """

    def __init__(
        self,
        device: P,
        backend: DeviceBackend[bytes],
        options: PuckPeerOptions,
        *,
        script_s: float = 0.0,
    ) -> None:
        self._keys: KeyboardMotion | None = None
        self._terminal: Terminal | None = None
        motion: KeyboardMotion | ScriptedPuck
        if options.keyboard:
            motion = self._keys = KeyboardMotion()
            self._terminal = Terminal()
        else:
            steps = load_script(options.script, SCRIPTS, SCRIPT_VERBS)
            motion = ScriptedPuck(steps, device.model, start_s=script_s)
        super().__init__(device, motion, backend, options)
        self._led = device.led
        self._status = ""
        self._status_due_s = math.inf

    def _open_parts(self) -> None:
        super()._open_parts()
        if self._terminal is not None:
            self._terminal.open()
            self.selector.register(self._terminal.fd, selectors.EVENT_READ, self._read_keys)
            print(KEYBOARD_HELP)
            self._status_due_s = self._opened_s
            self.begin()

    def close(self) -> None:
        """Unplug the device permanently and restore the terminal."""
        super().close()
        if self._terminal is not None:
            self._terminal.close()

    def _next_due_s(self, now_s: float) -> float:
        return min(super()._next_due_s(now_s), self._status_due_s)

    def _follow(self, now_s: float) -> None:
        super()._follow(now_s)
        if self.device.led != self._led:
            self._led = self.device.led
            _log.info("LED %s", "on" if self._led else "off")
        if now_s >= self._status_due_s:
            self._status_due_s = now_s + STATUS_PERIOD_S
            self._draw_status()

    # -- the keyboard --------------------------------------------------------------------------

    def _read_keys(self) -> None:
        assert self._terminal is not None
        assert self._keys is not None
        text = self._terminal.read()
        if text:
            self.catch_up()
            self._keys.feed(text, self.device_s())
        else:
            self.selector.unregister(self._terminal.fd)

    def _draw_status(self) -> None:
        """Draw the user's status line."""
        status = status_line(self.device)
        if status != self._status:
            self._status = status
            sys.stdout.write(f"\r{status}\x1b[K")
            sys.stdout.flush()


class SpaceMousePeer(PuckPeer[SimulatedSpaceMouse]):
    """A simulated 3Dconnexion device with HID reports.

    Raises ConfigurationError unless exactly one backend is given, OptionError for an unknown model,
    ScriptError for an unknown or unsuitable script or fault.
    """

    def __init__(self, options: SpaceMousePeerOptions) -> None:
        super().__init__(*_made(options), options)


def _backend_option(options: SpaceMousePeerOptions) -> str:
    """Return the only given option that selects a backend. Raises ConfigurationError."""
    ways = {
        "--hid": bool(options.hid),
        "--uhid": options.uhid,
        "--usbip": options.usbip is not None,
    }
    given = [way for way, there in ways.items() if there]
    if len(given) != 1:
        found = " and ".join(given) if given else "none"
        raise ConfigurationError(", ".join(ways), f"give one way to open the device, not {found}")
    return given[0]


def _made(options: SpaceMousePeerOptions) -> tuple[SimulatedSpaceMouse, DeviceBackend[bytes]]:
    """Return the device, and the backend for its reports."""
    backend = _backend_option(options)
    try:
        model = model_by_key(options.model)
    except KeyError:
        allowed = f"one of {', '.join(model.key for model in MODELS)}"
        raise OptionError("model", options.model, allowed) from None
    for name, why in UNFIT_FAULTS.get(backend, {}).items():
        if name in options.faults:
            raise ScriptError(f"fault {name}: {why}")
    device = SimulatedSpaceMouse(
        model, faults=options.faults, jitter_lsb=options.jitter_lsb, seed=options.seed
    )
    if options.hid:
        keep_oldest = bool(options.faults.get("newest-lost"))
        return device, ReportSocket(
            options.hid, device.output, keep_oldest=keep_oldest, mode=options.mode
        )
    if options.usbip is not None:
        return device, _usbip(options, options.usbip, device)
    # Linux's hid-logitech claims Logitech's ids on USB, and refuses all but real USB hardware.
    cable = model.vendor_id == CONNEXION and model.key not in BLUETOOTH_MODELS
    identity = HidIdentity(
        name=f"3Dconnexion {model.name}",
        bus=BUS_USB if cable else BUS_BLUETOOTH,
        vendor_id=model.vendor_id,
        product_id=model.product_id,
        descriptor=descriptor_for(model),
        physical_path=options.physical_path,
    )
    return device, UhidBackend(identity, device.output, options.uhid_path)


def _usbip(
    options: SpaceMousePeerOptions, port: int, device: SimulatedSpaceMouse
) -> DeviceBackend[bytes]:
    """Return the backend of the USB device over USB/IP."""
    usb = SpaceMouseUsb(
        device.model, lambda report: device.output(report, backend.shell.device_s())
    )
    backend = UsbipBackend(usb, options.host, port, options.bus_id)
    return backend


class SpaceMouseCommand(PeerCommand[SpaceMousePeerOptions]):
    """A 3Dconnexion device (HID reports), moved by a script or by the keyboard."""

    Options, Peer = SpaceMousePeerOptions, SpaceMousePeer
    page = "simulated-peers.md"
    example = "--hid spacemouse.sock --script demo"
    speaks = (
        "[HID reports](spacemouse.md#hid-reports-byte-for-byte), one per packet of a Unix socket, "
        "by uhid or USB/IP"
    )
    epilog = "Prints READY and where it is once it can be opened."
    faults, scripts, verbs = FAULTS, SCRIPTS, SCRIPT_VERBS
