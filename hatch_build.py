"""Hatchling's build hook: compiles the C parts, builds the console's page and adds the examples, so
that an ordinary ``pip install`` has them.

The C parts know nothing of Python but, in one place, its stable ABI, so one wheel serves every
version of it. Where there is no compiler the package is built without them, and says so when they
are asked for: a user of a SpaceMouse needs none. The page is in the source archive, too, so that
only who builds from a checkout needs npm; where there is none the package is built without it, and
the console says so.
"""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

LIBRARIES = (
    "cardan/drivers/abb_egm/libcardan_egm.so",
    "cardan/drivers/ur_rtde/libcardan_ur.so",
    "cardan/gateway/servo/libcardan_servo.so",
)
PAGE = "cardan/gateway/servers/console/page/*"
NO_COMPILER = NO_NPM = 3


class BuiltParts(BuildHookInterface):  # type: ignore[type-arg]
    """Runs tools/native and tools/console, and adds what they made, and the examples."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if version == "editable":
            self._add_native(build_data)  # The page is built by make, or by its own tool.
            return
        self._add_page(build_data)
        if self.target_name == "wheel":
            # An editable install finds them beside the package.
            build_data["force_include"]["examples"] = "cardan/examples"
            self._add_native(build_data)

    def _add_page(self, build_data: dict[str, Any]) -> None:
        done = subprocess.run([sys.executable, Path(self.root, "tools", "console")], check=False)
        if done.returncode == NO_NPM:
            self.app.display_warning("cardan is built without the console's page")
            return
        done.check_returncode()
        build_data["artifacts"].append(PAGE)

    def _add_native(self, build_data: dict[str, Any]) -> None:
        if not sys.platform.startswith("linux"):
            return
        # make has compiled them by then, while it made the environment.
        if os.environ.get("CARDAN_NATIVE") != "compiled":
            done = subprocess.run([Path(self.root, "tools", "native")], check=False)
            if done.returncode == NO_COMPILER:
                self.app.display_warning("cardan is built without the compiled servo")
                return
            done.check_returncode()
        platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{platform}"
        build_data["artifacts"] += LIBRARIES
