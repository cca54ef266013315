"""Sources for colcon of the message packages that no distribution of ROS 2 has."""

from __future__ import annotations

from cardan import __version__
from cardan.protocols.ros2.interfaces import FILES, message_type

PACKAGES = ("cardan_msgs", "rl_cartesian_control_msgs")
"""Packages that an arm's server needs. Of other such packages only a part is known here."""

_PARTS = {
    "msg": ("",),
    "srv": ("_Request", "_Response"),
    "action": ("_Goal", "_Result", "_Feedback"),
}

_MANIFEST = """\
<?xml version="1.0"?>
<package format="3">
  <name>{package}</name>
  <version>{version}</version>
  <description>Messages, services and actions that Cardan speaks.</description>
  <maintainer email="cardan@localhost">Cardan</maintainer>
  <license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <build_depend>rosidl_default_generators</build_depend>
{depends}  <exec_depend>rosidl_default_runtime</exec_depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
  <export>
    <build_type>ament_cmake</build_type>
  </export>
</package>
"""

_BUILD = """\
cmake_minimum_required(VERSION 3.8)
project({package})
find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
{finds}rosidl_generate_interfaces(${{PROJECT_NAME}}
{files}{dependencies})
ament_export_dependencies(rosidl_default_runtime)
ament_package()
"""


def package_files(package: str) -> dict[str, str]:
    """Return the files of a package by their paths in it."""
    texts, others = {}, set()
    for name, text in FILES.items():
        owner, kind, last = name.split("/")
        if owner != package:
            continue
        texts[f"{kind}/{last}.{kind}"] = text
        for part in _PARTS[kind]:
            fields = message_type(name + part).fields
            others |= {each.base.split("/")[0] for each in fields if each.nested}
        if kind == "action":
            others.add("action_msgs")
    needed = sorted(others - {package})
    listed = f"  DEPENDENCIES {' '.join(needed)}\n" if needed else ""
    return texts | {
        "package.xml": _MANIFEST.format(
            package=package,
            version=__version__,
            depends="".join(f"  <depend>{each}</depend>\n" for each in needed),
        ),
        "CMakeLists.txt": _BUILD.format(
            package=package,
            finds="".join(f"find_package({each} REQUIRED)\n" for each in needed),
            files="".join(f'  "{each}"\n' for each in texts),
            dependencies=listed,
        ),
    }
