"""The udev rules that `cardan devices udev` prints, applied to a remote by Debian's udevd."""

import pytest

from cardan_wiimote.driver import Wiimote
from cardan_wiimote.peer import WiimotePeer, WiimotePeerOptions
from tests.kernel.test_udev_rules import given_to_the_user, rules as rules
from tests.kernel.waiting import wait_for
from tests.serving import in_a_thread


@pytest.mark.judged(device="Wiimote", transport="hidraw, udev rules", by="Debian udevd")
@pytest.mark.parametrize("tr", [False, True])
def test_the_rules_give_a_wiimote_to_the_user(modules, tr):
    modules("hid-wiimote")
    with in_a_thread(WiimotePeer(WiimotePeerOptions(uhid=True, tr=tr, script="rest"))):
        (found,) = wait_for(Wiimote.find)
        wait_for(lambda: given_to_the_user(found.path))
