"""Access to a simulated device: only for its owner, whatever the umask, or for all users on
request."""

from __future__ import annotations

import os
import stat

import pytest

from cardan.sim_peers.evdev.peer import EvdevPeer, EvdevPeerOptions
from cardan.sim_peers.spacemouse.peer import SpaceMousePeer, SpaceMousePeerOptions
from cardan_serial_mice.peer import SerialPuckPeer, SerialPuckPeerOptions

MADE = {
    "events": lambda path, **more: EvdevPeer(EvdevPeerOptions(path=path, **more)),
    "hid": lambda path, **more: SpaceMousePeer(SpaceMousePeerOptions(hid=path, **more)),
    "serial": lambda path, **more: SerialPuckPeer(SerialPuckPeerOptions(port=path, **more)),
}


@pytest.fixture(autouse=True, params=[0o000, 0o022, 0o077], ids=oct)
def umask(request):
    before = os.umask(request.param)
    yield
    os.umask(before)


def mode(path):
    """Return the mode of the file that programs open at `path`."""
    return stat.S_IMODE(os.stat(path).st_mode)


@pytest.mark.parametrize("way", MADE)
def test_only_its_owner_can_open_it(way, tmp_path):
    path = str(tmp_path / "device")
    peer = MADE[way](path)
    peer.open()
    assert mode(path) == 0o600
    if way == "serial":
        assert mode(f"{path}.lock") == 0o600
    peer.close()
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("way", MADE)
def test_everybody_can_where_that_is_asked(way, tmp_path):
    path = str(tmp_path / "device")
    peer = MADE[way](path, everybody=True)
    peer.open()
    assert mode(path) == 0o666
    peer.close()
