"""Type checkers accept the programs of the pages and examples, and know the options of every
driver, which editors offer for completion."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from cardan.drivers import registry
from tests.docs_tables import ours
from tests.npm import installed
from tests.test_docs import PAGES, ROOT, blocks

PYRIGHT = "1.1.414"
PACKAGES = [str(each) for each in sorted(ROOT.glob("examples/packages/*"))]
SOURCES = [str(ROOT), *map(str, sorted(ROOT.glob("plugins/cardan-*"))), *PACKAGES]
"""Import paths of the programs."""
EXAMPLES = [
    *(
        str(path)
        for where in ("", "ros2/", "peers/")
        for path in sorted(ROOT.glob(f"examples/{where}*.py"))
    ),
    *PACKAGES,
]
"""LeRobot's examples, also there, need a package that is not installed here."""
DRIVERS = ours(registry)
SKETCHED = "for state in robot.cycles():\n    robot.send(controller.tick("
"""Beginning of the loop in docs/architecture.md, which is a sketch, not a program."""


def is_program(code: str) -> bool:
    """Return whether a block is a whole program: fragments have no imports."""
    return re.match(r"(# \S+\n)?(import|from) ", code) is not None


def programs() -> Iterator[tuple[Path, int, str]]:
    """Return each block of Python: its page, its number there, and the block."""
    for page in PAGES:
        for number, code in enumerate(blocks(page.read_text(encoding="utf-8"), "python")):
            yield page, number, code


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with every program of the pages, and pyright's configuration."""
    made = tmp_path_factory.mktemp("programs")
    for page, number, code in programs():
        if is_program(code):
            name = "_".join(page.relative_to(ROOT).with_suffix("").parts).replace("-", "_")
            (made / f"{name}_{number}.py").write_text(code, encoding="utf-8")
    settings = {"extraPaths": SOURCES, "pythonVersion": "3.10", "typeCheckingMode": "standard"}
    (made / "pyrightconfig.json").write_text(json.dumps(settings), encoding="utf-8")
    return made


def pyright(folder: Path, *words: str) -> list[dict[str, Any]]:
    """Return the diagnostics of pyright in `folder`."""
    program = installed("pyright", PYRIGHT) / "node_modules/.bin/pyright"
    command = [program, "--outputjson", "--pythonpath", sys.executable, "-p", folder, *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    found = json.loads(done.stdout)
    assert found["summary"]["filesAnalyzed"] > 0
    diagnostics: list[dict[str, Any]] = found["generalDiagnostics"]
    return diagnostics


def test_what_is_no_program_is_part_of_an_example() -> None:
    packages = "".join(
        path.read_text(encoding="utf-8") for path in ROOT.glob("examples/packages/*/*/*.py")
    )
    parts = [code for _, _, code in programs() if not is_program(code)]
    assert [code for code in parts if code not in packages and not code.startswith(SKETCHED)] == []
    assert len(parts) < 10


@pytest.mark.matrix
def test_mypy_has_nothing_to_say(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MYPYPATH", ":".join(SOURCES[1:]))
    files = [*map(str, sorted(folder.glob("*.py"))), *EXAMPLES]
    assert len(files) > 70
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", *files],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.matrix
def test_pyright_has_nothing_to_say(folder: Path) -> None:
    assert pyright(folder, str(folder), *EXAMPLES) == []


@pytest.mark.matrix
def test_pyright_knows_the_options_of_every_driver(tmp_path: Path, folder: Path) -> None:
    (tmp_path / "pyrightconfig.json").write_bytes((folder / "pyrightconfig.json").read_bytes())
    for name, driver in DRIVERS.items():
        made_of = f"{driver.__name__}.Options"
        lines = [
            f"from {driver.__module__} import {driver.__name__}",
            f"reveal_type({made_of}())",
            f"{made_of}(pathh=1)",
        ]
        (tmp_path / f"{name}.py").write_text("\n".join(lines) + "\n", encoding="utf-8")
    reported = [
        (Path(each["file"]).stem, each["range"]["start"]["line"], each["message"])
        for each in pyright(tmp_path)
    ]
    expected = []
    for name, driver in DRIVERS.items():
        options = driver.Options.__name__
        expected += [
            (name, 1, f'Type of "{driver.__name__}.Options()" is "{options}"'),
            (name, 2, 'No parameter named "pathh"'),
        ]
    assert sorted(reported) == sorted(expected)
    assert len(DRIVERS) >= 17


class Editor:
    """Language-server client of pyright, like an editor."""

    def __init__(self, folder: Path) -> None:
        program = installed("pyright", PYRIGHT) / "node_modules/.bin/pyright-langserver"
        self._server = subprocess.Popen(
            [program, "--stdio"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        self._count = 0
        workspace = {"name": "", "uri": folder.as_uri()}
        self.ask("initialize", processId=None, capabilities={}, workspaceFolders=[workspace])
        self.tell("initialized")

    def close(self) -> None:
        self._server.kill()
        self._server.communicate()

    def tell(self, method: str, number: int | None = None, **params: Any) -> None:
        message = {"jsonrpc": "2.0", "method": method, "params": params}
        body = json.dumps(message if number is None else {**message, "id": number}).encode()
        assert self._server.stdin is not None
        self._server.stdin.write(b"Content-Length: %d\r\n\r\n%s" % (len(body), body))
        self._server.stdin.flush()

    def ask(self, method: str, **params: Any) -> Any:
        self._count += 1
        self.tell(method, self._count, **params)
        while (answer := self._read()).get("id") != self._count or "method" in answer:
            pass
        return answer["result"]

    def _read(self) -> dict[str, Any]:
        assert self._server.stdout is not None
        length = 0
        while line := self._server.stdout.readline().strip():
            if line.lower().startswith(b"content-length:"):
                length = int(line.split(b":")[1])
        found: dict[str, Any] = json.loads(self._server.stdout.read(length))
        return found


@pytest.mark.matrix
def test_an_editor_completes_options(tmp_path: Path, folder: Path) -> None:
    (tmp_path / "pyrightconfig.json").write_bytes((folder / "pyrightconfig.json").read_bytes())
    before = "cardan.SpaceMouse.Options(dead"
    editor = Editor(tmp_path)
    try:
        document = {"uri": (tmp_path / "user.py").as_uri(), "languageId": "python", "version": 1}
        program = f"import cardan\n{before})\n"
        editor.tell("textDocument/didOpen", textDocument={**document, "text": program})
        offered = editor.ask(
            "textDocument/completion",
            textDocument=document,
            position={"line": 1, "character": len(before)},
        )
    finally:
        editor.close()
    assert "dead_zone=" in [each["label"] for each in offered["items"]]
