"""Loader of arms by name or file.

`cardan/robots` has the built-in arms, and :func:`load_arm` takes the path of any other. A table
beside each built-in arm has Pinocchio's reading of it, so that drivers and simulated peers need no
Pinocchio; ``python -m tests.arm_tables`` writes the tables.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from functools import cache
from importlib import resources
from importlib.util import find_spec
from pathlib import Path

from cardan.common.cache import content_key
from cardan.common.files import MODEL_BYTES, expanded
from cardan.common.options import suggestion
from cardan.common.places import in_file, place_of
from cardan.common.tables import parse_toml, read_table, read_text
from cardan.errors import ConfigurationError, about, below
from cardan.robots.arm_file import ArmFile
from cardan.robots.arm_model import ArmModel
from cardan.robots.arm_table import from_table, keep_arm, stored_arm
from cardan.robots.mesh_files import meshes_of, read_mesh
from cardan.robots.urdf import disabled_pairs, read_tree
from cardan.robots.xacro_file import DESCRIPTIONS, read_description

FOLDER = Path(str(resources.files("cardan").joinpath("robots")))


class ArmTexts:
    """Texts of an arm's files.

    Raises ConfigurationError for unreadable files, and for an invalid ``.toml`` or ``.srdf``;
    ExtraMissingError for a ``.xacro`` if xacro is missing.
    """

    def __init__(self, path: Path) -> None:
        self.urdf_path, self.toml_path, self.file = path, None, ArmFile(urdf="")
        self.disabled: frozenset[tuple[str, str]] | None = None
        texts = []
        if path.suffix.lower() == ".toml":
            self.toml_path = path
            texts.append(read_text(path))
            with about(path), in_file(path):
                self.file = read_table(ArmFile, parse_toml(texts[0], path))
                self.urdf_path = located(self.file.urdf, path.parent)
                self.urdf = read_description(self.urdf_path, self.file)
                if self.file.srdf:
                    srdf_path = located(self.file.srdf, path.parent)
                    texts.append(read_text(srdf_path, MODEL_BYTES, declared=True))
            if self.file.srdf:
                with about(srdf_path):
                    self.disabled = disabled_pairs(texts[1])
        else:
            self.urdf = read_description(path, self.file)
        self.texts = (*texts, self.urdf)

    def parts(self) -> list[str | bytes]:
        """Return all inputs of the arm, also meshes. Raises ConfigurationError."""
        with self._blamed():
            meshes = meshes_of(read_tree(self.urdf), self.file, self.urdf_path)
            return [
                *self.texts,
                *(
                    each.missing if each.path is None else read_mesh(each.path)
                    for each in meshes.values()
                ),
            ]

    def build(self) -> ArmModel:
        """Build the arm by Pinocchio. Raises ConfigurationError, ExtraMissingError."""
        with self._blamed():
            return _build(self.urdf, self.file, self.urdf_path, self.disabled)

    @contextlib.contextmanager
    def _blamed(self) -> Iterator[None]:
        """Attribute errors of a key to the ``.toml``, others to the URDF."""
        try:
            yield
        except ConfigurationError as error:
            at = str(self.urdf_path)
            if error.key and self.toml_path:
                at = place_of(self.toml_path, error.key)
            raise ConfigurationError("", f"{at}: {error}") from None


def _build(
    text: str,
    file: ArmFile,
    path: Path | None = None,
    disabled: frozenset[tuple[str, str]] | None = None,
) -> ArmModel:
    tree = read_tree(text)
    meshes = meshes_of(tree, file, path)
    # An extra: reading from a table needs none.
    from cardan.robots.arm_reader import build_arm

    return build_arm(tree, file, meshes, disabled)


def parse_urdf(text: str) -> ArmModel:
    """Make the arm of a URDF, from base to tip, with defaults for everything that a URDF cannot
    express.

    Raises ConfigurationError for text that is not URDF, has several ends, lacks a limit, has
    invalid numbers, or has meshes where primitives are needed; ExtraMissingError.
    """
    return _build(text, ArmFile(urdf=""))


def arm_names() -> tuple[str, ...]:
    """Return the names of the built-in arms, sorted."""
    return tuple(sorted(file.stem for file in FOLDER.glob("*.urdf")))


@cache
def load_arm(name_or_file: str, key: str = "") -> ArmModel:
    """Load a built-in arm by name, or an arm from a ``.toml``, ``.urdf``, ``.xacro`` or ``.xml``
    (MJCF) file.

    The file is given as a path, or as ``PACKAGE:FILE`` if it is in an installed package. Raises
    ConfigurationError with the option `key`, the file, its error, and the allowed values;
    ExtraMissingError if Pinocchio is missing and has never read the file, or if xacro is missing.
    """
    if key:
        with below(key):
            return load_arm(name_or_file)
    if name_or_file in arm_names():
        return _ours(name_or_file)
    if not name_or_file.lower().endswith((".toml", *DESCRIPTIONS)):
        raise ConfigurationError(
            "",
            f"there is no arm {name_or_file!r}; allowed: {', '.join(arm_names())}, "
            "the path of a .toml, .urdf, .xacro or .xml (MJCF) file, or PACKAGE:FILE for one in a "
            "package" + suggestion(name_or_file, arm_names()),
        )
    texts = ArmTexts(located(name_or_file, Path()))
    parts = texts.parts()
    arm = stored_arm(parts, texts.urdf)
    if arm is None:
        arm = texts.build()
        keep_arm(parts, texts.urdf, arm)
    return arm


def require_same_arm(key: str, model: str, robot: str) -> None:
    """Raise ConfigurationError, for `key`, if a `model` and the `robot` that a driver is configured
    for are different built-in arms. Files are not compared: they are variants of any arm."""
    ours = arm_names()
    if model != robot and model in ours and robot in ours:
        raise ConfigurationError(
            key,
            f"is {model!r}, and the driver's robot is {robot!r}, set or by default: the arm would "
            "move at other speeds and places than computed; name the arm that stands there in both",
        )


def our_texts(name: str) -> ArmTexts:
    """Return the files of a built-in arm."""
    path = FOLDER / f"{name}.toml"
    return ArmTexts(path if path.exists() else path.with_suffix(".urdf"))


def _ours(name: str) -> ArmModel:
    texts, path = our_texts(name), FOLDER / f"{name}.json"
    table = read_text(path) if path.exists() else ""
    return from_table(table, content_key(texts.texts), texts.urdf) or texts.build()


def located(name: str, folder: Path) -> Path:
    """Return a file in `folder`, or in the package that the name begins with (``PACKAGE:FILE``).
    Raises ConfigurationError."""
    package, colon, file = name.partition(":")
    if not (colon and package.isidentifier()):
        return folder / expanded(name)
    spec = find_spec(package)
    if spec is None or not spec.submodule_search_locations:
        raise ConfigurationError("", f"{name!r}: there is no package {package!r}")
    return Path(spec.submodule_search_locations[0], file)
