"""The C parts are there wherever there is a compiler: no test of theirs is skipped unseen."""

import os
import shutil

from cardan_omni import peer
from cardan_omni.driver import native


def test_the_c_parts_were_compiled():
    if shutil.which(os.environ.get("CC", "cc")) is None:
        return  # Then the package is built without, and says so; the other tests skip aloud.
    assert native.available(), "run plugins/cardan-omni/tools/native"
    assert peer.available(), "run plugins/cardan-omni/tools/native"
