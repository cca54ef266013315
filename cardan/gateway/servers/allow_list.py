"""Allow lists for clients of a server: patterns for names of topics, services and parameters."""

from __future__ import annotations

from collections.abc import Iterable
from fnmatch import fnmatchcase


class Allowed:
    """Shell patterns: ``*`` any text, ``?`` a character, ``[ab]`` one of these."""

    def __init__(
        self, topics: Iterable[str], services: Iterable[str], parameters: Iterable[str]
    ) -> None:
        """`parameters`: patterns of names such as "/node:parameter"."""
        self._topics = tuple(topics)
        self._services = tuple(services)
        self._parameters = tuple(parameters)

    def topic(self, name: str) -> bool:
        """Return whether clients may use the topic with this absolute name."""
        return _matches(name, self._topics)

    def service(self, name: str) -> bool:
        """Return whether clients may use the service or the action with this absolute name."""
        return _matches(name, self._services)

    def call(self, type_name: str) -> bool:
        """Return whether clients may call services of this type: those with which nodes offer their
        parameters only if no parameters are restricted."""
        return self.all_parameters or not type_name.startswith("rcl_interfaces/")

    def parameter(self, name: str) -> bool:
        """Return whether clients may use the parameter "/node:parameter"."""
        return _matches(name, self._parameters)

    @property
    def all_parameters(self) -> bool:
        """True if parameters are not restricted at all."""
        return "*" in self._parameters


def _matches(name: str, patterns: tuple[str, ...]) -> bool:
    return any(fnmatchcase(name, each) for each in patterns)
