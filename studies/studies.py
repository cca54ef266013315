"""The studies by name. Each is imported only when it is run, because they need different extras."""

from __future__ import annotations

import importlib
from typing import NamedTuple

from cardan.errors import ConfigurationError
from studies.result import Result


class Study(NamedTuple):
    """A study: a part of the report."""

    name: str
    title: str
    source: str
    """Publication that is repeated."""
    module: str

    def run(self, quick: bool) -> Result:
        """Run the study. Raises CardanError and others if it cannot run here."""
        found: Result = importlib.import_module(self.module).run(quick)
        return found


STUDIES = {
    name: Study(name, title, source, f"studies.{name}.study")
    for name, title, source in (
        (
            "thesis",
            "Universal teleoperation on ROS: line, eight-course, collision, arbitrary motion",
            "a thesis of 2020 on a universal teleoperation interface on ROS",
        ),
        (
            "motoros",
            "Latency of a Yaskawa GP8 over MotoROS",
            "Baklouti, Gallot, Viaud and Subrin 2021, Applied Sciences 11(16), 7190",
        ),
        (
            "devices",
            "A generic controller with low-cost devices",
            "Łukawski, Victores and Balaguer 2023, on low-cost devices and one controller",
        ),
        (
            "cartesian",
            "The Cartesian interface over ROS 2 and the web",
            "the paper of 2025 on YARP's Cartesian interface over ROS 2 and a web application",
        ),
        (
            "haptics",
            "Bilateral haptics: drawing and stability",
            "the paper of 2026 on bilateral haptic teleoperation with a Phantom Omni",
        ),
    )
}


def chosen(only: str) -> list[Study]:
    """Parse a list of study names with commas and return the studies in the report's order; empty:
    all. Raises ConfigurationError for an unknown name."""
    names = [name.strip() for name in only.split(",") if name.strip()]
    for name in names:
        if name not in STUDIES:
            raise ConfigurationError(
                "--only", f"there is no study {name!r}; allowed: {', '.join(STUDIES)}"
            )
    return [study for name, study in STUDIES.items() if not names or name in names]
