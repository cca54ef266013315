"""Registration of dissectors: the built-in ones, and those of other packages."""

import io
import re
import struct
import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from scapy.layers.inet import IP, UDP
from scapy.layers.l2 import Ether
from scapy.utils import wrpcap
from typer.testing import CliRunner

from cardan.cli import app
from cardan.errors import ConfigurationError
from cardan_dissect import dissect_file, registry
from cardan_dissect.reader import DatagramDissector, Decoded, Numbers

DOCS = Path(__file__).parents[3] / "docs"


class Greetings(DatagramDissector):
    """Greetings on UDP ports."""

    name = "greetings"
    page = "https://example.org/greetings"
    always = False
    options = (
        Numbers("greeting_ports", "greeting-port", "PORT", "A port", "UDP port", range(1, 99), {7}),
    )

    def decode(self, segment):
        if segment.destination.port not in self.numbers["greeting_ports"]:
            return None
        return Decoded({"text": segment.payload.decode()}, "greeting")


def install(monkeypatch, target):
    point = EntryPoint("other", target, registry.ENTRY_POINT_GROUP)
    monkeypatch.setattr(registry.FINDER, "_installed", lambda: [point])


@pytest.fixture
def installed(monkeypatch):
    install(monkeypatch, f"{__name__}:Greetings")


@pytest.fixture
def capture(tmp_path):
    def write(*ports):
        frames = [Ether() / IP() / UDP(sport=900, dport=port) / b"hello" for port in ports]
        for number, frame in enumerate(frames):
            frame.time = 1e9 + number
        wrpcap(str(tmp_path / "c.pcap"), frames)
        return tmp_path / "c.pcap"

    return write


@pytest.mark.usefixtures("installed")
def test_a_dissector_of_another_package(capture):
    out = io.StringIO()
    counts = dissect_file(capture(7, 8, 9), out, greeting_ports=[9])
    for number, time_s, port in ((1, 0, 7), (3, 2, 9)):
        line = f"#{number} {time_s}.000000 127.0.0.1:900 > 127.0.0.1:{port} greeting | text 'hello'"
        assert line in out.getvalue()
    assert "greetings 127.0.0.1:900 > 127.0.0.1:9\n  1 messages\n" in out.getvalue()
    assert (counts.messages["greetings"], counts.other_packets) == (2, 1)


@pytest.mark.usefixtures("installed")
def test_what_an_earlier_reader_takes_is_not_offered_to_a_later_one(capture):
    counts = dissect_file(capture(7), io.StringIO(), egm_ports=[7])
    assert (counts.messages["EGM"], counts.messages["greetings"]) == (1, 0)


@pytest.mark.usefixtures("installed")
def test_the_command_has_the_options_of_every_dissector(capture):
    shown = CliRunner().invoke(app, ["dissect", "--help"], terminal_width=200).output
    assert "--greeting-port" in shown
    assert "greetings: Greetings on UDP ports." in shown
    arguments = ["dissect", str(capture(8)), "--summary", "--greeting-port"]
    assert "  1 messages" in CliRunner().invoke(app, [*arguments, "8"]).output
    assert CliRunner().invoke(app, [*arguments, "99"]).exit_code == 2


def test_a_dissector_that_cannot_be_loaded_disturbs_no_other_command(monkeypatch):
    install(monkeypatch, "no_such_module:Dissector")
    assert CliRunner().invoke(app, ["--help"]).exit_code == 0
    shown = CliRunner().invoke(app, ["dissect", "--help"], terminal_width=200)
    assert "--simple-message-port" in shown.output


def test_a_dissector_that_cannot_be_loaded_is_left_out_with_a_warning(monkeypatch, caplog, capture):
    install(monkeypatch, "no_such_module:Dissector")
    assert len(registry.dissectors()) == len(registry.BUILT_IN)
    assert "dissector 'other' cannot be loaded: ModuleNotFoundError" in caplog.text
    assert dissect_file(capture(7), io.StringIO(), egm_ports=[7]).messages["EGM"] == 1


def test_wrong_options_are_named(capture):
    with pytest.raises(ConfigurationError, match="egm_ports: UDP port 0, 65536: allowed are 1 to"):
        dissect_file(capture(7), io.StringIO(), egm_ports=[0, 6510, 65536])
    with pytest.raises(ConfigurationError, match=r"egm_port: no dissector .*allowed: egm_ports,"):
        dissect_file(capture(7), io.StringIO(), egm_port=[6510])


def test_declarations_name_their_pages():
    for dissector in registry.dissectors():
        assert (DOCS / dissector.page).is_file(), dissector
        assert dissector.__doc__


def test_every_option_is_on_the_page():
    page = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
    for dissector in registry.dissectors():
        for option in dissector.options:
            assert f"`--{option.flag} {option.metavar}`" in page


def test_the_example_of_the_page(tmp_path, monkeypatch):
    page = (DOCS / "adding-a-driver.md").read_text(encoding="utf-8")
    package = tmp_path / "my_package"
    package.mkdir()
    (code,) = re.findall(r"```python\n# my_package/dissect_joystick\.py\n(.*?)```", page, re.DOTALL)
    (package / "dissect_joystick.py").write_text(code, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    point = EntryPoint(
        "joystick", "my_package.dissect_joystick:JoystickDissector", "cardan.dissect"
    )
    monkeypatch.setattr(registry.FINDER, "_installed", lambda: [point])
    payloads = (struct.pack("<hh", 3, -4), b"\0")
    frames = [Ether() / IP() / UDP(sport=900, dport=7001) / payload for payload in payloads]
    for frame in frames:
        frame.time = 1e9
    wrpcap(str(tmp_path / "c.pcap"), frames)
    out = io.StringIO()
    counts = dissect_file(tmp_path / "c.pcap", out, joystick_ports=[7001])
    where = "127.0.0.1:900 > 127.0.0.1:7001"
    assert f"{where} Position | x 3 | y -4\n" in out.getvalue()
    assert f"{where} MALFORMED joystick: 1 bytes (1 B: 00)\n" in out.getvalue()
    assert f"joystick {where}\n  2 messages\n" in out.getvalue()
    assert counts.malformed["joystick"] == 1


def test_looking_at_dissectors_needs_no_scapy():
    code = (
        "import sys; sys.modules['scapy'] = None\n"
        "from cardan_dissect import registry\n"
        "print(*(d.name for d in registry.dissectors()), sep=', ')"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout == "EGM, 3Dconnexion, joint stream, simple message, RTDE, JR3, Wiimote\n"
