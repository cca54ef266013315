"""The C parts are compiled wherever there is a compiler, so that their tests are not silently
skipped."""

import os
import shutil

from cardan_omni import peer
from cardan_omni.driver import native


def test_the_c_parts_were_compiled():
    if shutil.which(os.environ.get("CC", "cc")) is None:
        return  # Without a compiler the package is built without the C parts.
    assert native.available(), "run plugins/cardan-omni/tools/native"
    assert peer.available(), "run plugins/cardan-omni/tools/native"
