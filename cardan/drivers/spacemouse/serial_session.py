"""Talks to a serial device: finds out what it is, starts it, and watches that it is there.

Without any I/O and in the caller's time: bytes in, bytes and reports out. What it reports is what a
HID device would: `Motion` and `ButtonBits`, in the raw frame of the HID devices.
"""

from __future__ import annotations

from collections import deque

from cardan.protocols.connexion import (
    ButtonBits,
    Family,
    InputReport,
    MalformedReport,
    Model,
    Motion,
)
from cardan.protocols.connexion_serial import (
    MagellanEcho,
    MagellanError,
    MagellanKeys,
    MagellanMotion,
    MagellanReader,
    MagellanVersion,
    Malformed,
    OrbKeys,
    OrbMotion,
    OrbReader,
    OrbReset,
    SerialModel,
    SpaceballAdvancedKeys,
    SpaceballEcho,
    SpaceballError,
    SpaceballKeys,
    SpaceballMotion,
    SpaceballReader,
    SpaceballReset,
    button_mask,
    magellan,
    model_of_firmware,
    model_of_version,
    serial_model_by_key,
    spaceball,
    to_hid_counts,
)

DETECT_TIMEOUT_S = 3.0
"""A device that was just given power takes a second to start, and some are asked twice."""
ANSWER_TIMEOUT_S = 0.25
"""Wait for the answer to a command; a device that knows it not may say nothing."""
FIRMWARE_TIMEOUT_S = 0.4
"""Wait for the line of a Spaceball's banner that tells its firmware."""
QUIET_S = 0.5
"""A Magellan or Spaceball that has been quiet for so long is asked for its keys."""
GONE_AFTER_S = 1.2
"""One that does not answer that is gone."""
ORB_GONE_AFTER_S = 2.5
"""A SpaceOrb says something each second by itself."""

_PROBE_MAGELLAN = b"\r" + magellan.QUERY_VERSION + b"\r"
_PROBE_SPACEBALL = b"\r" + spaceball.RESET + b"\r"
_PROBES = (
    (0.0, "magellan", _PROBE_MAGELLAN),
    (0.4, "magellan", _PROBE_MAGELLAN),
    (0.7, "spaceball", _PROBE_SPACEBALL),
    (1.2, "magellan", _PROBE_MAGELLAN),
    (1.7, "magellan", _PROBE_MAGELLAN),
    (2.0, "spaceball", _PROBE_SPACEBALL),
)
"""When each kind is asked who it is. A SpaceOrb needs no question."""
_START = {
    "magellan": (
        magellan.MODE_3D,
        magellan.EXTENDED_COMPRESSED,
        magellan.DEFAULT_SENSITIVITY,
        magellan.PERIODS_60_MS,
        magellan.QUERY_KEYS,
    ),
    "spaceball": (
        spaceball.BINARY,
        spaceball.RATE_20_HZ,
        spaceball.SEND_VECTORS,
        spaceball.QUERY_KEYS,
    ),
    "spaceorb": (),
}
"""What starts each kind, one command after the other's answer."""
_QUERY = {
    "magellan": magellan.QUERY_KEYS + b"\r",
    "spaceball": spaceball.QUERY_KEYS + b"\r",
    "spaceorb": b"",
}


def device_model(model: SerialModel) -> Model:
    """`model` as the core takes it."""
    return Model(
        vendor_id=0,
        product_id=0,
        name=model.name,
        key=model.key,
        family=Family.ONE,
        buttons=model.buttons,
        full_scale=model.full_scale,
    )


class SerialSession:
    """One conversation with the device at a port that was just opened.

    `model` is what is said to be there; None: whatever answers. Times are monotonic, s.
    """

    def __init__(self, model: SerialModel | None, now_s: float) -> None:
        self.model: SerialModel | None = None
        """What has answered."""
        self.running = False
        """True: it was started, and reports."""
        self._wanted = model
        self._began_s = now_s
        self._heard_s = now_s
        self._asked_s = now_s
        self._magellan = MagellanReader()
        self._spaceball = SpaceballReader()
        self._orb = OrbReader()
        self._probes = deque(
            (now_s + after_s, words)
            for after_s, protocol, words in _PROBES
            if model is None or model.protocol == protocol
        )
        self._banner_s: float | None = None
        self._commands: deque[bytes] = deque()
        self._answer_by_s = now_s
        self._to_send = bytearray()
        self._reports: list[InputReport] = []
        self._orb_status = -1

    # -- what happens --------------------------------------------------------------------------

    def receive(self, data: bytes, now_s: float) -> list[InputReport]:
        """Take bytes of the device; what it reports. Never raises."""
        self._reports = []
        model = self.model
        if model is None:
            self._detect(data, now_s)
        elif model.protocol == "magellan":
            for mag in self._magellan.feed(data):
                self._on_magellan(mag, model, now_s)
        elif model.protocol == "spaceball":
            for ball in self._spaceball.feed(data):
                self._on_spaceball(ball, model, now_s)
        else:
            for orb in self._orb.feed(data):
                self._on_orb(orb, model, now_s)
        return self._reports

    def send(self, now_s: float) -> bytes:
        """What to send the device now."""
        if self.model is None:
            while self._probes and self._probes[0][0] <= now_s:
                self._to_send += self._probes.popleft()[1]
            if self._banner_s is not None and now_s - self._banner_s > FIRMWARE_TIMEOUT_S:
                self._found(serial_model_by_key("spaceball-2003"), now_s)
        if self.model is not None:
            if not self.running and now_s >= self._answer_by_s:
                self._next_command(now_s)
            elif self.running and now_s - max(self._heard_s, self._asked_s) >= QUIET_S:
                self._asked_s = now_s
                self._to_send += _QUERY[self.model.protocol]
        words = bytes(self._to_send)
        self._to_send.clear()
        return words

    def failure(self, now_s: float) -> str:
        """Why it is to be given up, in words; empty: it is not."""
        if self.model is None:
            if now_s - self._began_s < DETECT_TIMEOUT_S:
                return ""
            what = "no serial device" if self._wanted is None else f"no {self._wanted.name}"
            return f"{what} answers: check that it is plugged in, and into this port"
        after_s = ORB_GONE_AFTER_S if self.model.protocol == "spaceorb" else GONE_AFTER_S
        if self.running and now_s - self._heard_s > after_s:
            return f"the {self.model.name} does not answer any more: check its cable"
        return ""

    # -- finding out what is there -------------------------------------------------------------

    def _detect(self, data: bytes, now_s: float) -> None:
        wanted = self._wanted
        protocol = None if wanted is None else wanted.protocol
        if protocol in (None, "magellan"):
            for mag in self._magellan.feed(data):
                if isinstance(mag, MagellanVersion):
                    self._found(model_of_version(mag.text), now_s)
                    return
        if protocol in (None, "spaceball"):
            for ball in self._spaceball.feed(data):
                if not isinstance(ball, SpaceballReset):
                    continue
                found = model_of_firmware(ball.text)
                if found is not None or (self._banner_s is not None and ball.text[:1] == "2"):
                    self._found(found or serial_model_by_key("spaceball-2003"), now_s)
                    return
                if ball.text[:1] == "1":
                    self._banner_s = now_s
        if protocol in (None, "spaceorb"):
            for orb in self._orb.feed(data):
                if isinstance(orb, (OrbReset, OrbKeys, OrbMotion)):
                    self._found(serial_model_by_key("spaceorb"), now_s)
                    return

    def _found(self, model: SerialModel, now_s: float) -> None:
        self.model = self._wanted or model
        self._start(now_s)

    def _start(self, now_s: float) -> None:
        assert self.model is not None
        self.running = False
        self._commands = deque(_START[self.model.protocol])
        self._next_command(now_s)

    def _next_command(self, now_s: float) -> None:
        if self._commands:
            self._to_send += self._commands.popleft() + b"\r"
            self._answer_by_s = now_s + ANSWER_TIMEOUT_S
        else:
            self.running = True
            self._heard_s = self._asked_s = now_s

    def _answered(self, now_s: float) -> None:
        if not self.running:
            self._next_command(now_s)

    # -- what it says --------------------------------------------------------------------------

    def _on_magellan(self, value: object, model: SerialModel, now_s: float) -> None:
        if isinstance(value, Malformed):
            self._malformed(value)
            return
        self._heard_s = now_s
        if isinstance(value, MagellanMotion):
            self._report(Motion._make(to_hid_counts(model, value)))
        elif isinstance(value, MagellanKeys):
            self._report(ButtonBits(value.mask))
            if not self._commands:
                self._answered(now_s)
        elif isinstance(value, (MagellanEcho, MagellanError)):
            self._answered(now_s)

    def _on_spaceball(self, value: object, model: SerialModel, now_s: float) -> None:
        if isinstance(value, Malformed):
            self._malformed(value)
            return
        self._heard_s = now_s
        if isinstance(value, SpaceballMotion):
            self._report(Motion._make(to_hid_counts(model, _rates(value, model))))
        elif isinstance(value, SpaceballAdvancedKeys):
            if model.key == "spaceball-2003" and self._wanted is None:
                # Firmware 2.42 is that of both.
                self.model = model = serial_model_by_key("spaceball-4000")
            self._report(ButtonBits(button_mask(model, value)))
            self._answered(now_s)
        elif isinstance(value, SpaceballKeys):
            # Of a 4000 FLX they are only some of its keys.
            if model.key != "spaceball-4000":
                self._report(ButtonBits(button_mask(model, value)))
                may_be_4000 = model.key == "spaceball-2003" and self._wanted is None
                if not self._commands and not may_be_4000:
                    self._answered(now_s)
        elif isinstance(value, SpaceballReset):
            if self.running and value.text[:1] == "1":  # it lost its power, and its settings
                self._start(now_s)
        elif isinstance(value, (SpaceballEcho, SpaceballError)):
            self._answered(now_s)

    def _on_orb(self, value: object, model: SerialModel, now_s: float) -> None:
        if isinstance(value, Malformed):
            self._malformed(value)
            return
        self._heard_s = now_s
        if isinstance(value, OrbMotion):
            if value.status != self._orb_status:
                self._orb_status = value.status
                self._report(ButtonBits(value.status))
            self._report(Motion._make(to_hid_counts(model, value[1:])))
        elif isinstance(value, OrbKeys):
            self._orb_status = value.status
            self._report(ButtonBits(value.status))

    def _malformed(self, value: Malformed) -> None:
        self._report(MalformedReport(value.reason, value.letter))

    def _report(self, value: InputReport) -> None:
        self._reports.append(value)


def _rates(value: SpaceballMotion, model: SerialModel) -> tuple[int, ...]:
    """Displacements as those of the usual period, rotation in the counts of translation."""
    nominal = model.period_s / spaceball.PERIOD_UNIT_S
    # The first packet after a rest tells the time since the one before that rest.
    share = nominal / value.period if 0.4 * nominal <= value.period <= 2.1 * nominal else 1.0
    turns = share * model.full_scale / model.rotation_full_scale
    return (
        round(value.tx * share),
        round(value.ty * share),
        round(value.tz * share),
        round(value.rx * turns),
        round(value.ry * turns),
        round(value.rz * turns),
    )
