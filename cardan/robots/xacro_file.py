"""Reader of an arm's description: a URDF, an expanded ``.xacro``, or MuJoCo's ``.xml`` converted.

xacro evaluates the Python expressions of a file, and reads any file that it names, so a ``.xacro``
is a program.
"""

from __future__ import annotations

import contextlib
import io
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

from cardan.common.extras import missing_extra
from cardan.common.files import MODEL_BYTES
from cardan.common.resource_errors import shortage
from cardan.common.tables import read_text
from cardan.errors import ConfigurationError, about
from cardan.robots.arm_file import ArmFile
from cardan.robots.mesh_files import find_package, package_folders
from cardan.robots.mjcf import urdf_of

MJCF = ".xml"
DESCRIPTIONS = (".urdf", ".xacro", MJCF)
"""Suffixes of the files that `read_description` reads."""
_ROS_PACKAGES = "ament_index_python.packages"
"""Module of ROS 2 that xacro uses to find packages."""


class _Arguments(dict[str, str]):
    """Arguments for xacro, which adds defaults; records those that were read."""

    def __init__(self, given: dict[str, str]) -> None:
        super().__init__(given)
        self.asked: dict[str, None] = {}

    def __contains__(self, name: object) -> bool:
        self.asked[str(name)] = None
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.asked[name] = None
        return super().__getitem__(name)


def is_xacro(path: Path) -> bool:
    """True if the file must be expanded."""
    return path.suffix.lower() == ".xacro"


def read_description(path: Path, file: ArmFile) -> str:
    """Return the URDF at `path`. Raises ConfigurationError, also for arguments in `file` that it
    does not take; ExtraMissingError."""
    text = read_text(path, MODEL_BYTES, declared=True)
    if not is_xacro(path):
        if file.xacro:
            raise ConfigurationError("xacro", f"{path} takes no arguments: it is not a .xacro file")
        if path.suffix.lower() != MJCF:
            return text
        with about(path):
            return urdf_of(text)
    arguments = _Arguments(dict(file.xacro))
    text = _expanded(path, arguments, file)
    for name in file.xacro:
        if name not in arguments.asked:
            allowed = ", ".join(arguments.asked) or "none"
            raise ConfigurationError(
                f"xacro.{name}", f"{path} has no such argument; allowed: {allowed}"
            )
    return text


def _expanded(path: Path, arguments: _Arguments, file: ArmFile) -> str:
    try:
        import xacro
    except ImportError as error:
        instead = f"{path}, unless you expand it by `xacro FILE > arm.urdf`,"
        raise missing_extra(instead, "xacro", "xacro", error) from None
    folders = package_folders(file, path)

    def find(name: str) -> str:
        return str(find_package(name, path, folders).absolute())

    try:
        with _finds_packages(find), contextlib.redirect_stderr(io.StringIO()):
            document = xacro.process_file(str(path.absolute()), mappings=arguments, verbosity=0)
    except Exception as error:  # Expressions may raise any Python exception.
        if shortage(error):
            raise
        at = (xacro.filestack or [path])[-1]
        raise ConfigurationError("", f"{at}: {_reason(error)}") from None
    text: str = document.documentElement.toprettyxml(indent="  ")
    return text


@contextlib.contextmanager
def _finds_packages(find: Callable[[str], str]) -> Iterator[None]:
    """Have xacro call `find` for the folder of a package, with or without ROS."""
    module, before = ModuleType(_ROS_PACKAGES), sys.modules.get(_ROS_PACKAGES)
    vars(module)["get_package_share_directory"] = find
    sys.modules[_ROS_PACKAGES] = module
    try:
        yield
    finally:
        del sys.modules[_ROS_PACKAGES]
        if before is not None:
            sys.modules[_ROS_PACKAGES] = before


def _reason(error: Exception) -> str:
    """Return the reason in one line. xacro wraps its errors as `exc`."""
    from xacro.substitution_args import ArgException

    cause: BaseException = error
    while isinstance(inner := getattr(cause, "exc", None), BaseException):
        cause = inner
    if isinstance(cause, ArgException):
        return f'xacro needs the argument {cause}: xacro = {{ {cause} = "…" }} in the arm\'s .toml'
    if isinstance(cause, ConfigurationError):
        return str(cause)
    return " ".join(f"xacro cannot expand it: {error}".split())
