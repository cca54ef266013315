"""Arms described by a ``.xacro`` file."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from cardan.errors import ConfigurationError, ExtraMissingError
from cardan.own_arm.added import add, toml_beside
from cardan.robots import load_arm

SPACE = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
PARTS = f"""<robot {SPACE}>
  <xacro:property name="limits" lazy_eval="false" value="${{xacro.load_yaml('limits.yaml')}}"/>
  <xacro:macro name="segment" params="n parent">
    <link name="l${{n}}"><collision><geometry><sphere radius="0.03"/></geometry></collision></link>
    <joint name="$(arg prefix)j${{n}}" type="revolute">
      <parent link="${{parent}}"/>
      <child link="l${{n}}"/>
      <origin xyz="0 0 0.3"/>
      <axis xyz="${{n % 2}} 0 ${{(n + 1) % 2}}"/>
      <limit lower="${{-pi / 2}}" upper="2" velocity="${{limits.velocity}}" effort="5"/>
    </joint>
  </xacro:macro>
</robot>"""
ARM = f"""<robot name="arm" {SPACE}>
  <xacro:arg name="prefix" default="a_"/>
  <xacro:include filename="$(find my_parts)/urdf/parts.xacro"/>
  <link name="base"/>
  <xacro:segment n="1" parent="base"/>
  <xacro:segment n="2" parent="l1"/>
</robot>"""


@pytest.fixture
def xacro():
    return pytest.importorskip(
        "xacro", reason='xacro is not installed: pip install "cardan[xacro]"'
    )


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Write an arm, and a package beside its own with a file that it includes."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("ROS_PACKAGE_PATH", raising=False)
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    load_arm.cache_clear()
    package = Path("my_parts/urdf")
    package.mkdir(parents=True)
    (package / "parts.xacro").write_text(PARTS, encoding="utf-8")
    (package / "limits.yaml").write_text("velocity: 1.5", encoding="utf-8")
    Path("arm.urdf.xacro").write_text(ARM, encoding="utf-8")
    return tmp_path


def test_it_is_expanded_with_files_of_other_packages(here, xacro):
    arm = load_arm("arm.urdf.xacro")
    assert arm.joint_names == ("a_j1", "a_j2")
    assert arm.velocity == (1.5, 1.5)


def test_packages_are_found_where_those_of_meshes_are(here, xacro, monkeypatch):
    elsewhere = Path("install/share")
    elsewhere.mkdir(parents=True)
    Path("my_parts").rename(elsewhere / "my_parts")
    with pytest.raises(ConfigurationError, match="there is no package 'my_parts' from"):
        load_arm("arm.urdf.xacro")
    monkeypatch.setenv("AMENT_PREFIX_PATH", "install")
    assert load_arm("arm.urdf.xacro").joint_names == ("a_j1", "a_j2")
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    load_arm.cache_clear()
    Path("arm.toml").write_text(
        'urdf = "arm.urdf.xacro"\npackage_dirs = ["install/share"]', encoding="utf-8"
    )
    assert load_arm("arm.toml").joint_names == ("a_j1", "a_j2")
    assert "ament_index_python.packages" not in sys.modules


def test_the_toml_has_its_arguments(here, xacro):
    Path("arm.toml").write_text(
        'urdf = "arm.urdf.xacro"\nxacro = { prefix = "left_" }', encoding="utf-8"
    )
    assert load_arm("arm.toml").joint_names == ("left_j1", "left_j2")


def test_what_is_kept_follows_included_files(here, xacro, monkeypatch):
    assert load_arm("arm.urdf.xacro").velocity == (1.5, 1.5)
    load_arm.cache_clear()
    with monkeypatch.context() as without:
        without.setitem(sys.modules, "pinocchio", None)
        without.setattr("cardan.robots.arm_loader._build", None)
        assert load_arm("arm.urdf.xacro").velocity == (1.5, 1.5)
    load_arm.cache_clear()
    Path("my_parts/urdf/limits.yaml").write_text("velocity: 0.5", encoding="utf-8")
    assert load_arm("arm.urdf.xacro").velocity == (0.5, 0.5)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('<a b="$(arg name)"/>', 'xacro needs the argument name: xacro = { name = "…" } in'),
        ('<a b="$(find gone)"/>', "there is no package 'gone' from"),
        ('<a b="${length + 1}"/>', "xacro cannot expand it: name 'length' is not defined"),
        ('<a b="${1 / 0}"/>', "xacro cannot expand it: division by zero"),
        ('<xacro:include filename="gone.xacro"/>', "No such file or directory"),
        ('<xacro:include filename="bad.xacro"/>', "xacro cannot expand it: maximum recursion"),
        ("<xacro:segment/>", "xacro cannot expand it: unknown macro name"),
        ("<a>", "xacro cannot expand it: mismatched tag"),
    ],
)
def test_what_is_wrong_in_it_is_one_line(here, xacro, text, said, capfd):
    Path("bad.xacro").write_text(f'<robot name="r" {SPACE}>{text}</robot>', encoding="utf-8")
    with pytest.raises(ConfigurationError, match=re.escape(said)) as raised:
        load_arm("bad.xacro")
    assert str(raised.value).startswith(f"{here / 'bad.xacro'}: ")
    assert "\n" not in str(raised.value)
    assert capfd.readouterr() == ("", "")


def test_the_included_file_is_named_where_it_is_at_fault(here, xacro):
    Path("my_parts/urdf/parts.xacro").write_text("<robot><", encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"parts\.xacro: xacro cannot expand it"):
        load_arm("arm.urdf.xacro")


def test_arguments_that_it_does_not_have_are_refused(here, xacro):
    Path("arm.toml").write_text(
        'urdf = "arm.urdf.xacro"\nxacro = { prefx = "left_" }', encoding="utf-8"
    )
    with pytest.raises(
        ConfigurationError,
        match=r"arm\.toml:2:11: xacro\.prefx: arm\.urdf\.xacro has no such argument; "
        "allowed: prefix",
    ):
        load_arm("arm.toml")


def test_a_urdf_takes_no_arguments(here):
    Path("arm.urdf").write_text("<robot/>", encoding="utf-8")
    Path("arm.toml").write_text('urdf = "arm.urdf"\nxacro = { a = "1" }', encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"xacro: arm\.urdf takes no arguments"):
        load_arm("arm.toml")


def test_without_xacro_one_line_says_what_to_do(here, monkeypatch):
    monkeypatch.setitem(sys.modules, "xacro", None)
    with pytest.raises(ExtraMissingError) as raised:
        load_arm("arm.urdf.xacro")
    assert str(raised.value).startswith(
        "arm.urdf.xacro, unless you expand it by `xacro FILE > arm.urdf`, needs xacro"
    )
    assert str(raised.value).endswith('pip install "cardan[xacro]"')


def test_its_toml_is_written_with_the_arguments(here, xacro):
    path = toml_beside("arm.urdf.xacro")
    assert path == Path("arm.toml")
    added = add("arm.urdf.xacro", path, xacro={"prefix": "b_"})
    assert 'xacro = {prefix = "b_"}' in added.text
    assert added.write().joint_names == ("b_j1", "b_j2")
    with pytest.raises(ConfigurationError, match=r"--xacro: xacro\.side: .* no such argument"):
        add("arm.urdf.xacro", path, xacro={"side": "b_"})
