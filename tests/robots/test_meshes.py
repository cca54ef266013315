"""Mesh files: found by every form of their names, and read or rejected in one line."""

import contextlib
import math
import struct
import warnings

import coal
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from cardan.common import files
from cardan.errors import ConfigurationError
from cardan.robots import mesh_files, meshes
from cardan.robots.mesh_files import read_mesh
from cardan.robots.meshes import UNSCALED, points_in, surface_in
from cardan.types import Vector3


def find_mesh(*what):
    path, missing = mesh_files.find_mesh(*what)
    assert (path is None) == bool(missing)
    if missing:
        raise ConfigurationError("", missing)
    return path


def load_mesh(path, scale=UNSCALED):
    return points_in(read_mesh(path), path, scale)


CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], dtype=float)
FACES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
PLACED = [CORNERS[corner] for face in FACES for corner in face]


def binary_stl(head=b"made by a program"):
    facets = [
        struct.pack("<12fH", *(0.0,) * 3, *(n for corner in face for n in CORNERS[corner]), 0)
        for face in FACES
    ]
    return head.ljust(80, b" ") + struct.pack("<I", len(facets)) + b"".join(facets)


def ascii_stl():
    lines = ["solid body"]
    for face in FACES:
        lines += [" facet normal 0 0 0", "  outer loop"]
        lines += ["   vertex {:e} {:e} {:e}".format(*CORNERS[corner]) for corner in face]
        lines += ["  endloop", " endfacet"]
    return "\n".join([*lines, "endsolid body", ""]).encode()


def obj():
    lines = ["# a comment", "mtllib none.mtl", *("v {} {} {} 1.0".format(*c) for c in CORNERS)]
    lines += ["v 9 9 9", "vn 0 0 1", *(f"f {a + 1}//1 {b + 1}//1 {c + 1}" for a, b, c in FACES)]
    return "\n".join([*lines, ""]).encode()


DAE = """<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset>{unit}<up_axis>Y_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="s"><float_array id="a" count="15">0 0 0 1 0 0 0 2 0 0 0 3 9 9 9</float_array>
<technique_common><accessor source="#a" count="5" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/>
<input semantic="NORMAL" source="#s" offset="1"/>
<p>0 0 2 0 1 0 0 0 1 0 3 0 0 0 3 0 2 0 1 0 2 0 3 0</p></triangles>
</mesh></geometry></library_geometries>
<library_nodes><node id="more"><instance_geometry url="#g"/></node></library_nodes>
<library_visual_scenes><visual_scene id="scene"><node id="top">{transform}
<node><instance_geometry url="#g"/></node></node>{more}</visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#scene"/></scene></COLLADA>"""


def dae(unit="", transform="", more=""):
    return DAE.format(unit=unit, transform=transform, more=more).encode()


KINDS = {"stl": binary_stl(), "ascii.stl": ascii_stl(), "obj": obj(), "dae": dae()}


def distinct(points):
    return sorted({tuple(map(float, np.round(point, 9))) for point in points})


@pytest.fixture
def mesh(tmp_path):
    def write(data, name="body.stl"):
        path = tmp_path / name
        path.write_bytes(data)
        return path

    return write


@pytest.mark.parametrize("kind", KINDS)
def test_every_format(mesh, kind):
    points = load_mesh(mesh(KINDS[kind], f"body.{kind}"))
    assert distinct(points) == distinct(PLACED)


def turned(faces):
    """Rotate each triangle to its lowest corner first, with the same orientation."""
    found = []
    for face in faces:
        corners = [tuple(map(float, np.round(corner, 9))) for corner in face]
        first = corners.index(min(corners))
        found.append(tuple(corners[first:] + corners[:first]))
    return sorted(found)


def faces_of(path):
    surface = surface_in(read_mesh(path), path)
    return turned(surface.points[surface.triangles])


@pytest.mark.parametrize("kind", KINDS)
def test_every_format_has_its_faces(mesh, kind):
    found = faces_of(mesh(KINDS[kind], f"body.{kind}"))
    assert found == turned(CORNERS[list(face)] for face in FACES)


_SQUARE = {
    "polylist": "<vcount>4 3</vcount><p>0 0 1 0 2 0 3 0 0 0 2 0 3 0</p>",
    "polygons": "<p>0 0 1 0 2 0 3 0</p><ph><p>0 0 2 0 3 0</p><h>1 0 2 0 3 0</h></ph>",
    "trifans": "<p>0 0 1 0 2 0 3 0</p><p>0 0 2 0 3 0</p>",
    "tristrips": "<p>1 0 2 0 0 0 3 0</p><p>3 0 0 0 2 0</p>",
}


@pytest.mark.parametrize("kind", _SQUARE)
def test_faces_of_a_collada_file_by_every_element(mesh, kind):
    before, _, rest = dae().decode().partition("<p>")
    _, _, after = rest.partition("</triangles>")
    text = f"{before}{_SQUARE[kind]}</{kind}>{after}".replace("<triangles", f"<{kind}")
    found = faces_of(mesh(text.encode(), "body.dae"))
    assert found == turned(CORNERS[list(face)] for face in ((0, 1, 2), (0, 2, 3), (0, 2, 3)))


def test_an_obj_counts_back_from_where_it_is(mesh):
    lines = ["v {} {} {}".format(*corner) for corner in CORNERS]
    text = "\n".join([*lines[:3], "f -3 -2 -1", lines[3], "f -1 1 2", "f 1 2", ""])
    found = faces_of(mesh(text.encode(), "body.obj"))
    assert found == turned(CORNERS[list(face)] for face in ((0, 1, 2), (3, 0, 1)))


@pytest.mark.parametrize("kind", KINDS)
def test_every_format_as_assimp_has_it(mesh, kind):
    path = mesh(KINDS[kind], f"body.{kind}")
    loaded = coal.MeshLoader(coal.NODE_TYPE.BV_OBBRSS).load(str(path))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        theirs = np.array(loaded.vertices())
    assert distinct(theirs) == distinct(load_mesh(path))


def test_a_suffix_in_capitals_and_a_binary_file_that_begins_with_solid(mesh):
    assert distinct(load_mesh(mesh(binary_stl(b"solid body"), "BODY.STL"))) == distinct(PLACED)


@pytest.mark.parametrize("kind", KINDS)
def test_scale_is_applied(mesh, kind):
    points = load_mesh(mesh(KINDS[kind], f"body.{kind}"), Vector3(0.001, -2.0, 1.0))
    assert distinct(points) == distinct(np.array(PLACED) * (0.001, -2.0, 1.0))


@pytest.mark.parametrize(
    "scale", [(0.0, 1.0, 1.0), (1.0, math.nan, 1.0), (1.0, 1.0, math.inf), (1e9, 1.0, 1.0)]
)
def test_a_scale_that_is_none(mesh, scale):
    with pytest.raises(ConfigurationError, match=r"scale .* three numbers, none of them 0"):
        load_mesh(mesh(binary_stl()), Vector3(*scale))


def test_a_collada_file_s_unit_counts_and_its_upward_axis_does_not(mesh):
    points = load_mesh(mesh(dae('<unit name="inch" meter="0.0254"/>'), "body.dae"))
    assert distinct(points) == distinct(0.0254 * CORNERS)


def test_nodes_of_a_collada_file_place_their_parts(mesh):
    placed = "<translate>1 0 0</translate><rotate>0 0 2 90</rotate><scale>2 2 2</scale>"
    shifted = "<matrix>1 0 0 0 0 1 0 0 0 0 1 5 0 0 0 1</matrix>"
    more = f'<node>{shifted}<instance_node url="#more"/></node>'
    points = load_mesh(mesh(dae(transform=placed, more=more), "body.dae"))
    first = [(1 - 2 * y, 2 * x, 2 * z) for x, y, z in CORNERS]
    assert distinct(points) == distinct([*first, *(CORNERS + np.array([0, 0, 5]))])


BAD = {
    "an empty file": (b"", "stl", r"cut off: it has 0 bytes"),
    "a binary STL cut off": (binary_stl()[:-1], "stl", r"says 4 facets, .* 284 bytes, and has 283"),
    "a count beyond all": (
        binary_stl()[:80] + b"\xff" * 4 + binary_stl()[84:],
        "stl",
        r"says 4294967295 facets",
    ),
    "no facets": (b" " * 80 + bytes(4), "stl", "has no faces"),
    "a corner that is not a number": (
        binary_stl()[:96] + struct.pack("<f", math.nan) + binary_stl()[100:],
        "stl",
        "a corner that is not finite",
    ),
    "an ASCII STL cut off": (ascii_stl()[:-20], "stl", "has no endsolid"),
    "an ASCII STL without a number": (
        ascii_stl().replace(b"vertex 0.000000e+00", b"vertex", 1),
        "stl",
        "could not convert|three corners",
    ),
    "an ASCII STL with a word": (ascii_stl().replace(b"3.0", b"x.0", 1), "stl", "x.0"),
    "an OBJ cut off": (obj().replace(b"v 0.0 0.0 3.0", b"v 0.0", 1), "obj", "three numbers"),
    "an OBJ with a face of nothing": (
        obj().replace(b"f 1//1", b"f 7//1", 1),
        "obj",
        "not one of its",
    ),
    "an OBJ with corner 0": (obj().replace(b"f 1//1", b"f 0//1", 1), "obj", "not one of its"),
    "an OBJ that counts back too far": (
        b"v 0 0 0\nf -1 -2 1\nv 0 0 0\n",
        "obj",
        "not one of its 2",
    ),
    "an OBJ without faces": (b"v 0 0 0\n", "obj", "no faces"),
    "DAE cut off": (dae()[:-9], "dae", "is not XML"),
    "other XML": (b"<robot/>", "dae", "begins with <robot>"),
    "an encoding that there is not": (
        dae().replace(b"utf-8", b"utf-9"),
        "dae",
        "is not XML",
    ),
    "entities": (b"<!DOCTYPE x [<!ENTITY a 'a'>]><COLLADA>&a;</COLLADA>", "dae", "DOCTYPE"),
    "no scene": (dae().replace(b"<scene>", b"<x>").replace(b"</scene>", b"</x>"), "dae", "scene"),
    "a unit of nothing": (dae('<unit meter="0"/>'), "dae", "unit of 0.0 m"),
    "a unit in words": (dae('<unit meter="inch"/>'), "dae", "inch"),
    "a face of nothing": (dae().replace(b"<p>0 0", b"<p>8 0"), "dae", "not one of its 5"),
    "a vcount of other corners": (
        dae().replace(b"triangles", b"polylist").replace(b"<p>", b"<vcount>3 4</vcount><p>"),
        "dae",
        "that of its 12 corners",
    ),
    "half a corner": (dae().replace(b"<p>0 0", b"<p>0"), "dae", "23 indices, 2 for each"),
    "an offset beyond all": (dae().replace(b'offset="1"', b'offset="99999999"'), "dae", "indices"),
    "an offset before all": (dae().replace(b'offset="0"', b'offset="-1"'), "dae", "indices"),
    "fewer numbers": (dae().replace(b'count="5"', b'count="500"'), "dae", "15 numbers for 500"),
    "a stride of nothing": (dae().replace(b'stride="3"', b'stride="0"'), "dae", "positions of 0"),
    "an index of 5000 digits": (dae().replace(b"<p>0", b"<p>" + b"9" * 5000), "dae", "mesh"),
    "a source that is not there": (dae().replace(b'url="#g"', b'url="#x"'), "dae", "not there"),
    "a skin": (dae().replace(b"instance_geometry", b"instance_controller"), "dae", "a skin"),
    "another transform": (dae(transform="<skew>1 2 3 4 5 6 7</skew>"), "dae", "skew"),
    "nodes that name each other": (
        dae(
            more="".join(
                f'<node id="n{i}"><instance_node url="#n{i + 1}"/></node>' for i in range(70)
            )
            + '<node id="n70"/>'
        ),
        "dae",
        "64 nodes in each other",
    ),
    "nodes that double": (
        dae(
            more="".join(
                f'<node id="n{i}"><instance_node url="#n{i + 1}"/>'
                f'<instance_node url="#n{i + 1}"/></node>'
                for i in range(13)
            )
            + '<node id="n13"/>'
        ),
        "dae",
        "or 10000 in all",
    ),
    "nodes within each other": (
        dae(more="<node>" * 70 + "</node>" * 70),
        "dae",
        "64 nodes in each other",
    ),
    "another format": (b"ply", "ply", r"not a format .*: \.stl, \.obj, \.dae"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_file_is_one_error(mesh, case):
    data, suffix, words = BAD[case]
    path = mesh(data, f"body.{suffix}")
    with pytest.raises(ConfigurationError, match=words) as caught:
        load_mesh(path)
    assert str(path) in str(caught.value)


def test_too_many_elements(mesh, monkeypatch):
    monkeypatch.setattr(meshes, "MOST_ELEMENTS", 20)
    with pytest.raises(ConfigurationError, match="more than 20 elements"):
        load_mesh(mesh(dae(), "body.dae"))


def test_too_many_copies(mesh, monkeypatch):
    monkeypatch.setattr(meshes, "MOST_POINTS", 7)
    with pytest.raises(ConfigurationError, match="more than 7 corners"):
        load_mesh(mesh(dae(more='<instance_node url="#more"/>' * 3), "body.dae"))


def test_a_file_that_is_too_long(mesh, monkeypatch):
    monkeypatch.setattr(mesh_files, "MESH_BYTES", 2**20)
    assert files.MESH_BYTES == 64 * 2**20
    with pytest.raises(ConfigurationError, match="longer than 1 MiB"):
        load_mesh(mesh(b"solid" + bytes(2**20)))


def test_a_folder_and_a_missing_file(tmp_path):
    with pytest.raises(ConfigurationError, match=r"cannot be read: .*directory"):
        load_mesh(tmp_path)
    with pytest.raises(ConfigurationError, match="cannot be read: No such file"):
        load_mesh(tmp_path / "none.stl")


@given(
    kind=st.sampled_from(sorted(KINDS)),
    cut=st.integers(0, 2000),
    at=st.integers(0, 2000),
    byte=st.integers(0, 255),
)
@settings(max_examples=200)
def test_damaged_files_give_points_or_one_error(kind, cut, at, byte, tmp_path_factory):
    data = bytearray(KINDS[kind][: max(len(KINDS[kind]) - cut, 0) if cut < 1000 else None])
    if data:
        data[at % len(data)] = byte
    path = tmp_path_factory.getbasetemp() / f"body.{kind}"
    with contextlib.suppress(ConfigurationError):
        points = points_in(bytes(data), path)
        assert points.shape[1] == 3
        assert np.isfinite(points).all()


# ---------------------------------------------------------------------------------------------
# Locations


@pytest.fixture
def robot(tmp_path, monkeypatch):
    """Write a package like that of a source tree, and its URDF."""
    for name in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"):
        monkeypatch.delenv(name, raising=False)
    package = tmp_path / "src" / "arm_description"
    (package / "urdf").mkdir(parents=True)
    (package / "meshes").mkdir()
    (package / "meshes" / "one link.stl").write_bytes(binary_stl())
    return package / "urdf" / "arm.urdf"


def mesh_of(robot):
    return robot.parents[1] / "meshes" / "one link.stl"


URI = "package://arm_description/meshes/one link.stl"


@pytest.mark.parametrize(
    "form",
    ["../meshes/one link.stl", "{}", "file://{}", "file://localhost{}", "package", "%20"],
)
def test_every_form_of_a_name(robot, form):
    there = mesh_of(robot)
    uri = {"package": URI, "%20": f"file://{str(there).replace(' ', '%20')}"}.get(form)
    found = find_mesh(uri or form.format(there), robot)
    assert found.samefile(there)


def test_a_folder_of_another_name_with_the_package_s_file(robot):
    package = robot.parents[1]
    package.rename(package.with_name("a_checkout"))
    moved = package.with_name("a_checkout")
    (moved / "package.xml").write_text("<package><name> arm_description </name></package>")
    assert find_mesh(URI, moved / "urdf" / "arm.urdf").parent.parent == moved


def test_a_package_beside_one_above(robot):
    other = robot.parents[2] / "hand_description" / "hand.stl"
    other.parent.mkdir()
    other.write_bytes(binary_stl())
    assert find_mesh("package://hand_description/hand.stl", robot) == other


@pytest.mark.parametrize(
    ("variable", "below"), [("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")]
)
def test_ros_says_where(robot, tmp_path, monkeypatch, variable, below):
    other = tmp_path / "ros" / below / "hand_description" / "hand.stl"
    other.parent.mkdir(parents=True)
    other.write_bytes(binary_stl())
    with pytest.raises(ConfigurationError):
        find_mesh("package://hand_description/hand.stl", robot)
    monkeypatch.setenv(variable, f"/nowhere:{tmp_path / 'ros'}:")
    assert find_mesh("package://hand_description/hand.stl", robot) == other


def test_given_folders_come_first(robot, tmp_path):
    other = tmp_path / "given" / "arm_description" / "meshes" / "one link.stl"
    other.parent.mkdir(parents=True)
    other.write_bytes(binary_stl())
    for folder in (tmp_path / "given", tmp_path / "given" / "arm_description"):
        assert find_mesh(URI, robot, [folder]) == other
    assert find_mesh("meshes/one link.stl", robot, [other.parents[1]]) == other


def test_a_missing_one_is_named_with_all_places(robot, tmp_path, monkeypatch):
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "ros"))
    uri = "package://arm_description/meshes/two.stl"
    with pytest.raises(ConfigurationError) as caught:
        find_mesh(uri, robot)
    for words in (
        uri,
        str(robot.parents[1] / "meshes" / "two.stl"),
        str(tmp_path / "ros" / "share" / "arm_description" / "meshes" / "two.stl"),
        "ROS_PACKAGE_PATH",
    ):
        assert words in str(caught.value)
    with pytest.raises(ConfigurationError, match=r"'two.stl' is not there; looked for: .*two.stl"):
        find_mesh("two.stl", robot)
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    with pytest.raises(ConfigurationError, match="in no package of that name from"):
        find_mesh("package://nobody_s/two.stl", robot)


@pytest.mark.parametrize(
    ("uri", "words"),
    [
        ("http://host/one.stl", "must be a path, or begin with package:// or file://"),
        ("file://host/one.stl", "three slashes"),
        ("file://[", "three slashes"),
        ("package://", "is not there"),
        ("", "is not there"),
        ("a\0b.stl", "is not there"),
        ("x" * 5000, "is not there"),
    ],
)
def test_a_name_that_is_none(robot, uri, words):
    with pytest.raises(ConfigurationError, match=words):
        find_mesh(uri, robot)
