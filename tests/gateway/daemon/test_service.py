"""The daemon's systemd unit."""

import grp
import os
import shutil
import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest

from cardan.errors import ConfigurationError, DriverError
from cardan.gateway.daemon import service as service_module
from cardan.gateway.daemon.service import NAME, install, installed, make_service, remove


@pytest.fixture
def file(tmp_path, monkeypatch):
    monkeypatch.setattr(service_module, "OWN_FOLDERS", ())
    file = tmp_path / "my lab $1 50%.toml"
    file.touch()
    return file


@pytest.mark.parametrize("system", [False, True])
def test_systemd_finds_no_fault_with_the_unit(tmp_path, file, system):
    if shutil.which("systemd-analyze") is None:
        if os.environ.get("CI"):
            pytest.fail("systemd-analyze is missing: tools/debian-packages judges installs it")
        pytest.skip("no systemd-analyze: tools/debian-packages judges installs it")
    service = make_service([file], system=system, account="root")
    unit = tmp_path / NAME
    unit.write_text(service.text)
    done = subprocess.run(
        ["systemd-analyze", "verify", *([] if system else ["--user"]), str(unit)],
        capture_output=True, text=True, check=False,
        env={**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert str(unit) not in done.stderr


def test_the_files_name_comes_through_whole(file):
    text = make_service([file], system=False, account="me").text
    (line,) = [line for line in text.splitlines() if line.startswith("ExecStart=")]
    assert line.endswith(f' daemon run "{file.parent}/my lab $$1 50%%.toml"')


def test_a_service_of_the_computer_runs_as_somebody_and_one_of_a_user_does_not(file):
    system = make_service([file], system=True, account="lab")
    assert "User=lab\n" in system.text
    assert str(system.path) == f"/etc/systemd/system/{NAME}"
    assert system.systemctl == ["systemctl"]
    user = make_service([file], system=False, account="lab")
    assert "User=" not in user.text
    assert user.systemctl == ["systemctl", "--user"]


def test_it_joins_the_groups_that_this_computer_has(file, monkeypatch):
    groups = [SimpleNamespace(gr_name=name) for name in ("root", "dialout", "input")]
    monkeypatch.setattr(grp, "getgrall", lambda: groups)
    text = make_service([file], system=True, account="lab").text
    assert "\nSupplementaryGroups=input dialout\n" in text
    groups.clear()
    assert "SupplementaryGroups" not in make_service([file], system=True, account="lab").text


def test_sessions_are_not_killed_with_the_daemon_and_wrong_files_are_not_tried_again(file):
    for system in (False, True):
        lines = make_service([file], system=system, account="lab").text.splitlines()
        assert "KillMode=control-group" in lines
        assert "RestartPreventExitStatus=2" in lines


def test_a_file_that_the_service_would_not_find_is_refused(tmp_path, file, monkeypatch):
    monkeypatch.setattr(service_module, "OWN_FOLDERS", (Path("/srv"), tmp_path))
    with pytest.raises(ConfigurationError, match=f"has a {tmp_path} of its own .* /etc/cardan"):
        make_service([file], system=True, account="lab")
    make_service([file], system=False, account="lab")


def test_files_that_are_not_there(tmp_path):
    with pytest.raises(ConfigurationError, match="there is no"):
        make_service([tmp_path / "none.toml"], system=False, account="me")
    with pytest.raises(ConfigurationError, match="which files"):
        make_service([], system=False, account="me")


@pytest.fixture
def systemctl(tmp_path, monkeypatch):
    """A systemctl that records its arguments."""
    reported = tmp_path / "told"
    program = tmp_path / "bin" / "systemctl"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\necho "$@" >> {reported}\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}:{os.environ['PATH']}")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    return reported


def test_it_is_installed_and_removed(file, systemctl):
    service = make_service([file], system=False, account="me")
    said = install(service)
    assert service.path.read_text() == service.text
    assert systemctl.read_text() == f"--user daemon-reload\n--user enable --now {NAME}\n"
    assert said[0] == f"wrote {service.path}"
    remove(installed(system=False))
    assert not service.path.exists()
    with pytest.raises(DriverError, match="nothing was installed"):
        remove(installed(system=False))


def test_what_systemctl_refuses_is_said(file, systemctl):
    program = systemctl.parent / "bin" / "systemctl"
    program.write_text("#!/bin/sh\necho no bus here >&2\nexit 1\n")
    service = make_service([file], system=False, account="me")
    with pytest.raises(DriverError, match="no bus here"):
        install(service)
