"""Options of a participant on DDS."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Annotated, Literal

from cardan.common.bounds import DDS_CONFIG, Range
from cardan.common.options import Options
from cardan.errors import ConfigurationError

SERVER_NODE = "cardan_dds_server"
"""Name of the node of `cardan net server dds` on both sides."""

DOMAIN_VARIABLE = "ROS_DOMAIN_ID"

DDS_DOMAIN = Range(-1, 232, "", "beyond it DDS has no ports")
"""ROS_DOMAIN_ID; -1: that of the environment."""


@dataclass(frozen=True, kw_only=True)
class DdsOptions(Options):
    """Options to join DDS: on loopback, unless `dds_config` or CYCLONEDDS_URI configure more."""

    dds_domain: Annotated[int, DDS_DOMAIN] = -1
    """ROS_DOMAIN_ID on DDS; -1: that of the environment, or 0 if it has none."""
    dds_config: Annotated[str, DDS_CONFIG] = ""
    """Configuration of Cyclone DDS: XML, or file://PATH. Empty: CYCLONEDDS_URI if it is set, else
    loopback alone."""
    dds_distribution: Literal["humble", "iron and later"] = "iron and later"
    """ROS 2 distribution on DDS: up to Humble, announcements of nodes have longer ids."""

    @property
    def number(self) -> int:
        """Return the domain. Raises ConfigurationError if the environment's is not valid."""
        if self.dds_domain >= 0:
            return self.dds_domain
        text = os.environ.get(DOMAIN_VARIABLE, "") or "0"
        if not text.isdecimal() or len(text) > 9 or not 0 <= int(text) <= DDS_DOMAIN.highest:
            raise ConfigurationError(
                DOMAIN_VARIABLE, f"{text!r} in the environment is not a domain; allowed: 0 to 232"
            )
        return int(text)
