"""The console's demo: its page waits for a user, and the demo ends without one."""

import os
import shutil
import subprocess
import sys

import pytest

from cardan.gateway.servers.console.site import FOLDER
from cardan.gateway.session.session import EXIT_OK


def demo(seconds, tmp_path, path, *packages):
    """Return the output of ``cardan demo console`` and its exit code.

    `path` replaces PATH; the folders in `packages` come first in Python's module path.
    """
    done = subprocess.run(
        [sys.executable, "-m", "cardan", "demo", "console", "--seconds", str(seconds)],
        capture_output=True,
        text=True,
        check=False,
        env={
            **os.environ,
            "PATH": path,
            "PYTHONPATH": os.pathsep.join((*packages, os.environ.get("PYTHONPATH", ""))),
            "STATE_DIRECTORY": str(tmp_path),
            "COLUMNS": "200",
            "NO_COLOR": "1",
        },
    )
    return done.returncode, done.stdout + done.stderr


@pytest.mark.matrix
@pytest.mark.parametrize("encrypted", [True, False], ids=["openssl", "no openssl"])
def test_the_page_waits_for_a_person_and_says_where(tmp_path, encrypted):
    pytest.importorskip(
        "zenoh", reason="eclipse-zenoh is not installed: pip install cardan[console]"
    )
    if not (FOLDER / "manifest.json").exists():
        pytest.skip("the page is not built: run tools/console")
    programs, packages = tmp_path / "bin", tmp_path / "packages"
    programs.mkdir()
    packages.mkdir()
    if encrypted:
        openssl = shutil.which("openssl")
        if openssl is None:
            pytest.skip("openssl is not installed (Debian package openssl)")
        (programs / "openssl").symlink_to(openssl)
    # With this package installed, the console makes certificates, too.
    (packages / "cryptography.py").write_text("raise ImportError\n")
    code, said = demo(15, tmp_path, str(programs), str(packages))
    assert code == EXIT_OK, said
    assert "nobody moved the arm" in said
    assert "server console: http" in said
    assert "open the page, press *Enable motion*" in said
    # The QR code of the address appears only if phones may connect.
    assert (said.count("█") > 50) is encrypted
    assert ("certificate SHA-256" in said) is encrypted
    assert ("for this computer alone" in said) is not encrypted
    assert ("#t=" in said) is encrypted
