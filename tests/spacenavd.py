"""Debian's spacenavd with a simulated serial device."""

import contextlib
import shutil
import socket
import subprocess
import time

import pytest

from cardan.sim_peers.spacemouse import SpaceMousePeer, SpaceMousePeerOptions
from tests.serving import in_a_thread

TIMEOUT_S = 8.0


@contextlib.contextmanager
def spacenavd(folder, script, *, settings="", model="magellan", hand=None, **options):
    """Debian's daemon with a serial device that a hand moves by `script`, or `hand` in its place:
    its socket's path, and a connection that says nothing."""
    daemon = shutil.which("spacenavd") or shutil.which("spacenavd", path="/usr/sbin")
    if daemon is None:
        pytest.skip("spacenavd is not installed (Debian package spacenavd)")
    # In the foreground this daemon makes its socket below its working directory.
    (folder / "run").mkdir()
    path = folder / "run" / "spnav.sock"
    (folder / "hand.txt").write_text(script)
    (folder / "spnavrc").write_text(f"serial = {folder}/port\n{settings}")
    port, steps = str(folder / "port"), str(folder / "hand.txt")
    peer = SpaceMousePeer(SpaceMousePeerOptions(serial=port, model=model, script=steps, **options))
    if hand is not None:
        peer.hand = hand
    with in_a_thread(peer), (folder / "log").open("w") as log:
        process = subprocess.Popen(
            [daemon, "-d", "-c", str(folder / "spnavrc")],
            cwd=folder,
            stdout=log,
            stderr=subprocess.STDOUT,
        )
        try:
            deadline_s = time.monotonic() + TIMEOUT_S
            with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as old_client:
                while old_client.connect_ex(str(path)):  # Not there yet, or it does not listen yet.
                    said = (folder / "log").read_text()
                    assert process.poll() is None, f"spacenavd ended: {said}"
                    assert time.monotonic() < deadline_s, f"spacenavd does not serve: {said}"
                    time.sleep(0.01)
                yield path, old_client
        finally:
            process.terminate()
            process.wait(TIMEOUT_S)
