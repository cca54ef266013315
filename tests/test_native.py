"""The compiled parts exist wherever a compiler does, so that no test of theirs is skipped
silently."""

import os
import shutil

from cardan.drivers.abb_egm import compiled
from cardan.drivers.ur_rtde.compiled import ur_library
from cardan.gateway.servo import native


def test_the_c_parts_were_compiled():
    if shutil.which(os.environ.get("CC", "cc")) is None:
        return  # the package says so, and other tests skip visibly
    assert native.kernel_library(), "run tools/native"
    assert compiled.egm_library(), "run tools/native"
    assert ur_library(), "run tools/native"
