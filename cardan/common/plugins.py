"""Registry of classes by name: a built-in table, then the entry points of installed packages."""

from __future__ import annotations

import contextlib
import functools
import importlib
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, is_dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast

from cardan.common.options import hints, suggestion
from cardan.common.resource_errors import shortage
from cardan.common.signals import EndingSignalError
from cardan.common.text_sanitizer import printable
from cardan.errors import CardanError, ConfigurationError, ExtraMissingError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint, EntryPoints

T = TypeVar("T")

_CONFORM_ARMS = "plugins/cardan-conform-arms"
_DISSECT = "plugins/cardan-dissect"
_FILTERS = "plugins/cardan-filters"
_JR3 = "plugins/cardan-jr3"
_LEAP = "plugins/cardan-leap"
_LEARNING = "plugins/cardan-learning"
_OMNI = "plugins/cardan-omni"
_SERIAL_MICE, _SPNAV_SERVER = "plugins/cardan-serial-mice", "plugins/cardan-spnav-server"
_WIIMOTE = "plugins/cardan-wiimote"
IN_SOURCE_TREE = {
    "check": {"compiled": _OMNI},
    "command": {
        "dissect": _DISSECT,
        "evaluate": "studies",
        "net.export": _LEARNING,
        "devices.spnav": _SPNAV_SERVER,
    },
    "dissector": {
        "jr3_can": _JR3,
        "wiimote": _WIIMOTE,
    },
    "driver": {
        "jr3_can": _JR3,
        "leap": _LEAP,
        "omni": _OMNI,
        "spacemouse_serial": _SERIAL_MICE,
        "wiimote": _WIIMOTE,
    },
    "server": {
        "dds": "plugins/cardan-dds",
        "foxglove": "plugins/cardan-foxglove",
        "spnav": _SPNAV_SERVER,
    },
    "filter": {"camera": _FILTERS, "proximity": _FILTERS},
    "protocol": {
        **dict.fromkeys(
            ("joint-stream", "joint-stream-driver", "joint-trajectory", "ros2-arm"), _CONFORM_ARMS
        ),
        "hdapi": _OMNI,
        "jr3": _JR3,
        "leap": _LEAP,
        **dict.fromkeys(("magellan", "spaceball", "spaceorb"), _SERIAL_MICE),
        "spnav": _SPNAV_SERVER,
        "wiimote": _WIIMOTE,
    },
    "simulated peer": {
        "jr3": _JR3,
        "leap": _LEAP,
        "omni": _OMNI,
        "spacemouse-serial": _SERIAL_MICE,
        "wiimote": _WIIMOTE,
    },
    "transport": {"dds": "plugins/cardan-dds"},
}
"""Plug-ins that are only in the source tree, with their folders."""


def not_installed(word: str, name: str) -> str:
    """Return why `name`, a `word`, is not found although the source tree has it; empty: it does
    not."""
    folder = IN_SOURCE_TREE.get(word, {}).get(name)
    if folder is None:
        return ""
    return (
        f"{name.rpartition('.')[2]!r} is in the folder {folder} of Cardan's source tree, and not "
        f"installed: run `pip install ./{folder}` there, or `make demo`"
    )


def reason(error: BaseException) -> str:
    """Return why a plug-in failed, in one line."""
    if lacking := shortage(error):
        return lacking
    words = printable(" ".join(str(error).split()))
    if isinstance(error, CardanError):
        return words
    return f"{type(error).__name__}: {words}" if words else type(error).__name__


def is_lack(error: Exception) -> bool:
    """Return whether `error` reports a missing package, memory or files: no fault of a plug-in."""
    return isinstance(error, ExtraMissingError) or bool(shortage(error))


@dataclass(frozen=True, slots=True)
class Loaded(Generic[T]):
    """All classes of a kind, by name."""

    classes: dict[str, type[T]]
    refused: dict[str, str]
    """Reasons for classes that cannot be loaded, in one line each."""
    notes: list[str]
    """Plug-ins that are installed and not used, because another one has the name."""
    lacking: dict[str, str] = field(default_factory=dict)
    """Missing extras, by the names in `refused` that only need an extra to be installed."""


def entry_points(group: str) -> EntryPoints:
    """Return entry points of installed packages. All packages are read once, and again after one
    was added or removed: there may be hundreds, and each registry has a group of its own."""
    return _all_entry_points(tuple(map(_state_of, sys.path))).select(group=group)


def _state_of(folder: str) -> tuple[str, int]:
    """Return a folder of sys.path, and the time of its last change: 0 if it does not exist."""
    try:
        return folder, os.stat(folder or os.curdir).st_mtime_ns
    except OSError:
        return folder, 0


@functools.lru_cache(maxsize=1)
def _all_entry_points(_path: tuple[tuple[str, int], ...]) -> EntryPoints:
    from importlib import metadata

    return cast("EntryPoints", metadata.entry_points())


class Finder(Generic[T]):
    """Finds subclasses of `base`. `word` is their term in errors and their key ("driver").
    `built_in` maps names to targets ("package.module:Class") and has precedence over the entry
    points that `installed` returns, which is called only if needed. Neither is copied."""

    def __init__(
        self,
        base: type[T],
        word: str,
        built_in: Mapping[str, str],
        installed: Callable[[], Iterable[EntryPoint]],
    ) -> None:
        self._base, self._word = base, word
        self._built_in, self._installed = built_in, installed

    def names(self) -> tuple[str, ...]:
        """Return all names that can be loaded, sorted."""
        return tuple(sorted({*self._built_in, *(point.name for point in self._installed())}))

    def packages(self) -> tuple[str, ...]:
        """Return the top-level packages of all that can be loaded; the built-in ones first."""
        targets = (*self._built_in.values(), *(point.value for point in self._installed()))
        names = (re.split("[.:]", target, maxsplit=1)[0] for target in targets)
        return tuple(dict.fromkeys(filter(None, names)))

    def load(self, name: str) -> type[T]:
        """Load the class called `name`. ConfigurationError names the known ones, or says why it
        cannot be loaded. A missing package raises ExtraMissingError; a shortage of memory or files
        is raised unchanged."""
        return self._load(name, () if name in self._built_in else self._installed())

    def _load(self, name: str, points: Iterable[EntryPoint]) -> type[T]:
        target = self._built_in.get(name)
        if target is None:
            for point in points:
                if point.name == name:
                    target = point.value
                    break
            else:
                raise ConfigurationError(
                    self._word,
                    not_installed(self._word, name)
                    or f"there is no {self._word} {name!r}; allowed: "
                    + (", ".join(self.names()) or "none, because none is installed")
                    + suggestion(name, (*self.names(), *IN_SOURCE_TREE.get(self._word, ()))),
                )
        module, _, attribute = target.partition(":")
        of = f"{target} of {self._word} {name!r}"
        try:
            loaded = getattr(importlib.import_module(module), attribute)
        except (EndingSignalError, ExtraMissingError):
            raise
        except (Exception, SystemExit) as error:  # Another package's module may raise anything.
            if shortage(error):
                raise
            raise ConfigurationError(
                self._word, f"{of} cannot be loaded: {reason(error)}"
            ) from error
        self._check(loaded, of)
        return cast("type[T]", loaded)

    def load_all(self) -> Loaded[T]:
        """Load all classes, and return reasons for the others: a broken class does not keep the
        others from being listed."""
        found: Loaded[T] = Loaded({}, {}, [])
        points = tuple(self._installed())
        for name in sorted({*self._built_in, *(point.name for point in points)}):
            try:
                found.classes[name] = self._load(name, points)
            except ConfigurationError as error:
                cause = error.__cause__
                why = error.message if cause is None else reason(cause)
                found.refused[name] = f"cannot be loaded: {why}"
            except Exception as error:
                if not is_lack(error):
                    raise
                found.refused[name] = f"cannot be loaded: {reason(error)}"
                if isinstance(error, ExtraMissingError):
                    found.lacking[name] = error.extra
        used = dict(self._built_in)
        for point in points:
            if (target := used.setdefault(point.name, point.value)) != point.value:
                found.notes.append(
                    f"{self._word} {point.name!r} is {target}; {point.value}, which has the same "
                    "name, is not used"
                )
        return found

    def options_of(self, name: object) -> Any:
        """Return the options class of the class called `name`; None if it cannot be loaded."""
        known = str(name)
        lacks = ConfigurationError, ExtraMissingError
        with contextlib.suppress(*lacks), self.using(known, self._word):
            options = getattr(self.load(known), "Options", None)
            hints(options)  # Another package's may be none.
            return options
        return None

    @contextlib.contextmanager
    def using(self, name: str, key: str) -> Iterator[None]:
        """Turn errors that another package's class `name` raises inside into errors of `key`."""
        try:
            yield
        except CardanError:
            raise
        except Exception as error:
            if name in self._built_in or shortage(error):
                raise
            raise ConfigurationError(
                key, f"{self._word} {name!r} cannot be used: {reason(error)}"
            ) from error

    def _check(self, loaded: Any, of: str) -> None:
        """Raise ConfigurationError if `loaded` is not such a class; `of` names it."""
        if not (isinstance(loaded, type) and issubclass(loaded, self._base)):
            raise ConfigurationError(self._word, f"{of} is not a cardan {self._word}")
        if wrong := self._wrong_attribute(loaded):
            raise ConfigurationError(self._word, f"{of} cannot be used: {wrong}")

    def _wrong_attribute(self, loaded: type[T]) -> str:
        """Return the attribute of a class that contradicts the interface; empty if none does."""
        options: Any = getattr(loaded, "Options", None)
        if hasattr(loaded, "Options") and not (isinstance(options, type) and is_dataclass(options)):
            return f"Options is {options!r:.60}; it must be a dataclass"
        for ancestor in loaded.__mro__[1:]:
            if not issubclass(ancestor, self._base):
                continue
            for name, default in vars(ancestor).items():
                kinds = (str,) if type(default) is str else (tuple, list)
                value = getattr(loaded, name, None)
                public = not name.startswith("_") and type(default) in (str, tuple)
                if public and not isinstance(value, kinds):
                    word = "a text" if kinds == (str,) else "a tuple"
                    return f"{name} is {value!r:.60}; it must be {word}"
        return ""
