"""Finds classes by name: a built-in table, then the entry points of installed packages."""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable, Iterable, Mapping
from importlib.metadata import EntryPoint
from typing import Generic, TypeVar

from cardan.errors import ConfigurationError

T = TypeVar("T")


class Finder(Generic[T]):
    """Finds subclasses of `base`.

    `word` is the term for one in errors and their key ("driver"). `built_in`
    maps names to targets ("package.module:Class") and wins over the entry points that `installed`
    gives, which is asked only where they matter. Neither is copied.
    """

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
        """Every name that can be loaded, sorted."""
        return tuple(sorted({*self._built_in, *(point.name for point in self._installed())}))

    def packages(self) -> tuple[str, ...]:
        """The top-level packages of all that can be loaded; the built-in ones first."""
        targets = (*self._built_in.values(), *(point.value for point in self._installed()))
        return tuple(dict.fromkeys(re.split("[.:]", target, maxsplit=1)[0] for target in targets))

    def load(self, name: str) -> type[T]:
        """The class called `name`.

        ConfigurationError names the ones there are, or says why it cannot be loaded.
        """
        target = self._built_in.get(name)
        if target is None:
            for point in self._installed():
                if point.name == name:
                    target = point.value
                    break
            else:
                raise ConfigurationError(
                    self._word,
                    f"there is no {self._word} {name!r}; allowed: {', '.join(self.names())}",
                )
        module, _, attribute = target.partition(":")
        try:
            loaded = getattr(importlib.import_module(module), attribute)
        except (ImportError, AttributeError) as error:
            raise ConfigurationError(
                self._word, f"{target} of {self._word} {name!r} cannot be loaded: {error}"
            ) from error
        if not (isinstance(loaded, type) and issubclass(loaded, self._base)):
            raise ConfigurationError(
                self._word, f"{target} of {self._word} {name!r} is not a cardan {self._word}"
            )
        return loaded
