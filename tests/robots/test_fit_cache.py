"""Cache of mesh covers: each mesh is fitted once, whatever the cache's folder contains."""

import os

import pytest

from cardan.common.files import cache_folder
from cardan.errors import ConfigurationError
from cardan.robots import fit_cache
from cardan.robots.arm_model import Capsule, OrientedBox
from cardan.robots.fit_cache import fit_mesh
from cardan.robots.fitting import Fit, fit
from cardan.types import Pose, Quaternion, Vector3

OBJ = """v 0 0 0
v 0.3 0 0
v 0 0.2 0
v 0 0 0.1
f 1 2 3
f 1 2 4
f 1 3 4
f 2 3 4
"""
FOUND = Fit(
    (
        Capsule(Vector3(0.1, 0.2, 0.3), Vector3(0.0, 0.0, 0.1), 0.05),
        OrientedBox(
            Pose(Vector3(0.1, 1e-17, 3.0), Quaternion(0.6, 0.8, 0.0, 0.0)), Vector3(0.1, 0.2, 0.3)
        ),
    ),
    0.123456789,
    0.00321,
)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.delenv("CACHE_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "cardan" / fit_cache.KIND


@pytest.fixture
def mesh(tmp_path):
    path = tmp_path / "body.obj"
    path.write_text(OBJ, encoding="utf-8")
    return path


@pytest.fixture
def fitted(monkeypatch):
    """Replace fits by a quick stand-in; return the list of its calls."""
    calls = []

    def quick(points, how):
        calls.append(how)
        return FOUND

    monkeypatch.setattr(fit_cache, "fit", quick)
    return calls


def test_what_was_found_is_found_again(mesh, folder, fitted):
    assert [fit_mesh(mesh, "tight") for _ in range(3)] == [FOUND] * 3
    assert fitted == ["tight"]
    assert [file.suffix for file in folder.iterdir()] == [".json"]


def test_a_true_fit_is_the_same_from_the_cache(mesh, folder):
    first = fit_mesh(mesh, "coarse")
    assert first == fit([[0, 0, 0], [0.3, 0, 0], [0, 0.2, 0], [0, 0, 0.1]], "coarse")
    assert fit_mesh(mesh, "coarse") == first


def test_other_bytes_scale_and_ways_are_others(mesh, folder, fitted, monkeypatch):
    fit_mesh(mesh, "tight")
    fit_mesh(mesh, "coarse")
    fit_mesh(mesh, "tight", Vector3(1.0, 1.0, 2.0))
    mesh.write_text(OBJ.replace("0.3", "0.4"), encoding="utf-8")
    fit_mesh(mesh, "tight")
    monkeypatch.setattr(fit_cache, "METHOD", -1)
    fit_mesh(mesh, "tight")
    assert len(fitted) == len(list(folder.iterdir())) == 5


def test_the_name_of_the_file_does_not_count(mesh, folder, fitted):
    fit_mesh(mesh, "tight")
    fit_mesh(mesh.rename(mesh.with_name("other.OBJ")), "tight")
    assert len(fitted) == 1


def other_digit(text):
    return text.replace("0.05", "0.04")


def of_another(text):
    return "0" * 64 + text[64:]


@pytest.mark.parametrize(
    "damage",
    [
        other_digit,
        of_another,
        lambda text: text[:-5],
        lambda text: "",
        lambda text: "null",
        lambda text: "[1]",
        lambda text: '{"shapes": 1}',
        lambda text: "[" * 100_000,
        lambda text: "\0" * 50,
        lambda text: text + " " * 2**21,
    ],
)
def test_a_damaged_file_is_written_anew(mesh, folder, fitted, damage):
    fit_mesh(mesh, "tight")
    (file,) = folder.iterdir()
    whole = file.read_text(encoding="utf-8")
    file.write_text(damage(whole), encoding="utf-8")
    assert fit_mesh(mesh, "tight") == FOUND
    assert len(fitted) == 2
    assert file.read_text(encoding="utf-8") == whole
    assert list(folder.iterdir()) == [file]


def test_a_file_of_another_mesh_under_this_name_is_ignored(mesh, folder, fitted):
    fit_mesh(mesh, "tight")
    (file,) = folder.iterdir()
    fit_mesh(mesh, "coarse")
    (other,) = {*folder.iterdir()} - {file}
    other.replace(file)
    fit_mesh(mesh, "tight")
    assert fitted == ["tight", "coarse", "tight"]


def test_a_folder_where_the_file_ought_to_be(mesh, folder, fitted):
    fit_mesh(mesh, "tight")
    (file,) = folder.iterdir()
    file.unlink()
    file.mkdir()
    assert fit_mesh(mesh, "tight") == FOUND
    assert list(folder.iterdir()) == [file]


def test_without_a_cache_it_works(mesh, folder, fitted):
    folder.parents[1].write_text("no folder", encoding="utf-8")
    assert [fit_mesh(mesh, "tight") for _ in range(2)] == [FOUND] * 2
    assert len(fitted) == 2


def test_a_user_without_a_home(mesh, fitted, monkeypatch):
    for name in ("CACHE_DIRECTORY", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)
    with pytest.raises(ConfigurationError, match="HOME"):
        cache_folder()
    assert fit_mesh(mesh, "tight") == FOUND


def test_where_the_cache_is(monkeypatch, tmp_path):
    monkeypatch.setenv("CACHE_DIRECTORY", f"{tmp_path}:/other")
    assert cache_folder() == tmp_path
    monkeypatch.delenv("CACHE_DIRECTORY")
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder() == tmp_path / ".cache" / "cardan"


def test_what_is_wrong_names_the_mesh(mesh, folder):
    mesh.write_text(OBJ.replace("0.3", "300"), encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"body\.obj: a point is .* more than 100 m away"):
        fit_mesh(mesh, "tight")
    mesh.write_text("v 0", encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"body\.obj is damaged"):
        fit_mesh(mesh, "tight")
    assert not folder.exists()
