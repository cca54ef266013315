"""Names in ROS 2: of nodes, topics and services, and of types in DDS and Zenoh.

Source: design.ros2.org, "Topic and service names"; the mappings of rmw_dds_common and rmw_zenoh.
"""

from __future__ import annotations

import re

from cardan.protocols.ros2.interfaces import full_name, name_on_the_wire

_TOKEN = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")


class RosNameError(ValueError):
    """A name is not allowed in ROS 2; the text tells why."""


def checked_name(name: str, node: str = "") -> str:
    """Return the absolute name of a topic or service.

    ``~`` is replaced by the full name of `node`; a relative name gets a leading slash. Raises
    RosNameError for a name that ROS 2 refuses.
    """
    full = node + name[1:] if name.startswith("~") else name
    full = full if full.startswith("/") else f"/{full}"
    if "__" in full or not all(map(_TOKEN.match, full[1:].split("/"))):
        raise RosNameError(
            f"{name[:120]!r} is not a ROS name: words of letters, digits and single _, which begin "
            "with a letter or _, with / between them"
        )
    return full


def dds_type(name: str) -> str:
    """Return the DDS form of a type, or of a service as a whole:
    "geometry_msgs::msg::dds_::Pose_"."""
    package, kind, last = name_on_the_wire(full_name(name)).split("/")
    return f"{package}::{kind}::dds_::{last}_"


def type_of_dds(text: str) -> str:
    """Return the three-part name of a type in DDS form; empty if it is invalid."""
    parts = text.split("::")
    if len(parts) != 4 or parts[2] != "dds_" or not parts[3].endswith("_"):
        return ""
    return f"{parts[0]}/{parts[1]}/{parts[3][:-1]}"
