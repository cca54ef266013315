"""Serves a simulated remote over Unix sockets, Bluetooth or uhid."""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass
from typing import Annotated

from cardan.common.options import require_each
from cardan.errors import ConfigurationError
from cardan.sim_peers.backends.base import DeviceBackend
from cardan.sim_peers.backends.uhid import BUS_BLUETOOTH, HidIdentity, UhidBackend
from cardan.sim_peers.base import load_script
from cardan.sim_peers.command import option
from cardan.sim_peers.device_peer import DeviceNodeOptions, DevicePeer
from cardan_wiimote.address import BLUETOOTH_ADDRESS
from cardan_wiimote.peer.core import ExtensionName, NoiseLsb, SimulatedWiimote
from cardan_wiimote.peer.l2cap import BluetoothChannels, UnixChannels, parse_address
from cardan_wiimote.peer.motion_script import SCRIPT_VERBS, SCRIPTS, ScriptedWiimote
from cardan_wiimote.protocol import (
    NINTENDO,
    SET_REPORT_HEADER,
    report_descriptor,
)

RECONNECT_S = 1.0
"""Time that a paired remote takes to reconnect by itself."""
_HANDSHAKE_OK = b"\0"

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class WiimotePeerOptions(DeviceNodeOptions):
    """Options of the simulated remote. Exactly one of `l2cap`, `bluetooth`, `uhid` is required."""

    l2cap: str = option("", "Folder for the Unix seqpacket sockets psm11 and psm13.", metavar="DIR")
    """Path of the folder; the first socket is the control channel's, the second the interrupt
    channel's."""
    bluetooth: str = option(
        "", "Real L2CAP, on the Bluetooth adapter of this address.", metavar="ADDRESS"
    )
    """00:00:00:00:00:00: any adapter."""
    uhid: bool = option(False, "A HID device of this machine's kernel (/dev/uhid).")
    address: Annotated[str, BLUETOOTH_ADDRESS] = option(
        "00:1F:32:5A:10:2B", "The remote's own, shown with --uhid.", metavar="ADDRESS"
    )
    extension: ExtensionName = option("", "What is plugged in.", metavar="nunchuk")
    """Empty: nothing."""
    motion_plus: bool = option(False, "It has a MotionPlus.")
    """Plugged in; with `tr` built in."""
    tr: bool = option(False, "The late model, RVL-CNT-01-TR.")
    noise_lsb: NoiseLsb = 1
    """Noise of the accelerometers, counts."""

    def __post_init__(self) -> None:
        super().__post_init__()
        good = not self.bluetooth or self.bluetooth in BLUETOOTH_ADDRESS
        require_each(self, ("bluetooth", good, f"empty or {BLUETOOTH_ADDRESS}"))


class UhidRemote(UhidBackend):
    """HID device that the Linux kernel treats as a remote connected over Bluetooth."""

    def __init__(self, remote: SimulatedWiimote, address: str) -> None:
        parse_address(address)
        identity = HidIdentity(
            name=remote.model.bluetooth_name,
            bus=BUS_BLUETOOTH,
            vendor_id=NINTENDO,
            product_id=remote.model.product_id,
            descriptor=report_descriptor(),
            serial=address.lower(),
        )
        super().__init__(identity, remote.output)
        self._remote = remote
        self._address = address
        self._again_s = 0.0

    @property
    def endpoint(self) -> str:
        """Address of the remote."""
        return f"uhid {self._address}"

    def appear(self) -> None:
        """Connect, unless it has just disconnected."""
        # The kernel is the host: the link is up at once.
        if time.monotonic() >= self._again_s:
            self.shell.begin()
            if self._remote.connect(self.shell.device_s()):
                super().appear()

    def vanish(self) -> None:
        """Disconnect, once the remote has dropped the link."""
        if not self._remote.connected:
            self._hang_up()

    def run_due(self, now_s: float) -> None:
        """Disconnect after the remote has closed a channel: the kernel drops a device at either."""
        if not (self._remote.control_open and self._remote.interrupt_open):
            self._hang_up()

    def close(self) -> None:
        """Destroy the device and close the file."""
        super().close()
        self._remote.disconnect(self.shell.device_s())

    def _hang_up(self) -> None:
        if self.there:
            super().vanish()
            self._again_s = time.monotonic() + RECONNECT_S
            self._remote.disconnect(self.shell.device_s())

    def _set_report(self, report: bytes) -> bool:
        """Handle an output report as one of the control channel."""
        packet = bytes((SET_REPORT_HEADER,)) + report
        return self._remote.control(packet, self.shell.device_s()) == _HANDSHAKE_OK


class WiimotePeer(DevicePeer[SimulatedWiimote, bytes]):
    """Simulated remote that one host at a time can connect to, repeatedly.

    Raises ScriptError for an unknown or unsuitable script or fault.
    """

    def __init__(self, options: WiimotePeerOptions) -> None:
        ways = (options.l2cap, options.bluetooth, options.uhid)
        if sum(map(bool, ways)) != 1:
            raise ConfigurationError(
                "l2cap, bluetooth, uhid", "give exactly one way to reach the remote"
            )
        remote = SimulatedWiimote(
            extension=options.extension,
            motion_plus=options.motion_plus,
            tr=options.tr,
            faults=options.faults,
            noise_lsb=options.noise_lsb,
            seed=options.seed,
        )
        motion = ScriptedWiimote(
            load_script(options.script, SCRIPTS, SCRIPT_VERBS), options.extension
        )
        backend: DeviceBackend[bytes]
        if options.l2cap:
            backend = UnixChannels(remote, options.l2cap, options.mode)
        elif options.bluetooth:
            backend = BluetoothChannels(remote, options.bluetooth)
        else:
            backend = UhidRemote(remote, options.address)
        super().__init__(remote, motion, backend, options)
        self._logged = 0

    def _follow(self, now_s: float) -> None:
        """Log changes of the remote that the host caused."""
        super()._follow(now_s)
        remote = self.device
        while self._logged < remote.logged:
            entry = remote.log[max(self._logged - remote.logged, -len(remote.log))]
            level = logging.DEBUG if entry.what.startswith("rumble") else logging.INFO
            _log.log(level, "%.3f s: %s", entry.time_s, entry.what)
            self._logged += 1
