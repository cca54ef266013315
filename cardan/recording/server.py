"""Recorder as a service of the daemon, with a new file for each start."""

from __future__ import annotations

import itertools
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

from cardan.bus.options import BusOptions
from cardan.common.files import records_folder
from cardan.common.options import Options
from cardan.errors import CaptureError
from cardan.gateway.servers import stats
from cardan.gateway.servers.base import Ready, Server
from cardan.recording.recorder import Recorder

LOOK_S = 0.1
"""Period of checking whether to stop, s."""


@dataclass(frozen=True, kw_only=True)
class RecordsOptions(Options):
    """Recorded arms, and the folder of the records."""

    folder: str = ""
    """Folder of the records, made if missing; each file is named by its start time. Empty:
    "records" in the state folder of the user or service."""
    arms: tuple[str, ...] = ()
    """Namespaces of arms, or names of nodes: only their topics and the shared ones; empty: all."""


@dataclass(frozen=True, kw_only=True)
class RecorderServerOptions(Options):
    """Bus and record options."""

    bus: BusOptions = field(default_factory=BusOptions)
    records: RecordsOptions = field(default_factory=RecordsOptions)


class RecorderServer(Server[RecorderServerOptions]):
    """Record the bus, like `cardan net record`, into a new file at each start."""

    Options = RecorderServerOptions
    page = "recording.md"
    example = "--folder records --arms /left"
    epilog = "Prints READY and its file once it records."

    @classmethod
    def serve(cls, options: RecorderServerOptions, ready: Ready, stop: threading.Event) -> None:
        """Record until `stop` is set. Raises CaptureError, ConfigurationError, ExtraMissingError
        or DriverError."""
        records = options.records
        path = new_file(records_folder(records.folder), time.time())
        with Recorder(options.bus, path, records.arms) as recorder:
            ready(str(path))
            tell_s = time.monotonic()
            while not recorder.failed and not stop.wait(LOOK_S):
                if stats.is_wanted() and time.monotonic() >= tell_s:
                    tell_s = time.monotonic() + stats.PERIOD_S
                    stats.tell(recorder.figures())
            report = recorder.close()
        for line in report.lines():
            print(line, flush=True)
        if report.error:
            raise CaptureError(report.error)


def new_file(folder: Path, time_s: float) -> Path:
    """Return the path of a new file in `folder`, named by the present time. Raises CaptureError."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise CaptureError(f"cannot make the folder {folder}: {error.strerror}") from None
    stem = time.strftime("cardan-%Y%m%d-%H%M%S", time.localtime(time_s))
    names = itertools.chain((stem,), (f"{stem}-{n}" for n in itertools.count(2)))
    return next(path for name in names if not (path := folder / f"{name}.mcap").exists())
