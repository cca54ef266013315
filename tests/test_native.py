"""The C parts are there wherever there is a compiler: no test of theirs is skipped unseen."""

import os
import shutil

from cardan.drivers.omni import native
from cardan.sim_peers import omni


def test_the_c_parts_were_compiled():
    if shutil.which(os.environ.get("CC", "cc")) is None:
        return  # Then the package is built without, and says so; the other tests skip aloud.
    assert native.available(), "run tools/native"
    assert omni.available(), "run tools/native"
