"""Writes the message packages that no distribution of ROS 2 has into a folder."""

from __future__ import annotations

from pathlib import Path

from cardan.errors import ConfigurationError
from cardan.protocols.ros2.packages import PACKAGES, package_files


def write_packages(folder: Path) -> list[Path]:
    """Write the packages into `folder`, which must have no entries of their names; return their
    folders. Raises ConfigurationError."""
    places = [folder / package for package in PACKAGES]
    if there := [str(place) for place in places if place.exists()]:
        raise ConfigurationError(
            "FOLDER",
            f"{', '.join(there)} exists already and is not overwritten: give another folder",
        )
    try:
        for place in places:
            for path, text in package_files(place.name).items():
                file = place / path
                file.parent.mkdir(parents=True, exist_ok=True)
                with file.open("x", encoding="utf-8") as stream:
                    stream.write(text)
    except OSError as error:
        raise ConfigurationError("FOLDER", f"cannot be written: {error}") from None
    return places
