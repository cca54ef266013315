"""Session with a serial device: identifies its model, starts it, and watches the connection.

Sans-I/O in the caller's time: bytes in, bytes and reports out. Reports are those of a HID device:
`MotionReport` and `ButtonBits`, in the raw frame of the HID devices.

Motion is repeated: the next packet replaces a lost one. A change of the keys is sent once: while a
key is down, and after every unreadable packet, the session requests them.

Packets of a Spaceball carry no check: impossible motion is refused, and implausible motion is
held until the packet after it (`jumps`).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from cardan.protocols.connexion.devices import Family, Model
from cardan.protocols.connexion.reports import ButtonBits, InputReport, MotionReport
from cardan.protocols.hid import MalformedReport
from cardan_serial_mice.driver.jumps import JUMP, JumpGuard
from cardan_serial_mice.driver.notices import Doubt, Lapse, Notice, Restart
from cardan_serial_mice.protocol import (
    Counts,
    MagellanCompressedMotion,
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
"""A device that was just powered takes a second to start, and some need a second request."""
ANSWER_TIMEOUT_S = 0.25
"""Wait for the answer to a command; an unknown one may get none."""
FIRMWARE_TIMEOUT_S = 0.4
"""Wait for the firmware line of a Spaceball's banner."""
QUIET_S = 0.5
"""Silence after which the keys of a Magellan or Spaceball are requested."""
ASK_AFTER_S = 0.12
"""Period of that request while a key is down, independent of other packets."""
KEYS_TIMEOUT_S = 0.15
"""A key counts as released if its device does not answer within this time."""
PAUSE_S = 0.05
"""Pause between two requests: a Magellan accepts no more than five bytes in a row."""
REST_AFTER_PERIODS = 3.0
"""Periods without motion after which a deflected Spaceball that answers counts as at rest: not all
models may report it."""
REST_ANSWERS = 2
"""Consecutive answers that confirm it, because the first may be older."""
GONE_AFTER_S = 1.2
"""Silence after which a Magellan or Spaceball counts as gone, in spite of requests."""
ORB_GONE_AFTER_S = 2.5
"""The same for a SpaceOrb, which sends a packet each second by itself."""
MOST_OF_FULL_SCALE = 3.0
"""Largest value of a Spaceball's axis; 20000 counts, 2.5 full scales of translation, were
observed."""
OUT_OF_RANGE = "beyond what the device can give"
JUMPED = "far from those around them"

_D = ord("D")

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
"""Times of the identity requests of each kind. A SpaceOrb needs none."""


class _Kind(NamedTuple):
    """Reader and start-up commands of the devices of a protocol."""

    reader: type[MagellanReader | SpaceballReader | OrbReader]
    start: tuple[bytes, ...] = ()
    """Start commands, each sent after the answer to the previous one."""
    query: bytes = b""
    """Request for the keys; empty: there is none."""
    gone_after_s: float = GONE_AFTER_S


_KINDS = {
    "magellan": _Kind(
        MagellanReader,
        (
            magellan.MODE_3D,
            magellan.EXTENDED_COMPRESSED,
            magellan.DEFAULT_SENSITIVITY,
            magellan.PERIODS_60_MS,
            magellan.QUERY_KEYS,
        ),
        magellan.QUERY_KEYS,
    ),
    "spaceball": _Kind(
        SpaceballReader,
        (
            spaceball.BINARY,
            spaceball.RATE_20_HZ,
            spaceball.SEND_VECTORS,
            spaceball.QUERY_KEYS,
        ),
        spaceball.QUERY_KEYS,
    ),
    "spaceorb": _Kind(OrbReader, gone_after_s=ORB_GONE_AFTER_S),
}

_GREETING = "Version"
"""Word in a Magellan's version text."""


def device_model(model: SerialModel) -> Model:
    """Return `model` in the form for the core."""
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
    """Session with the device at a port that was just opened.

    `model` is the configured model; None: any that answers. Times are monotonic, s.
    """

    def __init__(self, model: SerialModel | None, now_s: float) -> None:
        self.model: SerialModel | None = None
        """Model that has answered."""
        self.running = False
        """True: it was started, and reports."""
        self._wanted = model
        self._began_s = now_s
        self._heard_s = now_s
        self._asked_s = now_s
        self._readers = {
            protocol: kind.reader()
            for protocol, kind in _KINDS.items()
            if model is None or model.protocol == protocol
        }
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
        self._notices: list[Notice] = []
        self._orb_status = -1
        self._sent = b""
        """Command without an answer so far."""
        self._versions_asked = 0
        self._compressed = False
        """The device has confirmed that its data are compressed from now on."""
        self._lapsed = False
        """The device is being started again."""
        self._held = False
        """A key is down."""
        self._suspicious = False
        """Unreadable bytes may have been a change of the keys."""
        self._unanswered_s: float | None = None
        """Time of the request for the keys that was not answered yet."""
        self._doubted = False
        self._mode_asked_s = now_s
        self._motion_s = now_s
        self._rests_owed = 0
        self._jumps = JumpGuard(math.inf)
        """Plausibility check of a Spaceball's motion, with limits once the model is known."""
        self._take: dict[str, Callable[[object, SerialModel, float], None]] = {
            "magellan": self._on_magellan,
            "spaceball": self._on_spaceball,
            "spaceorb": self._on_orb,
        }

    # -- what happens --------------------------------------------------------------------------

    def receive(self, data: bytes, now_s: float) -> list[InputReport]:
        """Handle bytes of the device; return its reports. Never raises."""
        reports: list[InputReport] = []
        self._reports = reports
        model = self.model
        if model is None:
            self._detect(data, now_s)
        else:
            take = self._take[model.protocol]
            for value in self._readers[model.protocol].feed(data):
                take(value, model, now_s)
        return reports

    def notices(self, now_s: float) -> list[Notice]:
        """Return the notices about the device since the last call."""
        if (
            self.running
            and self._held
            and not self._doubted
            and self._unanswered_s is not None
            and now_s - self._unanswered_s > KEYS_TIMEOUT_S
        ):
            self._doubted = True
            self._jumps.reset()
            assert self.model is not None
            self._notices.append(
                Doubt(
                    f"the {self.model.name} does not say which buttons are down: check its cable, "
                    "then touch the cap and let go once"
                )
            )
        notices = self._notices
        if notices:
            self._notices = []
        return notices

    def send(self, now_s: float) -> bytes:
        """Return the bytes to send to the device now."""
        if self.model is None:
            # A device that has begun its banner must not be reset during it.
            while self._probes and self._probes[0][0] <= now_s and self._banner_s is None:
                _, words = self._probes.popleft()
                self._versions_asked += words == _PROBE_MAGELLAN
                self._to_send += words
            if self._banner_s is not None and now_s - self._banner_s > FIRMWARE_TIMEOUT_S:
                self._found(serial_model_by_key("spaceball-2003"), now_s)
        if self.model is not None:
            if not self.running and now_s >= self._answer_by_s:
                self._next_command(now_s)
                self._suspicious = True  # The last command is the request for the keys.
            elif self.running:
                self._ask(self.model, now_s)
        words = bytes(self._to_send)
        self._to_send.clear()
        return words

    def failure(self, now_s: float) -> str:
        """Return why the device must be given up; empty: no reason."""
        if self.model is None:
            if now_s - self._began_s < DETECT_TIMEOUT_S:
                return ""
            what = "no serial device" if self._wanted is None else f"no {self._wanted.name}"
            return f"{what} answers: check that it is plugged in, and into this port"
        gone_after_s = _KINDS[self.model.protocol].gone_after_s
        if self.running and now_s - self._heard_s > gone_after_s:
            return f"the {self.model.name} does not answer any more: check its cable"
        return ""

    # -- finding out what is there -------------------------------------------------------------

    def _detect(self, data: bytes, now_s: float) -> None:
        for reader in self._readers.values():
            for value in reader.feed(data):
                if model := self._recognized(value, now_s):
                    self._found(model, now_s)
                    return

    def _recognized(self, value: object, now_s: float) -> SerialModel | None:
        """Return the model that sends `value`; None: more is needed."""
        if isinstance(value, MagellanVersion):
            self._versions_asked -= 1
            return model_of_version(value.text)
        if isinstance(value, SpaceballReset):
            found = model_of_firmware(value.text)
            if found is None and self._banner_s is not None and value.text[:1] == "2":
                return serial_model_by_key("spaceball-2003")
            if found is None and value.text[:1] == "1":
                self._banner_s = now_s
            return found
        if isinstance(value, (OrbReset, OrbKeys, OrbMotion)):
            return serial_model_by_key("spaceorb")
        return None

    def _found(self, model: SerialModel, now_s: float) -> None:
        self.model = self._wanted or model
        self._start(now_s)

    def _start(self, now_s: float) -> None:
        assert self.model is not None
        self.running = False
        self._compressed = False
        self._jumps = JumpGuard(JUMP * self.model.full_scale)
        self._commands = deque(_KINDS[self.model.protocol].start)
        self._next_command(now_s)

    def _next_command(self, now_s: float) -> None:
        if self._commands:
            self._sent = self._commands.popleft()
            self._to_send += self._sent + b"\r"
            self._answer_by_s = now_s + ANSWER_TIMEOUT_S
            return
        self.running = True
        self._sent = b""
        self._heard_s = self._asked_s = self._mode_asked_s = now_s
        self._unanswered_s = None
        self._rests_owed = 0
        if self._lapsed:
            assert self.model is not None
            self._lapsed = False
            self._notices.append(Restart(device_model(self.model), self.model.period_s))

    def _lapse(self, model: SerialModel, now_s: float) -> None:
        """Handle a restart of the device: it has default settings, and takes the cap's present
        position for rest."""
        if self.running:
            self._lapsed = True
            self._held = self._suspicious = self._doubted = False
            self._orb_status = -1
            self._reports.clear()
            self._notices.append(
                Lapse(f"the {model.name} has lost its power for a moment and is started again")
            )
        self._start(now_s)

    def _answered(self, now_s: float) -> None:
        if not self.running:
            self._next_command(now_s)

    # -- asking a device that runs ---------------------------------------------------------------

    def _ask(self, model: SerialModel, now_s: float) -> None:
        """Request the keys, or check that it still has its settings, when that is due."""
        since_s = now_s - self._asked_s
        keys = _KINDS[model.protocol].query
        if not keys or since_s < PAUSE_S:
            return
        quiet = now_s - max(self._heard_s, self._asked_s) >= QUIET_S
        at_rest = self._rests_owed and now_s - self._motion_s >= _rest_after_s(model)
        if quiet or self._suspicious or (since_s >= ASK_AFTER_S and (self._held or at_rest)):
            self._suspicious = False
            if self._unanswered_s is None:
                self._unanswered_s = now_s
        elif (
            self._compressed
            and now_s - self._mode_asked_s >= QUIET_S
            and now_s - self._motion_s >= QUIET_S
            and self._unanswered_s is None
        ):
            self._mode_asked_s = now_s
            keys = self._sent = magellan.QUERY_EXTENDED
        else:
            return
        self._asked_s = now_s
        self._to_send += keys + b"\r"

    def _keys(self, mask: int, now_s: float) -> None:
        """Handle the device's report of pressed keys."""
        if self._rests_owed and self._unanswered_s is not None:
            assert self.model is not None
            if self._unanswered_s - self._motion_s >= _rest_after_s(self.model):
                self._rests_owed -= 1
                self._jumps.reset()
                self._report(MotionReport(0, 0, 0, 0, 0, 0))
        self._unanswered_s = None
        self._doubted = False
        self._held = mask != 0
        self._heard_s = now_s
        self._report(ButtonBits(mask))

    def _on_error(self, now_s: float) -> None:
        """Handle a refusal by the device, or noise."""
        if self.running:
            self._suspicious = True
        else:
            self._next_command(now_s)

    def _is_answer(self, letter: bytes, now_s: float) -> bool:
        """Return True if a packet of `letter` answers the last command, which is then done."""
        if self._sent[:1] != letter or (self.running and now_s - self._asked_s > QUIET_S):
            # Noise, or keys changed to another packet by it; rarely the device's own action.
            self._suspicious = True
            return False
        self._sent = b""
        return True

    # -- what it says --------------------------------------------------------------------------

    def _on_magellan(self, value: object, model: SerialModel, now_s: float) -> None:
        if isinstance(value, Malformed):
            self._malformed(value, now_s)
        elif isinstance(value, MagellanMotion):
            if isinstance(value, MagellanCompressedMotion):
                self._compressed = True
            elif self._compressed and self.running:
                self._lapse(model, now_s)
                return
            self._heard_s = self._motion_s = now_s
            self._report(MotionReport._make(to_hid_counts(model, value)))
        elif isinstance(value, MagellanKeys):
            self._keys(value.mask, now_s)
            if not self._commands:
                self._answered(now_s)
        elif isinstance(value, MagellanEcho):
            if value.command == magellan.EXTENDED_COMPRESSED:
                self._compressed = True
            if self._is_answer(value.command[:1], now_s):
                self._on_echo(value.command, model, now_s)
        elif isinstance(value, MagellanError):
            if self._sent == magellan.QUERY_EXTENDED:
                self._mode_asked_s = math.inf  # It does not know that request.
            self._on_error(now_s)
        elif isinstance(value, MagellanVersion):
            self._suspicious = True
            if _GREETING in value.text:
                self._versions_asked -= 1
                if self._versions_asked < 0:
                    self._lapse(model, now_s)

    def _on_echo(self, command: bytes, model: SerialModel, now_s: float) -> None:
        """Handle the answer to the last command."""
        if not self.running:
            self._next_command(now_s)
        elif len(command) != 3 or command[2] not in magellan.ALPHABET:
            self._suspicious = True
        elif command[2] & magellan.COMPRESSED_BITS == magellan.COMPRESSED_BITS:
            self._heard_s = now_s
        else:
            self._lapse(model, now_s)

    def _on_spaceball(self, value: object, model: SerialModel, now_s: float) -> None:
        if not isinstance(value, (SpaceballMotion, SpaceballKeys, SpaceballAdvancedKeys)):
            self._jumps.miss()  # It may have been motion.
        if isinstance(value, Malformed):
            self._malformed(value, now_s)
        elif isinstance(value, SpaceballMotion):
            self._on_spaceball_motion(value, model, now_s)
        elif isinstance(value, SpaceballAdvancedKeys):
            if model.key == "spaceball-2003" and self._wanted is None:
                # Firmware 2.42 exists in both.
                self.model = model = serial_model_by_key("spaceball-4000")
            self._keys(button_mask(model, value), now_s)
            self._answered(now_s)
        elif isinstance(value, SpaceballKeys):
            # A 4000 FLX reports only some of its keys in them.
            if model.key != "spaceball-4000":
                self._keys(button_mask(model, value), now_s)
                may_be_4000 = model.key == "spaceball-2003" and self._wanted is None
                if not self._commands and not may_be_4000:
                    self._answered(now_s)
        elif isinstance(value, SpaceballReset):
            if value.text[:1] == "1":
                self._lapse(model, now_s)
        elif isinstance(value, SpaceballEcho):
            if self._is_answer(bytes((value.letter,)), now_s):
                self._answered(now_s)
        elif isinstance(value, SpaceballError):
            self._on_error(now_s)

    def _on_spaceball_motion(
        self, value: SpaceballMotion, model: SerialModel, now_s: float
    ) -> None:
        rates = _rates(value, model)
        if rates is None:
            self._malformed(Malformed(OUT_OF_RANGE, _D), now_s)
            counts = self._jumps.refuse()
        else:
            self._heard_s = self._motion_s = now_s
            self._rests_owed = REST_ANSWERS if any(value[1:]) else 0
            counts, garbled = self._jumps.judge(rates)
            if garbled:
                self._malformed(Malformed(JUMPED, _D), now_s)
        if counts is not None:
            self._report(MotionReport._make(to_hid_counts(model, counts)))

    def _on_orb(self, value: object, model: SerialModel, now_s: float) -> None:
        if isinstance(value, Malformed):
            self._malformed(value, now_s)
            return
        self._heard_s = now_s
        if isinstance(value, OrbMotion):
            if value.status != self._orb_status:
                self._orb_status = value.status
                self._report(ButtonBits(value.status))
            self._report(MotionReport._make(to_hid_counts(model, value[1:])))
        elif isinstance(value, OrbKeys):
            self._orb_status = value.status
            self._report(ButtonBits(value.status))
        elif isinstance(value, OrbReset):
            self._lapse(model, now_s)

    def _malformed(self, value: Malformed, now_s: float) -> None:
        self._suspicious = True
        if self._rests_owed:  # It may have been motion.
            self._motion_s = now_s
        self._report(MalformedReport(value.reason, value.letter))

    def _report(self, value: InputReport) -> None:
        if not self._lapsed:  # Otherwise it does not have its settings yet.
            self._reports.append(value)


def _rest_after_s(model: SerialModel) -> float:
    return REST_AFTER_PERIODS * model.period_s


def _rates(value: SpaceballMotion, model: SerialModel) -> Counts | None:
    """Return displacements scaled to the usual period, rotation in the counts of translation.

    None: beyond the device's range.
    """
    nominal = model.period_s / spaceball.PERIOD_UNIT_S
    # The first packet after a rest has the time since the one before that rest.
    share = nominal / value.period if 0.4 * nominal <= value.period <= 2.1 * nominal else 1.0
    most = MOST_OF_FULL_SCALE * model.full_scale
    if max(map(abs, value[1:])) * share > most:
        return None
    turns = share * model.full_scale / model.rotation_full_scale
    return (
        round(value.tx * share),
        round(value.ty * share),
        round(value.tz * share),
        round(value.rx * turns),
        round(value.ry * turns),
        round(value.rz * turns),
    )
