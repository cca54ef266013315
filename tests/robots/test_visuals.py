"""Visual meshes in the form that a browser draws; those that cannot be shown are reported."""

from __future__ import annotations

import numpy as np
import pytest

from cardan.common.files import cache_folder
from cardan.errors import ConfigurationError
from cardan.gateway.servers.console.site import SECURITY, VISUALS, visual
from cardan.robots import visuals
from cardan.robots.visuals import keep_visuals, stored_visual

CORNERS = [(0.0, 0.0, 0.0), (0.3, 0.0, 0.0), (0.3, 0.2, 0.0), (0.0, 0.2, 0.0)]
OBJ = "".join("v {} {} {}\n".format(*corner) for corner in CORNERS)
SQUARE = f"{OBJ}f 1 2 3 4\n"
OTHER = f"{OBJ}f -4/1 -3/1 -2/1\n"
URDF = """<robot name="own"><link name="base">
<visual><geometry><mesh filename="{}"/></geometry></visual>
<visual><geometry><box size="1 1 1"/></geometry></visual></link>
<link name="arm"><visual><geometry><mesh filename="{}" scale="2 2 2"/></geometry></visual>
<collision><geometry><mesh filename="never.stl"/></geometry></collision></link>
<joint name="one" type="revolute"><parent link="base"/><child link="arm"/>
<limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>"""


@pytest.fixture
def own(tmp_path, monkeypatch):
    """Write the file of an arm with these two visual meshes."""
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path / "cache"))
    package = tmp_path / "own_description"
    package.mkdir()
    (package / "square.obj").write_text(SQUARE)
    (package / "other.OBJ").write_text(OTHER)
    path = package / "own.urdf"

    def write(first="package://own_description/square.obj", second="other.OBJ"):
        path.write_text(URDF.format(first, second))
        return str(path)

    return write


def drawn(data):
    """Return triangles by their corners' coordinates."""
    corners, triangles = np.frombuffer(data, "<u4", 2)
    positions = np.frombuffer(data, "<f4", 3 * corners, 8).reshape(-1, 3)
    indices = np.frombuffer(data, "<u4", offset=8 + 12 * corners).reshape(-1, 3)
    assert len(indices) == triangles
    assert len(np.unique(positions, axis=0)) == corners
    return positions[indices]


def test_each_mesh_is_kept_by_what_it_has(own):
    stored = keep_visuals(own())
    assert list(stored.keys) == ["package://own_description/square.obj", "other.OBJ"]
    assert stored.in_words() == ""
    square, other = (stored_visual(key) for key in stored.keys.values())
    expected = [[CORNERS[0], CORNERS[1], CORNERS[2]], [CORNERS[0], CORNERS[2], CORNERS[3]]]
    np.testing.assert_allclose(drawn(square), expected, atol=1e-7)
    np.testing.assert_allclose(drawn(other), expected[:1], atol=1e-7)


def test_a_mesh_is_read_once_for_all_that_have_it(own, tmp_path, monkeypatch):
    first = keep_visuals(own())
    (tmp_path / "own_description" / "copy.obj").write_text(SQUARE)
    monkeypatch.setattr("cardan.robots.meshes.surface_in", None)
    assert keep_visuals(own(second="copy.obj")).keys["copy.obj"] in first.keys.values()


def test_one_that_is_damaged_in_the_cache_is_read_again(own):
    (key, *_) = keep_visuals(own()).keys.values()
    before = stored_visual(key)
    (file,) = (cache_folder() / visuals.KIND).glob(f"{key}*")
    file.write_bytes(file.read_bytes()[:-1])
    assert stored_visual(key) is None
    keep_visuals(own())
    assert stored_visual(key) == before


@pytest.mark.parametrize(
    ("uri", "text", "words"),
    [
        ("none.obj", None, "mesh 'none.obj' is not there; looked for: "),
        ("package://nobody/none.obj", None, "in no package of that name"),
        ("https://example.org/a.stl", None, "must be a path, or begin with package://"),
        ("/dev/zero", None, "is not there; looked for: /dev/zero (not a file)"),
        ("", None, "mesh '' is not there"),
        ("bad.obj", "f 1 2 3\n", "bad.obj is cut off or damaged"),
        ("bad.stl", "solid", "bad.stl is cut off"),
        ("bad.dae", "<COLLADA/>", "bad.dae has no scene"),
        ("far.obj", "v 1e300 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\n", "a corner that is not finite"),
        ("own.urdf", None, "is not a format that can be read: .stl, .obj, .dae"),
    ],
)
def test_one_that_cannot_be_shown_is_left_out_and_said(own, tmp_path, uri, text, words):
    if text is not None:
        (tmp_path / "own_description" / uri).write_text(text)
    for _ in range(2):
        stored = keep_visuals(own(second=uri))
        assert list(stored.keys) == ["package://own_description/square.obj"]
        assert stored.in_words().startswith("1 of 2 visual meshes are not shown, bodies stand in")
        assert words in stored.in_words()


def test_one_that_is_too_large_is_left_out_and_not_read_again(own, monkeypatch):
    monkeypatch.setattr(visuals, "MOST_BYTES", 8 + 12 * 4 + 12 * 2 - 1)
    for _ in range(2):
        stored = keep_visuals(own())
        assert list(stored.keys) == ["other.OBJ"]
        assert "square.obj takes more than" in stored.in_words()
        monkeypatch.setattr("cardan.robots.meshes.surface_in", None)


def test_an_arm_has_no_more_than_its_share(own, monkeypatch):
    monkeypatch.setattr(visuals, "MOST_BYTES_OF_ARM", 8 + 12 * 4 + 12 * 2)
    stored = keep_visuals(own())
    assert list(stored.keys) == ["package://own_description/square.obj"]
    assert "'other.OBJ' is beyond the" in stored.in_words()
    # A repeated mesh is stored once.
    monkeypatch.setattr(visuals, "METHOD", "other")
    assert keep_visuals(own(second="square.obj")).in_words() == ""


def test_without_a_folder_to_keep_it_in_nothing_is_shown(own, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path / "file"))
    stored = keep_visuals(own())
    assert stored.keys == {}
    assert "no cache folder can be written to" in stored.in_words()


def test_our_arms_have_none_and_a_bad_file_is_one_error(own, tmp_path):
    assert keep_visuals("ur5") == ({}, ())
    (tmp_path / "bad.urdf").write_text("<robot/>")
    with pytest.raises(ConfigurationError):
        keep_visuals(str(tmp_path / "bad.urdf"))


def test_the_console_has_what_is_kept_and_nothing_else(own, tmp_path):
    (key, *_) = keep_visuals(own()).keys.values()
    answer = visual(key)
    assert answer.body == stored_visual(key)
    assert set(SECURITY) < set(answer.headers)
    assert dict(answer.headers)["Cache-Control"].startswith("private")
    (tmp_path / "cache" / "fits").mkdir()
    secret = "0" * 64
    (tmp_path / "cache" / "fits" / f"{secret}.json").write_text("no mesh")
    for other in (
        *(secret, f"../fits/{secret}", f"{key}.json", key.upper(), f"{key}\n", "", "."),
        *(f"/{key}", str(tmp_path / "own_description" / "square.obj"), "%2e%2e", key[:-1]),
    ):
        assert visual(other) is None, other
    assert VISUALS == "/visuals/"
