"""Declaration of a server, from which ``cardan net server`` makes its command."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar, Generic, TypeVar

from cardan.common.serving import interruptible

OptionsT = TypeVar("OptionsT")

Ready = Callable[[str], None]
"""Called with the endpoint once the server accepts connections there."""


class Server(ABC, Generic[OptionsT]):
    """A process on the bus. It is never instantiated; the class's docstring is the command's
    summary.

    All fields of `Options`, and of dataclasses in it, are options of the command, each with the
    text below it as its help::

        @dataclass(frozen=True, kw_only=True)
        class EchoOptions:
            bus: BusOptions = field(default_factory=BusOptions)
            server: EchoServerOptions = field(default_factory=EchoServerOptions)
    """

    Options: ClassVar[type]
    """A frozen dataclass. All fields have defaults, and unique names."""
    page: ClassVar[str] = ""
    """Its documentation: a page relative to Cardan's docs/, or a URL."""
    epilog: ClassVar[str] = "Prints READY and its endpoint once it serves."
    """Text below the options in the help."""
    example: ClassVar[str] = ""
    """Words after ``cardan net server NAME`` in the example at the end of the help."""

    @classmethod
    @abstractmethod
    def serve(cls, options: OptionsT, ready: Ready, stop: threading.Event) -> None:
        """Serve until `stop` is set; call `ready` once. Raises a CardanError on failure."""

    @classmethod
    def run(cls, options: OptionsT, seconds: float | None) -> None:
        """Serve until `seconds` are over (None: no limit) or a signal requests the end."""
        with interruptible() as stop:
            timer = None if seconds is None else threading.Timer(seconds, stop.set)
            if timer is not None:
                timer.daemon = True
                timer.start()
            try:
                cls.serve(options, lambda endpoint: print(f"READY {endpoint}", flush=True), stop)
            finally:
                if timer is not None:
                    timer.cancel()
