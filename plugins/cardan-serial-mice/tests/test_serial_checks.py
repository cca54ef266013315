"""The simulated serial devices, checked with independent programs."""

import os
import shutil
import socket
import struct
import subprocess
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from cardan_serial_mice.peer import SerialPuckPeer, SerialPuckPeerOptions
from tests.serving import in_a_thread
from tests.waiting import WITHIN_S, until

pytestmark = pytest.mark.matrix

PATIENCE_S = WITHIN_S
MODELS = {
    "magellan": "MAGELLAN  Version 5.79",
    "spaceball-2003": "8 buttons",
    "spaceball-3003": "2 buttons",
    "spaceball-4000": "12 buttons",
    "spaceball-5000": "12 buttons",
}
"""Text in spacenavd's log for each model; it does not support a SpaceOrb."""
ATTEMPTS = 3
"""Number of attempts: spacenavd takes a pause of 0.13 s for the end of a message, and a busy
machine causes such pauses."""

SCRIPT = """
    1.0  axes 0.5 -0.25 1 0.1 -0.2 0.3
    1.3  press first
    1.4  release first
    1.5  neutral
    1.9  loop
"""
EVENT = struct.Struct("8i")
FULL_SCALES = (8000, 8000, 8000, 1600, 1600, 1600)
SHARES = (0.25, 1.0, 0.5, 0.2, 0.3, 0.1)
"""Motion of SCRIPT, in spacenavd's axes: right, up, away, and the rotations about them."""


@pytest.fixture
def script(tmp_path):
    path = tmp_path / "script"
    path.write_text(SCRIPT)
    return str(path)


def listen(folder):
    """Return the daemon's events until the cap is at rest after the release of a button."""
    path = str(folder / "run" / "spnav.sock")
    with socket.socket(socket.AF_UNIX) as client:
        until(lambda: not client.connect_ex(path), "a connection to spacenavd", PATIENCE_S)
        client.settimeout(PATIENCE_S)
        events = []
        while 2 not in [event[0] for event in events] or any(events[-1][0:7]):
            events.append(EVENT.unpack(client.recv(EVENT.size)))
    return events


def log_of(folder):
    return (folder / "log").read_text(errors="replace")


def judge(model, script, root):
    """Return spacenavd's events of a device of `model`, and its log."""
    for attempt in range(ATTEMPTS):
        folder = root / f"{model}-{attempt}"
        events, log = check_once(model, script, folder)
        if MODELS[model] in log:
            break
    return events, log


def check_once(model, script, folder):
    (folder / "run").mkdir(parents=True)
    port = folder / "port"
    (folder / "conf").write_text(f"serial = {port}\nled = off\n")
    peer = SerialPuckPeer(
        SerialPuckPeerOptions(port=str(port), model=model, script=script, jitter_lsb=0)
    )
    with in_a_thread(peer):
        daemon = subprocess.Popen(
            ["spacenavd", "-d", "-c", "conf", "-l", "log", "-v"],
            cwd=folder, env={**os.environ, "DISPLAY": ""},
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            events = listen(folder)
        finally:
            daemon.terminate()
            try:
                daemon.wait(5.0)
            except subprocess.TimeoutExpired:
                daemon.kill()
                daemon.wait()
    return events, log_of(folder)


@pytest.fixture(scope="module")
def judgments():
    """spacenavd's events and log by model, collected in parallel because each takes seconds."""
    if shutil.which("spacenavd") is None:
        pytest.skip("there is no spacenavd: install the Debian package spacenavd")
    # The path of a socket is limited to 107 bytes, which pytest's own folders nearly exhaust.
    with tempfile.TemporaryDirectory(prefix="cardan-") as name:
        root = Path(name)
        script = root / "script"
        script.write_text(SCRIPT)
        with ThreadPoolExecutor(len(MODELS)) as pool:
            found = pool.map(lambda model: judge(model, str(script), root), MODELS)
            yield dict(zip(MODELS, found, strict=True))


@pytest.mark.real
@pytest.mark.judged(
    device="Magellan and Spaceball 5000", transport="pseudo-terminal", by="Debian spacenavd"
)
@pytest.mark.parametrize("model", ["magellan", "spaceball-5000"])
def test_spacenavd_takes_it_for_a_magellan(judgments, model):
    events, log = judgments[model]
    assert "Magellan SpaceMouse detected" in log
    assert MODELS[model] in log
    check(events, [share * 400 for share in SHARES])


@pytest.mark.judged(
    device="Spaceball 2003, 3003, 4000 FLX", transport="pseudo-terminal", by="Debian spacenavd"
)
@pytest.mark.parametrize("model", ["spaceball-2003", "spaceball-3003", "spaceball-4000"])
def test_spacenavd_takes_it_for_a_spaceball(judgments, model):
    events, log = judgments[model]
    assert "Spaceball detected" in log
    assert MODELS[model] in log
    check(events, [share * scale for share, scale in zip(SHARES, FULL_SCALES, strict=True)])


def check(events, expected):
    assert [event[1:3] for event in events if event[0] == 1] == [(0, 1)]
    assert [event[1] for event in events if event[0] == 2] == [0]
    motions = [event[1:7] for event in events if event[0] == 0]
    assert list(motions[-2]) == pytest.approx(expected, abs=1)
    assert motions[-1] == (0,) * 6


@pytest.mark.real("spaceball-2003")
@pytest.mark.judged(
    device="Spaceball 2003, 3003, 4000 FLX", transport="pseudo-terminal", by="Debian inputattach"
)
@pytest.mark.parametrize("model", ["spaceball-2003", "spaceball-3003", "spaceball-4000"])
def test_inputattach_starts_it(model, script, tmp_path):
    """inputattach then loads the kernel's line discipline, which a pseudo-terminal may lack."""
    if shutil.which("inputattach") is None:
        pytest.skip("there is no inputattach: install the Debian package inputattach")
    port = str(tmp_path / "port")
    peer = SerialPuckPeer(SerialPuckPeerOptions(port=port, model=model, script=script))
    with in_a_thread(peer):
        process = subprocess.Popen(
            ["inputattach", "--spaceball", port], stderr=subprocess.PIPE, text=True
        )
        try:
            _, words = process.communicate(timeout=8.0)
        except subprocess.TimeoutExpired:  # with the line discipline it keeps running
            process.terminate()
            _, words = process.communicate()
    assert "initialization failed" not in words
    assert peer.device.refused_commands == 0
