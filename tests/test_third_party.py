"""Installed third-party package: every list has its driver, simulated peer and demo, and its demo
runs."""

from textwrap import dedent

import pytest

from tests import installed

pytestmark = pytest.mark.matrix

ENTRY_POINTS = {
    "cardan.drivers": {"lever": "lever.driver:Lever"},
    "cardan.sim_peers": {"lever": "lever.peer:LeverCommand"},
}
FILES = {
    "lever/__init__.py": "",
    "lever/driver.py": """
        import socket
        import time
        from dataclasses import dataclass

        from cardan.drivers.base import OperatorDevice
        from cardan.errors import DeviceNotFoundError
        from cardan.types import NEVER_S, DeviceCapabilities, DeviceLink, DeviceState

        @dataclass(frozen=True, kw_only=True)
        class LeverOptions:
            path: str = "lever.sock"

        class Lever(OperatorDevice):
            Options = LeverOptions
            summary = "a lever that moves one axis"
            page = "https://lever.example/cardan"
            peer = "lever"
            gives, suits = "one deflection", "rate"
            udev_matches = ('SUBSYSTEM=="lever"',)
            capabilities = DeviceCapabilities(
                gives_pose=False, buttons=(), feedback=frozenset(), battery=False
            )
            _link, _deflection, _stamp_s, _socket = DeviceLink.CLOSED, 0.0, NEVER_S, None

            def open(self):
                self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
                try:
                    self._socket.connect(self.options.path)
                except OSError:
                    raise DeviceNotFoundError(f"no lever at {self.options.path}") from None
                self._socket.setblocking(False)
                self._link = DeviceLink.NEEDS_NEUTRAL

            def close(self):
                self._link = DeviceLink.CLOSED
                if self._socket is not None:
                    self._socket.close()
                    self._socket = None

            def diagnosis(self):
                return ()

            def button_events(self):
                return ()

            def state(self):
                try:
                    while self._socket and (packet := self._socket.recv(64)):
                        self._deflection, self._stamp_s = float(packet), time.monotonic()
                        if self._deflection == 0.0:
                            self._link = DeviceLink.LIVE
                except OSError:
                    pass
                x = self._deflection if self._link is DeviceLink.LIVE else 0.0
                return DeviceState(
                    stamp_s=self._stamp_s,
                    link=self._link,
                    axes=(0.0, 0.0, x, 0.0, 0.0, 0.0),
                    buttons=frozenset(),
                )
    """,
    "lever/peer.py": '''
        import math
        import socket
        import time
        from dataclasses import dataclass

        from cardan.sim_peers.base import SimulatedPeer, serve
        from cardan.sim_peers.command import PeerCommand, option

        @dataclass(frozen=True, kw_only=True)
        class LeverPeerOptions:
            path: str = option("lever.sock", "The socket to create.", metavar="PATH")

        class LeverPeer(SimulatedPeer):
            endpoint = ""

            def __init__(self, options):
                self.endpoint = options.path

            def open(self):
                self._server = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
                self._server.bind(self.endpoint)
                self._server.listen()

            def step(self, until_s):
                self._server.settimeout(max(0.001, until_s - time.monotonic()))
                try:
                    client, _ = self._server.accept()
                except OSError:
                    return
                began_s = time.monotonic()
                with client:
                    while (since_s := time.monotonic() - began_s) < 60.0:
                        pushed = 0.5 * math.sin(2.0 * since_s) if since_s > 0.5 else 0.0
                        try:
                            client.send(str(pushed).encode())
                        except OSError:
                            return
                        time.sleep(0.01)

            def close(self):
                self._server.close()

        class LeverCommand(PeerCommand[LeverPeerOptions]):
            """A lever that a hand swings."""

            Options = LeverPeerOptions

            @staticmethod
            def run(options, seconds):
                serve(LeverPeer(options), seconds)
    ''',
    "lever/examples/lever-simulated.toml": """
        # A lever lifts a simulated UR5. Without hardware, in two terminals:
        #   cardan sim lever --path lever.sock
        #   cardan run lever-simulated.toml
        #
        # /// demo
        # description = "simulated lever -> gateway -> simulated UR5"
        # success_message = "the lever lifted the robot"
        # launch = ["sim lever --path {device.path}"]
        # files = ["device.path"]
        # ///

        [device]
        driver = "lever"
        path = "lever.sock"

        [robot]
        driver = "sim_arm"
        robot = "ur5"

        [arm]
        model = "ur5"
    """,
}


@pytest.fixture
def cardan(tmp_path):
    """Run the command line with the package installed; return its output."""
    site = tmp_path / "site"
    for name, text in FILES.items():
        file = site / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(dedent(text).lstrip("\n"), encoding="utf-8")
    installed.add_metadata(site, "lever", ENTRY_POINTS)

    def run(*words):
        code, said = installed.cardan(*words, sites=(site,))
        assert code in (0, 4), said
        return said

    return run


def test_it_is_in_every_list(cardan):
    (line,) = (line for line in cardan("devices", "drivers").splitlines() if "lever" in line)
    for words in ("[device]", "a lever that moves one axis", "https://lever.example/cardan"):
        assert words in line
    assert " lever  " in cardan("sim", "--list")
    assert "A lever that a hand swings." in cardan("sim", "--help")
    assert "--path" in cardan("sim", "lever", "--help")
    assert '# a lever that moves one axis\nSUBSYSTEM=="lever", MODE=' in cardan("devices", "udev")
    demos = cardan("demo", "--list")
    assert "simulated lever -> gateway -> simulated UR5" in demos
    assert " gofa " in demos


def test_its_demo_runs(cardan):
    said = cardan("demo", "lever", "--seconds", "4")
    assert said.startswith("simulated lever -> gateway -> simulated UR5\n")
    # A busy computer may miss cycles; the robot has moved in any case.
    assert "the lever lifted the robot" in said or "cycles were missed" in said
    for never in ("never commanded", "no path", "disengaged 1"):
        assert never not in said
