"""Error about a missing optional package: it names the part that needs it, and the extra."""

import pickle
import re
import subprocess
import sys
from pathlib import Path

import pytest

from cardan.common.extras import missing_extra
from cardan.errors import ExtraMissingError

PROJECT = (Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8")
NEEDED = [
    ("coal", "arm", "import cardan.common.arm_libraries"),
    ("numpy", "arm", "from cardan.types import IDENTITY_POSE; IDENTITY_POSE.matrix()"),
    ("pinocchio", "arm", "from cardan.types import IDENTITY_POSE; IDENTITY_POSE.as_se3()"),
    (
        "xacro",
        "xacro",
        "from cardan.robots import load_arm; "
        "load_arm('examples/ros2/cardan_arm.ros2_control.xacro')",
    ),
    ("scapy.fields", "dissect", "import cardan_dissect._scapy"),
    (
        "cardan_dissect",
        "dissect",
        "from cardan.conform.second_reading import second_description; second_description('egm')",
    ),
    (
        "cardan_dissect",
        "dissect",
        "from cardan.conform.second_reading import second_description; second_description('jr3')",
    ),
    ("spake2", "pair", "import cardan.bus.pairing"),
    ("cbor2", "network", "import cardan.protocols.rosbridge.forms"),
    ("zenoh", "network", "from cardan.bus.node import zenoh_module; zenoh_module()"),
    ("xxhash", "network", "from cardan.bus.node import gid_of_token; gid_of_token('token')"),
    ("mcap", "record", "from cardan.recording.mcap_file import _installed; _installed()"),
    (
        "matplotlib",
        "evaluate",
        "from pathlib import Path; from cardan.recording.plot import plot; "
        "plot(Path('a.mcap'), Path('a.png'))",
    ),
    ("matplotlib.pyplot", "evaluate", "import studies.plotting"),
    (
        "can",
        "can",
        "from cardan_jr3.driver.bus import open_bus; "
        "from cardan_jr3.driver import Jr3Options; open_bus(Jr3Options())",
    ),
    (
        "ruckig",
        "ruckig",
        "from cardan.gateway.motion.shaping import _RuckigChaser; "
        "_RuckigChaser(1.0, 1.0, 1.0, 0.004)",
    ),
]
"""Packages, the extras that install them, and the features that need them."""

WITHOUT = """
import sys
sys.modules[{package!r}] = None
from cardan.errors import ExtraMissingError
try:
    {needs}
except ExtraMissingError as error:
    print(error.extra, error)
"""


@pytest.mark.matrix("pinocchio", "coal", "cardan_dissect0", "cbor2", "xxhash", "matplotlib.pyplot")
@pytest.mark.parametrize(("package", "extra", "needs"), NEEDED, ids=[each[0] for each in NEEDED])
def test_a_missing_package_is_named_with_what_installs_it(package, extra, needs):
    assert f"\n{extra} = [" in PROJECT
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT.format(package=package, needs=needs)],
        capture_output=True,
        text=True,
        check=False,
    )
    words = (
        rf"{extra} .+ needs .+, which cannot be imported \(.+\): pip install \"cardan\[{extra}\]\""
    )
    assert re.fullmatch(words, done.stdout.strip()), done.stdout + done.stderr


def test_no_other_wording_is_left():
    sources = Path(__file__).parents[1].joinpath("cardan").rglob("*.py")
    found = [path.name for path in sources if 'pip install "cardan[' in path.read_text("utf-8")]
    assert found == ["errors.py"]


def test_a_shortage_is_no_missing_package():
    error = ImportError("failed to map segment from shared object")
    assert missing_extra("it", "numpy", "arm", error) is error
    missing = missing_extra("it", "numpy", "arm", ImportError("gone"))
    assert isinstance(missing, ExtraMissingError)
    copied = pickle.loads(pickle.dumps(missing))
    assert (str(copied), copied.extra) == (str(missing), "arm")
