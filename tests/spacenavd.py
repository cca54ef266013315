"""Debian's spacenavd with a simulated serial device."""

import contextlib
import math
import queue
import shutil
import socket
import subprocess
import time

import pytest

from cardan.protocols.spnav.codes import Code
from cardan.protocols.spnav.records import ServerReply, encode_handshake, encode_request
from cardan.protocols.spnav.streams import Handshake, ServerReader
from cardan_serial_mice.peer import SerialPuckPeer, SerialPuckPeerOptions
from tests.serving import in_a_thread
from tests.waiting import WITHIN_S

TIMEOUT_S = WITHIN_S

PROBES = 30
"""Limit on starts of the daemon until it finds its device."""


class PuckMotion:
    """Device motion under the control of a test."""

    def __init__(self):
        self._acts = queue.SimpleQueue()

    def do(self, method, *arguments):
        """Call this method of the device, in the device's thread."""
        self._acts.put((method, arguments))

    @property
    def next_due_s(self):
        return math.inf if self._acts.empty() else 0.0

    def advance(self, now_s, device):
        while not self._acts.empty():
            method, arguments = self._acts.get()
            getattr(device, method)(*arguments)


def asked(path, code):
    """Return the answer of the daemon at `path` to a request without values."""
    reader = ServerReader()
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
        client.settimeout(TIMEOUT_S)
        client.connect(str(path))
        client.sendall(encode_handshake(1))
        while data := client.recv(4096):
            for value in reader.feed(data):
                if isinstance(value, Handshake):
                    client.sendall(encode_request(code))
                elif isinstance(value, ServerReply):
                    return value
    raise AssertionError("the daemon has hung up")


@contextlib.contextmanager
def _started(folder, daemon):
    """Start the daemon; yield it, its socket's path, and a silent connection."""
    # In the foreground, this daemon creates its socket below its working directory.
    path = folder / "run" / "spnav.sock"
    path.unlink(missing_ok=True)
    with (folder / "log").open("w") as log:
        process = subprocess.Popen(
            [daemon, "-d", "-c", str(folder / "spnavrc")],
            cwd=folder,
            stdout=log,
            stderr=subprocess.STDOUT,
        )
        try:
            deadline_s = time.monotonic() + TIMEOUT_S
            with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as old_client:
                while old_client.connect_ex(str(path)):  # not there yet, or not listening yet
                    said = (folder / "log").read_text()
                    assert process.poll() is None, f"spacenavd ended: {said}"
                    assert time.monotonic() < deadline_s, f"spacenavd does not serve: {said}"
                    time.sleep(0.01)
                yield path, old_client
        finally:
            process.terminate()
            process.wait(TIMEOUT_S)


@contextlib.contextmanager
def spacenavd(folder, script, *, settings="", model="magellan", motion=None, **options):
    """Run Debian's daemon with a serial device that `script` or `motion` deflects; yield its
    socket's path and a silent connection.

    The daemon searches for the device once, at its start, and ignores it if there is no answer
    within 0.25 s. On a busy computer it is started again.
    """
    daemon = shutil.which("spacenavd") or shutil.which("spacenavd", path="/usr/sbin")
    if daemon is None:
        pytest.skip("spacenavd is not installed (Debian package spacenavd)")
    (folder / "run").mkdir()
    (folder / "hand.txt").write_text(script)
    (folder / "spnavrc").write_text(f"serial = {folder}/port\n{settings}")
    port, steps = str(folder / "port"), str(folder / "hand.txt")
    chosen = SerialPuckPeerOptions(port=port, model=model, script=steps, **options)
    for _ in range(PROBES):
        peer = SerialPuckPeer(chosen)
        if motion is not None:
            peer.motion = motion
        with in_a_thread(peer), _started(folder, daemon) as (path, old_client):
            if asked(path, Code.DEV_NBUTTONS).ok:
                yield path, old_client
                return
    raise AssertionError(f"spacenavd does not find its device: {(folder / 'log').read_text()}")
