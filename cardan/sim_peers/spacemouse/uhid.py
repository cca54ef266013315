"""A simulated 3Dconnexion device that the Linux kernel takes for a real one, through /dev/uhid.

It gets a real /dev/hidraw node (and an evdev one), so every program can use it as if it were
plugged in. Needs the right to write to /dev/uhid: root, as a rule.
"""

from __future__ import annotations

import errno
import selectors
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from cardan.protocols.connexion import CONNEXION, Model
from cardan.protocols.connexion.descriptors import descriptor_for
from cardan.sim_peers.spacemouse.shell import PuckOptions, PuckPeer
from cardan.sim_peers.uhid import (
    BUS_BLUETOOTH,
    BUS_USB,
    OUTPUT_REPORT,
    UHID_PATH,
    GetReport,
    HidIdentity,
    Open,
    Output,
    SetReport,
    UhidDevice,
)

BLUETOOTH_MODELS = frozenset({"spacemouse-wireless-bt", "spacemouse-pro-wireless-bt"})
"""Models that need no cable and no receiver."""


@dataclass(frozen=True, kw_only=True)
class UhidSpaceMousePeerOptions(PuckOptions):
    """What to simulate, and through which file."""

    path: str = UHID_PATH
    """The kernel's file."""
    physical_path: str = "cardan/uhid"
    """Where the kernel is told that the device is plugged in, to tell several apart."""


class UhidSpaceMousePeer(PuckPeer):
    """A simulated device of the kernel's; unplugging makes its nodes vanish.

    Raises ScriptError for a model, script or fault that does not exist or does not fit.
    """

    unfit_faults: Mapping[str, str] = MappingProxyType(
        {
            "refuse": "the kernel opens the device, which cannot refuse",
            "newest-lost": "the kernel keeps the queue, and always loses the newest",
        }
    )

    def __init__(self, options: UhidSpaceMousePeerOptions) -> None:
        super().__init__(options)
        self.options = options
        model = self.device.model
        self.identity = HidIdentity(
            name=f"3Dconnexion {model.name}",
            bus=_bus(model),
            vendor_id=model.vendor_id,
            product_id=model.product_id,
            descriptor=descriptor_for(model),
            physical_path=options.physical_path,
        )
        self._uhid = UhidDevice(options.path)
        self._plugged = False

    @property
    def endpoint(self) -> str:
        """What programs look for: vendor and product id."""
        return f"{self.identity.vendor_id:04x}:{self.identity.product_id:04x}"

    def close(self) -> None:
        """Unplug the device for good, give the terminal back."""
        super().close()
        self._uhid.close()

    @property
    def _there(self) -> bool:
        return self._plugged

    def _appear(self) -> None:
        assert self._selector is not None
        if self._uhid.fileno() < 0:
            self._uhid.open()
            self._selector.register(self._uhid.fileno(), selectors.EVENT_READ, self._serve)
        self._uhid.plug(self.identity)
        self._plugged = True

    def _vanish(self) -> None:
        self._plugged = False
        if self._uhid.fileno() >= 0:
            self._uhid.unplug()

    def _deliver(self, reports: Sequence[bytes]) -> None:
        for report in reports:
            self._uhid.send(report)

    def _serve(self) -> None:
        """Take what the kernel has for the device."""
        while (event := self._uhid.read()) is not None:
            if isinstance(event, Open):
                self._begin()
            elif isinstance(event, Output):
                self._take_output(event.data)
            elif isinstance(event, SetReport):
                taken = event.report_type == OUTPUT_REPORT
                if taken:
                    self._take_output(event.data)
                self._uhid.reply_to(event, 0 if taken else errno.EIO)
            elif isinstance(event, GetReport):
                self._uhid.reply_to(event, errno.EIO)


def _bus(model: Model) -> int:
    """Where the kernel is told that `model` is.

    Linux's hid-logitech claims Logitech's ids on USB, and refuses what is not real USB hardware.
    """
    cable = model.vendor_id == CONNEXION and model.key not in BLUETOOTH_MODELS
    return BUS_USB if cable else BUS_BLUETOOTH
