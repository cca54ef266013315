"""Tree of the errors that Cardan raises. Bad bytes from a peer raise none.

An error that only one part raises is defined in the module named beside it. docs/troubleshooting.md
lists causes and remedies.

::

    CardanError
    +-- ConfigurationError    a setting is wrong; also a ValueError
    |   +-- OptionError           an option's value: names the key, the value, what is allowed
    +-- DriverError           a driver cannot do what it was asked
    |   +-- DeviceNotFoundError   nothing to open
    |   +-- DeviceAccessError     found, but the system or another program refuses it
    |   +-- AddressError          a network address cannot be used
    |   +-- NotOpenError          used before open() or after close()
    |   +-- CommandError          a command this robot or device cannot take
    |   +-- IoConnectionError     cardan.drivers.motoros: inputs and outputs cannot be reached
    |   +-- IoRefusedError        cardan.drivers.motoros: the controller refused to do it
    |   +-- ExtraMissingError     a package that only some need is not installed
    |   |   +-- ExtraImportError      the same, also an ImportError
    |   |   +-- ExtraNameError        the same of a module's name, also an AttributeError
    +-- ScriptError           a simulated peer's script or fault switch is wrong
    +-- NativePartError       cardan.common.native: a compiled part is missing or of other sources
    +-- CaptureError          a capture file cannot be read
    +-- ControlError          cardan.gateway.daemon.control: a request that the daemon refuses
    +-- MotionRefusedError    a verb of the Cartesian interface was refused; nothing changed
    |   +-- OutOfReachError       no joint positions put the TCP there
    |   +-- JointLimitError       a joint would have to leave its range
    |   +-- CollisionError        two bodies would meet on the way
    |   +-- TrajectoryError       cardan.gateway.bus.trajectories: no trajectory of this arm
    +-- MotionLoopError       the loop that drives the arm has ended
    +-- PacketError           cardan.gateway.arm.requests: no request, or no reply
"""

from __future__ import annotations

import contextlib
import copy
import reprlib
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Any

from cardan.common.text_sanitizer import printable

if TYPE_CHECKING:
    from datetime import date, datetime, time

_MOST_SHOWN = 300
"""Longest text of a value or key in a message, characters: enough for EGM's 40 numbers."""
_MOST_REPORTED = 10
"""Most errors of a file that are reported at once."""
_LINE_END = "\n"
"""Separator of the lines in a message of several, such as those about a file."""
_PLAIN_BITS = 256
"""Longest whole number shown in full, bits; Python refuses to write more than 4300 digits."""


class _Brief(reprlib.Repr):
    def __init__(self) -> None:
        super().__init__()
        self.maxlevel = 4
        self.maxtuple = self.maxlist = self.maxdict = 50
        self.maxstring = self.maxother = _MOST_SHOWN

    def repr_int(self, x: int, level: int) -> str:
        bits = x.bit_length()
        return repr(x) if bits <= _PLAIN_BITS else f"<a whole number of {bits} bits>"

    def repr_date(self, x: date, level: int) -> str:
        return f"the date {x.isoformat()}"

    def repr_time(self, x: time, level: int) -> str:
        return f"the time {x.isoformat()}"

    def repr_datetime(self, x: datetime, level: int) -> str:
        return f"the date and time {x.isoformat(' ')}"


_BRIEF = _Brief()


def shown(value: object) -> str:
    """Return `value` for a message: its repr(), shortened; dates and times in words. Never
    raises."""
    try:
        return _bounded(_BRIEF.repr(value))
    except Exception:
        return f"<{type(value).__name__}>"


def _bounded(text: str) -> str:
    return text if len(text) <= _MOST_SHOWN else f"{text[: _MOST_SHOWN - 3]}..."


def _restored(kind: type[CardanError], arguments: tuple[Any, ...]) -> CardanError:
    return kind.__new__(kind, *arguments)


def _portable(value: object) -> object:
    """Return `value`, or its text if it cannot be pickled."""
    import pickle

    try:
        pickle.dumps(value)
    except Exception:
        return shown(value)
    return value


class CardanError(Exception):
    """Base of all errors that Cardan raises on purpose. All can be pickled and copied."""

    def __reduce__(self) -> tuple[Any, ...]:
        # Those with attributes are not made of their message alone, as Exception has it.
        attributes = {name: _portable(value) for name, value in vars(self).items()}
        return _restored, (type(self), self.args), attributes


class ConfigurationError(CardanError, ValueError):
    """A setting is wrong. `key` is its dotted path ("limits.linear_speed_m_s"), `place` the file,
    the line and the column where it stands ("cell.toml:3:5"), or ""."""

    place = ""
    others: tuple[ConfigurationError, ...] = ()
    """Further errors of the same file, shown on a line each."""

    def __init__(self, key: str, message: str) -> None:
        super().__init__(printable(f"{_bounded(key)}: {message}" if key else message, _LINE_END))
        self.key = key

    def __str__(self) -> str:
        return _LINE_END.join((self.args[0], *map(str, self.others)))

    @property
    def message(self) -> str:
        """Description of the error, without the key, its place and the `others`."""
        words: str = self.args[0].removeprefix(f"{self.place}: ")
        return words.removeprefix(f"{printable(_bounded(self.key), _LINE_END)}: ")

    def below(self, table: str) -> ConfigurationError:
        """Return the same error for a setting in `table`."""

        def below(error: ConfigurationError) -> ConfigurationError:
            found = error._of(".".join(filter(None, (table, error.key))))
            return found.placed(error.place) if error.place else found

        return self.each(below)

    def each(
        self, change: Callable[[ConfigurationError], ConfigurationError]
    ) -> ConfigurationError:
        """Return this error and the `others`, each changed by `change`."""
        error = copy.copy(change(self))
        error.others = tuple(map(change, self.others))
        return error

    def _of(self, key: str) -> ConfigurationError:
        return ConfigurationError(key, self.message)

    def placed(self, place: str) -> ConfigurationError:
        """Return the same error with the place of the setting."""
        error = copy.copy(self)
        error.place = printable(place)
        error.args = (f"{error.place}: {self.args[0]}",)
        return error


class OptionError(ConfigurationError):
    """An option has a value that is not allowed; `allowed` describes what is."""

    def __init__(self, key: str, value: object, allowed: str) -> None:
        super().__init__(key, f"{shown(value)} is not allowed; it must be {allowed}")
        self.value = value
        self.allowed = allowed

    def _of(self, key: str) -> ConfigurationError:
        return OptionError(key, self.value, self.allowed)


def together(errors: Iterable[ConfigurationError]) -> ConfigurationError:
    """Combine the errors of a file: the first one, with the others attached, without duplicates."""
    each_once = {str(one): one for error in errors for one in (_alone(error), *error.others)}
    first, *others = each_once.values()
    if (more := len(others) + 1 - _MOST_REPORTED) > 0:
        last = others[-more - 1]
        others[-more - 1 :] = [ConfigurationError(last.key, f"{last.message} (and {more} more)")]
    first.others = tuple(others)
    return first


def _alone(error: ConfigurationError) -> ConfigurationError:
    found = copy.copy(error)
    found.others = ()
    return found


@contextlib.contextmanager
def below(table: str) -> Iterator[None]:
    """Prefix keys of errors raised inside with `table`."""
    try:
        yield
    except ConfigurationError as error:
        raise error.below(table) from None


@contextlib.contextmanager
def about(what: object) -> Iterator[None]:
    """Convert a ValueError raised inside to a ConfigurationError that begins with `what`."""
    try:
        yield
    except ValueError as error:
        words = str(error)
        if not words.startswith(f"{what}:"):  # As one has it that says where in this file it is.
            words = f"{what}: {words}"
        raise ConfigurationError("", words) from None


class DriverError(CardanError):
    """A driver cannot do what it was asked."""


class DeviceNotFoundError(DriverError):
    """There is nothing to open."""


class DeviceAccessError(DriverError):
    """The device is there, but the system or another program refuses it."""


class AddressError(DriverError):
    """A network address cannot be used."""


class NotOpenError(DriverError):
    """A driver was used before open() or after close()."""


class CommandError(DriverError):
    """A command this robot or device cannot take; nothing was sent."""


class ExtraMissingError(DriverError):
    """A package of an optional feature is not installed; `extra` ("arm") is Cardan's extra with
    it."""

    def __init__(self, purpose: str, package: str, extra: str, reason: str) -> None:
        super().__init__(
            f"{purpose} needs {package}, which cannot be imported ({reason}): "
            f"{install_command(extra)}"
        )
        self.extra = extra

    def of_name(self) -> ExtraNameError:
        """Return the same error for the ``__getattr__`` of a module."""
        found = ExtraNameError.__new__(ExtraNameError, *self.args)
        found.extra = self.extra
        return found


class ExtraImportError(ExtraMissingError, ImportError):
    """The same, as an ImportError for ``except ImportError`` and ``pytest.importorskip``."""


class ExtraNameError(ExtraMissingError, AttributeError):
    """The same for a module's name, as an AttributeError for ``hasattr`` and ``help``."""


def install_command(extra: str) -> str:
    """Return the command that installs an extra of Cardan."""
    return f'pip install "cardan[{extra}]"'


class ScriptError(CardanError):
    """A simulated peer's script, model or fault switch is wrong."""


class CaptureError(CardanError):
    """A capture file cannot be read."""


class MotionRefusedError(CardanError):
    """A verb of the Cartesian interface was refused, with the reason, before anything moved."""


class OutOfReachError(MotionRefusedError):
    """No joint positions put the TCP there. The fields say how near the arm can come."""

    def __init__(self, message: str, distance_m: float, angle_rad: float) -> None:
        super().__init__(message)
        self.distance_m = distance_m
        self.angle_rad = angle_rad


class JointLimitError(MotionRefusedError):
    """A joint would have to leave its range (rad, or m for a prismatic joint)."""

    def __init__(self, message: str, joint: str, value: float, limit: float) -> None:
        super().__init__(message)
        self.joint = joint
        self.value = value
        self.limit = limit


class CollisionError(MotionRefusedError):
    """Two bodies would touch, or come too near, after `share` (0..1) of the motion."""

    def __init__(self, message: str, pair: tuple[str, str], share: float) -> None:
        super().__init__(message)
        self.pair = pair
        self.share = share


class MotionLoopError(CardanError):
    """The loop that drives the arm has ended: no more commands can be sent."""
