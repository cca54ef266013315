"""Serves a simulated remote over Unix sockets, Bluetooth or uhid."""

from __future__ import annotations

import logging
import selectors
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from cardan import bounds
from cardan.errors import ConfigurationError
from cardan.options import check_options, require_each
from cardan.protocols.wiimote import SET_REPORT_HEADER, WIIMOTE, WIIMOTE_TR
from cardan.sim_peers.base import load_script
from cardan.sim_peers.command import option
from cardan.sim_peers.hand_peer import HandPeer
from cardan.sim_peers.wiimote.carriers import (
    BluetoothChannels,
    Carrier,
    UhidCarrier,
    UnixChannels,
)
from cardan.sim_peers.wiimote.core import TICK_S, ExtensionName, NoiseLsb, SimulatedWiimote
from cardan.sim_peers.wiimote.hand import SCRIPT_VERBS, SCRIPTS, ScriptedHand

STALL_S = 2.0 * TICK_S
"""Data older than this when the peer comes to run are left out: a late peer makes no burst."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class WiimotePeerOptions:
    """What to simulate and where. Exactly one of `l2cap`, `bluetooth` and `uhid` must be given."""

    l2cap: str = option("", "Folder for the Unix seqpacket sockets psm11 and psm13.", metavar="DIR")
    """The first is the control channel's, the second the interrupt channel's."""
    bluetooth: str = option(
        "", "Real L2CAP, on the Bluetooth adapter of this address.", metavar="ADDRESS"
    )
    """00:00:00:00:00:00: any adapter."""
    uhid: bool = option(False, "A HID device of this machine's kernel (/dev/uhid).")
    address: Annotated[str, bounds.BLUETOOTH_ADDRESS] = option(
        "00:1F:32:5A:10:2B", "The remote's own, shown with --uhid.", metavar="ADDRESS"
    )
    extension: ExtensionName = option("", "What is plugged in.", metavar="nunchuk")
    """Empty: nothing."""
    motion_plus: bool = option(False, "It has a MotionPlus.")
    """Plugged in; with `tr` built in."""
    tr: bool = option(False, "The late model, RVL-CNT-01-TR.")
    script: str = "demo"
    """A built-in script or a file."""
    faults: Mapping[str, float] = field(default_factory=dict)
    """Values by the names of `FAULTS`; times count from the start of the script."""
    noise_lsb: NoiseLsb = 1
    """Noise of the accelerometers, counts."""
    seed: int = 0
    """Of the noise and of the faults' choices."""
    start_on_connect: bool = True
    """The script starts when the first host connects, not when the peer opens."""

    def __post_init__(self) -> None:
        check_options(self)
        good = not self.bluetooth or self.bluetooth in bounds.BLUETOOTH_ADDRESS
        require_each(self, ("bluetooth", good, f"empty or {bounds.BLUETOOTH_ADDRESS}"))


class WiimotePeer(HandPeer):
    """A simulated remote that one host at a time can connect to, again and again.

    Raises ScriptError for a script or fault that does not exist or does not fit.
    """

    def __init__(self, options: WiimotePeerOptions) -> None:
        super().__init__()
        ways = (options.l2cap, options.bluetooth, options.uhid)
        if sum(map(bool, ways)) != 1:
            raise ConfigurationError(
                "l2cap, bluetooth, uhid", "give exactly one way to reach the remote"
            )
        self.options = options
        self.remote = SimulatedWiimote(
            extension=options.extension,
            motion_plus=options.motion_plus,
            tr=options.tr,
            faults=options.faults,
            noise_lsb=options.noise_lsb,
            seed=options.seed,
        )
        steps = load_script(options.script, SCRIPTS, SCRIPT_VERBS)
        self._hand = ScriptedHand(steps, options.extension)
        self._carrier: Carrier
        if options.l2cap:
            self._carrier = UnixChannels(options.l2cap)
        elif options.bluetooth:
            self._carrier = BluetoothChannels(options.bluetooth)
        else:
            model = WIIMOTE_TR if options.tr else WIIMOTE
            self._carrier = UhidCarrier(model, options.address)
        self._opened_s = 0.0
        self._logged = 0

    @property
    def endpoint(self) -> str:
        """The sockets' directory, or how else to reach it."""
        return self._carrier.endpoint

    @property
    def lost_reports(self) -> int:
        """Reports that the host was too slow for."""
        return self._carrier.lost_reports

    def open(self) -> None:
        """Listen; AddressError or DeviceAccessError when that cannot be."""
        if self._selector is not None:
            return
        self._opened_s = time.monotonic()
        self._selector = selectors.DefaultSelector()
        if not self.options.start_on_connect:
            self._start_s = self._opened_s
        try:
            self._carrier.open(self._selector, self)
            self._follow(self._opened_s)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close every channel and remove the sockets, or the device."""
        if self._selector is None:
            return
        self._carrier.close()
        self.remote.disconnect(self._device_s())
        self._selector.close()
        self._selector = None
        self._start_s = None

    # -- what the carrier tells ----------------------------------------------------------------

    def connected(self) -> bool:
        """A host has opened both channels."""
        self._begin()
        return self.remote.connect(self._device_s())

    def disconnected(self) -> None:
        """The host has closed a channel."""
        self.remote.disconnect(self._device_s())

    def interrupt(self, packet: bytes) -> None:
        """Take a packet of the interrupt channel."""
        self.remote.interrupt(packet, self._device_s())

    def control(self, packet: bytes) -> bytes:
        """Take a packet of the control channel; the answer there."""
        return self.remote.control(packet, self._device_s())

    def output(self, report: bytes) -> None:
        """Take an output report."""
        self.remote.output(report, self._device_s())

    def set_report(self, report: bytes) -> bool:
        """Take an output report sent the old way; False: refused."""
        answer = self.remote.control(bytes((SET_REPORT_HEADER,)) + report, self._device_s())
        return answer == b"\x00"

    # -- time ----------------------------------------------------------------------------------

    @property
    def _hand_due_s(self) -> float:
        return min(self.remote.next_due_s, self._hand.next_due_s)

    def _play(self, now_s: float) -> None:
        if self._start_s is not None:
            until_s = now_s - self._start_s
            if until_s - self._played_s > STALL_S:
                self.remote.skip_to(until_s - STALL_S)
            self._played_s = until_s
            while self._hand.next_due_s <= until_s:
                due_s = self._hand.next_due_s
                self._send(due_s)
                self._hand.advance(due_s, self.remote)
            self._send(until_s)

    def _send(self, until_s: float) -> None:
        for report in self.remote.reports(until_s):
            self._carrier.send(report)

    def _follow(self, now_s: float) -> None:
        """Open and close channels as the remote does."""
        remote, carrier = self.remote, self._carrier
        if carrier.interrupt_up or (carrier.control_up and remote.connected):
            control = carrier.control_up and not remote.control_open
            interrupt = carrier.interrupt_up and not remote.interrupt_open
            if control or interrupt:
                carrier.hang_up(control=control, interrupt=interrupt)
        refused = now_s - self._opened_s < self.options.faults.get("refuse", 0.0)
        if remote.powered and remote.in_range and not refused:
            carrier.appear()
        else:
            carrier.vanish()
            if not remote.connected:
                carrier.hang_up(control=True, interrupt=True)
        while self._logged < remote.logged:
            entry = remote.log[max(self._logged - remote.logged, -len(remote.log))]
            level = logging.DEBUG if entry.what.startswith("rumble") else logging.INFO
            _log.log(level, "%.3f s: %s", entry.time_s, entry.what)
            self._logged += 1
