"""All checks together and their report, which names no person and no device."""

import json
import socket

import pytest

from cardan.doctor import examine as examining, registry
from cardan.doctor.base import Check, FindingLevel, Subject, caution, failure, good
from cardan.doctor.examine import (
    Examined,
    as_json,
    examine,
    masked,
    report,
    secrets_of,
    worst,
)
from cardan.doctor.files import read_files
from cardan.drivers.base import FoundDevice


class Fine(Check):
    """Fine."""

    group, tells = "one", ("fine",)

    @classmethod
    def look(cls, subject):
        return [good("fine", "it is fine")]


class Broken(Check):
    """Broken."""

    @classmethod
    def look(cls, subject):
        yield caution("half", "half", "why", "mend")
        raise ValueError("no\nline")


class Nonsense(Check):
    """Nonsense."""

    group = "one"

    @classmethod
    def look(cls, subject):
        return ["fine"]


def test_a_check_that_fails_is_a_finding_and_ends_no_other():
    found = list(examine(Subject(), {"fine": Fine, "broken": Broken, "nonsense": Nonsense}))
    assert [(each.group, each.finding.code) for each in found] == [
        ("one", "fine"),
        ("one", "check"),
        ("broken", "check"),
    ]
    assert found[1].finding.what.endswith("TypeError: 'fine' is not a Finding")
    assert found[2].finding.what == "the check 'broken' itself failed: ValueError: no line"


def test_too_little_memory_is_no_finding():
    class Hungry(Fine):
        @classmethod
        def look(cls, subject):
            raise MemoryError

    with pytest.raises(MemoryError):
        list(examine(Subject(), {"hungry": Hungry}))


def test_the_gravest_level():
    fine, careful, bad = (
        Examined("g", each) for each in (good("a", "b"), caution(*"abcd"), failure(*"abcd"))
    )
    assert worst([]) is worst([fine]) is FindingLevel.GOOD
    assert worst([fine, careful, fine]) is FindingLevel.CAUTION
    assert worst([careful, bad]) is FindingLevel.FAILURE


def test_json():
    reported = json.loads(as_json([Examined("g", failure("code", "what", "why", "mend"))]))
    assert reported["level"] == "failure"
    assert reported["findings"] == [
        {"group": "g", "level": "failure", "code": "code", "what": "what", "why": "why",
         "mend": "mend"}
    ]  # fmt: skip


def test_every_check_of_ours_is_declared():
    for name in registry.BUILT_IN:
        check = registry.load(name)
        assert check.group
        assert check.tells
        assert check.__doc__
    assert registry.names()[: len(registry.BUILT_IN)] == tuple(registry.BUILT_IN)


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("no 00:1E:35:AB:CD:EF here", "no **:**:**:**:**:** here"),
        ("/dev/serial/by-id/usb-FTDI_A1B2-if00: no", "/dev/.../by-id/*** no"),
        ("/home/ana/lab.toml of ana at lab7", "***/lab.toml of *** at ***"),
        ("banana, lab77", "banana, lab77"),
        ("serial S-12", "serial ***"),
        ("pin 1 of vm", "pin 1 of ***"),
    ],
)
def test_what_is_masked(text, reported):
    assert masked(text, {"/home/ana", "ana", "lab7", "S-12", "1", "vm"}) == reported


def test_a_report_names_nobody(tmp_path, monkeypatch):
    usb = tmp_path / "usb"
    (usb / "1-1").mkdir(parents=True)
    (usb / "1-1" / "serial").write_text("SN00112233\n")
    monkeypatch.setattr(examining, "USB_DEVICES", usb)
    monkeypatch.setattr(examining.getpass, "getuser", lambda: "ana")
    monkeypatch.setattr(examining.os.path, "expanduser", lambda _: "/home/ana")
    file = tmp_path / "mouse.toml"
    file.write_text(
        '[device]\ndriver = "spacemouse"\nserial = "A1B2C3"\n[robot]\ndriver = "abb_egm"\n'
    )
    config, wrong = read_files([file])
    assert not wrong
    mouse = FoundDevice("mouse SN00112233", "", "", "/dev/hidraw0", "serial A1B2C3", "spacemouse")
    subject = Subject((file,), config, devices=lambda: [mouse])
    found = [
        Examined("devices", failure("device", f"{mouse.name}: {mouse.obstacle}", "why", "mend")),
        Examined("files", good("file", f"/home/ana/x.toml on {socket.gethostname()} by ana")),
    ]
    text = report(found, secrets_of(subject))
    assert "FAILURE [device] mouse ***: serial ***" in text
    assert "***/x.toml on *** by ***" in text
    for secret in ("SN00112233", "A1B2C3", "/home/ana"):
        assert secret not in text
    assert "Python 3." in text
    assert "typer " in text
