"""Benches from the plug-ins' tests, for programs that fuzz and measure all devices."""

import sys
from pathlib import Path

PLUGINS = Path(__file__).parents[1] / "plugins"
sys.path.extend(str(folder) for folder in sorted(PLUGINS.glob("cardan-*/tests")))

import jr3_bench as jr3_bench  # noqa: E402
import leap_frames as leap_frames  # noqa: E402
import wiimote_bench as wiimote_bench  # noqa: E402
