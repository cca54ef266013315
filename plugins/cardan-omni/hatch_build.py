"""Hatchling's build hook: compiles the C parts, so that an ordinary ``pip install`` has them. They
do not use Python, so one wheel serves all its versions. Without a compiler the package is built
without them, and reports that when they are needed."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

LIBRARIES = ("cardan_omni/driver/libcardan_omni.so", "cardan_omni/peer/libHD.so")
NO_COMPILER = 3


class CompiledParts(BuildHookInterface):  # type: ignore[type-arg]
    """Hook that runs tools/native and adds its output."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if self.target_name != "wheel" or not sys.platform.startswith("linux"):
            return
        # make has already compiled them, when it created the environment.
        if os.environ.get("CARDAN_NATIVE") != "compiled":
            done = subprocess.run([Path(self.root, "tools", "native")], check=False)
            if done.returncode == NO_COMPILER:
                self.app.display_warning(
                    "cardan-omni is built without its force loop and its simulated device"
                )
                return
            done.check_returncode()
        platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{platform}"
        build_data["artifacts"] += LIBRARIES
