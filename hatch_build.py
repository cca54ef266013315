"""Hatchling's build hook: compiles the C parts and adds the examples, so that an ordinary
``pip install`` has them.

The C parts know nothing of Python, so one wheel serves every version of it. Where there is no
compiler the package is built without them, and says so when they are asked for: whoever has a
SpaceMouse needs none.
"""

from __future__ import annotations

import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

LIBRARIES = ("cardan/drivers/omni/libcardan_omni.so", "cardan/sim_peers/omni/libHD.so")
NO_COMPILER = 3


class NativeParts(BuildHookInterface):  # type: ignore[type-arg]
    """Runs tools/native and adds what it made, and the examples, to the wheel."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if self.target_name == "wheel" and version == "standard":
            # An editable install finds them beside the package.
            build_data["force_include"]["examples"] = "cardan/examples"
        if self.target_name != "wheel" or not sys.platform.startswith("linux"):
            return
        done = subprocess.run([Path(self.root, "tools", "native")], check=False)
        if done.returncode == NO_COMPILER:
            self.app.display_warning("cardan is built without the driver for haptic devices")
            return
        done.check_returncode()
        platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{platform}"
        build_data["artifacts"] += LIBRARIES
