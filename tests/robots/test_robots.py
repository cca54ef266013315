"""The arms' files compared with worked values, by two independent forward kinematics."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin
import pytest

from cardan.common.tables import keys_of
from cardan.robots import Capsule, JointKind, OrientedBox, arm_names, load_arm
from cardan.robots.arm_file import ArmFile, CollisionTable, ShapeTable
from cardan.robots.arm_model import Task

TCP_LINKS = {
    "amor": "tcp",
    "asibot": "tcp",
    "gofa_crb15000_5": "tool0",
    "gp8": "tool0",
    "panda": "panda_link8",
    "pr2_left_arm": "l_gripper_tool_frame",
    "pr2_right_arm": "r_gripper_tool_frame",
    "so101": "gripper_frame_link",
    "teo_left_arm": "tcp",
    "teo_right_arm": "tcp",
    "ur5": "tool0",
    "ur5e": "tool0",
}


class Row(NamedTuple):
    """Joints in deg; TCP position in m, quaternion x y z w, rotation vector in rad; smallest
    singular value of the TCP's Jacobian."""

    arm: str
    q_deg: tuple[float, ...]
    position: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]
    rotation_vector: tuple[float, float, float]
    singular: float


ROWS = [
    Row(
        "teo_right_arm",
        (0, 0, 0, 0, 0, 0),
        (0.000000, -0.346900, -0.233310),
        (0.000000, 1.000000, 0.000000, 0.000000),
        (0.000000, 3.141593, 0.000000),
        0.0000,
    ),
    Row(
        "teo_right_arm",
        (-20, -15, 10, -60, 25, -30),
        (0.491147, -0.362213, 0.192038),
        (-0.336702, 0.541091, -0.143713, 0.757099),
        (-0.733844, 1.179309, -0.313224),
        0.0856,
    ),
    Row(
        "teo_left_arm",
        (0, 0, 0, 0, 0, 0),
        (0.000000, 0.346900, -0.233310),
        (0.000000, 1.000000, 0.000000, 0.000000),
        (0.000000, 3.141593, 0.000000),
        0.0000,
    ),
    Row(
        "teo_left_arm",
        (-20, 15, 10, -60, 25, -30),
        (0.472885, 0.561479, 0.242211),
        (-0.188993, 0.527801, 0.059802, 0.825913),
        (-0.401572, 1.121467, 0.127067),
        0.0830,
    ),
    Row(
        "asibot",
        (0, 0, 0, 0, 0),
        (0.000000, 0.000000, 1.400000),
        (0.000000, 0.000000, 0.000000, 1.000000),
        (0.000000, 0.000000, 0.000000),
        0.0000,
    ),
    Row(
        "asibot",
        (90, 45, 90, -45, 90),
        (0.000000, 0.865685, 0.300000),
        (0.000000, 0.707107, 0.707107, 0.000000),
        (0.000000, 2.221441, 2.221441),
        0.2297,
    ),
    Row(
        "asibot",
        (30, -20, 60, 35, 15),
        (0.355144, 0.205042, 1.059941),
        (-0.079459, 0.603553, 0.303603, 0.732963),
        (-0.174772, 1.327522, 0.667778),
        0.1544,
    ),
    Row(
        "amor",
        (0, 0, 0, 0, 0, 0, 0),
        (0.209200, 0.000000, 0.631860),
        (1.000000, 0.000000, 0.000000, 0.000000),
        (3.141593, 0.000000, 0.000000),
        0.0000,
    ),
    Row(
        "amor",
        (20, -30, 40, 60, -25, 35, 50),
        (0.475842, 0.165434, 0.648001),
        (-0.798119, 0.264593, -0.210987, 0.498479),
        (-1.931450, 0.640317, -0.510591),
        0.1476,
    ),
    Row(
        "gofa_crb15000_5",
        (0, 0, 0, 0, 0, 0),
        (0.571000, 0.000000, 0.899000),
        (0.000000, 0.707107, 0.000000, 0.707107),
        (0.000000, 1.570796, 0.000000),
        0.0491,
    ),
    Row(
        "gofa_crb15000_5",
        (0, 0, 0, 0, 30, 0),
        (0.597469, 0.000000, 0.837782),
        (0.000000, 0.866025, 0.000000, 0.500000),
        (0.000000, 2.094395, 0.000000),
        0.1958,
    ),
    Row(
        "gofa_crb15000_5",
        (20, -30, 25, 40, 50, -60),
        (0.336420, 0.140196, 0.791258),
        (-0.479259, 0.731160, 0.183527, 0.449482),
        (-1.185270, 1.808256, 0.453886),
        0.1681,
    ),
    Row(
        "gp8",
        (0, 0, 0, 0, 0, 0),
        (0.460000, 0.000000, 0.715000),
        (0.707107, 0.000000, 0.707107, 0.000000),
        (2.221442, 0.000000, 2.221441),
        0.0000,
    ),
    Row(
        "gp8",
        (20, -30, 25, 40, 50, -60),
        (0.006062, 0.044127, 0.999284),
        (0.036228, -0.259081, -0.875776, 0.405687),
        (0.091407, -0.653684, -2.209659),
        0.0230,
    ),
    Row(
        "ur5",
        (0, 0, 0, 0, 0, 0),
        (0.817250, 0.191450, -0.005491),
        (0.000000, 0.707107, 0.707107, 0.000000),
        (0.000000, -2.221441, -2.221441),
        0.0000,
    ),
    Row(
        "ur5",
        (0, -90, 90, -90, -90, 0),
        (0.486900, 0.109150, 0.431859),
        (0.707107, -0.707107, 0.000000, 0.000000),
        (2.221441, -2.221441, 0.000000),
        0.2247,
    ),
    Row(
        "ur5",
        (20, -70, 80, -40, 50, -60),
        (0.539939, 0.368973, 0.369968),
        (-0.254121, 0.493874, 0.498914, 0.665279),
        (-0.573821, 1.115198, 1.126578),
        0.1949,
    ),
    Row(
        "ur5e",
        (0, 0, 0, 0, 0, 0),
        (0.817200, 0.232900, 0.062800),
        (0.000000, 0.707107, 0.707107, 0.000000),
        (0.000000, 2.221441, 2.221441),
        0.0000,
    ),
    Row(
        "ur5e",
        (0, -90, 90, -90, -90, 0),
        (0.491900, 0.133300, 0.487900),
        (0.707107, -0.707107, 0.000000, 0.000000),
        (-2.221441, 2.221441, 0.000000),
        0.2224,
    ),
    Row(
        "ur5e",
        (20, -70, 80, -40, 50, -60),
        (0.540988, 0.406889, 0.445571),
        (-0.254121, 0.493874, 0.498914, 0.665279),
        (-0.573821, 1.115198, 1.126578),
        0.1922,
    ),
    Row(
        "pr2_right_arm",
        (0, 0, 0, 0, 0, 0, 0),
        (1.001000, -0.188000, 0.000000),
        (0.000000, 0.000000, 0.000000, 1.000000),
        (0.000000, 0.000000, 0.000000),
        0.0000,
    ),
    Row(
        "pr2_right_arm",
        (-30, 20, -40, -70, 35, -50, 60),
        (0.678243, -0.316284, 0.219390),
        (0.361615, -0.522216, 0.442333, 0.633140),
        (0.827089, -1.194419, 1.011710),
        0.1582,
    ),
    Row(
        "pr2_left_arm",
        (0, 0, 0, 0, 0, 0, 0),
        (1.001000, 0.188000, 0.000000),
        (0.000000, 0.000000, 0.000000, 1.000000),
        (0.000000, 0.000000, 0.000000),
        0.0000,
    ),
    Row(
        "pr2_left_arm",
        (30, 20, 40, -70, -35, -50, -60),
        (0.678243, 0.316284, 0.219390),
        (-0.361615, -0.522216, -0.442333, 0.633140),
        (-0.827089, -1.194419, -1.011710),
        0.1582,
    ),
    Row(
        "panda",
        (0, 0, 0, 0, 0, 0, 0),
        (0.088000, 0.000000, 0.926000),
        (1.000000, 0.000000, 0.000000, 0.000000),
        (3.141593, 0.000000, 0.000000),
        0.0000,
    ),
    Row(
        "panda",
        (0, -45, 0, -135, 0, 90, 45),
        (0.306891, 0.000000, 0.590282),
        (0.923880, -0.382683, 0.000000, 0.000000),
        (2.902453, -1.202235, 0.000000),
        0.2244,
    ),
    Row(
        "panda",
        (20, -30, 25, -70, 50, 60, -40),
        (-0.003281, 0.309587, 0.912059),
        (0.516111, 0.817067, 0.105836, -0.234159),
        (-1.416831, -2.243019, -0.290541),
        0.1099,
    ),
    Row(
        "so101",
        (0, 0, 0, 0, 0),
        (0.391361, -0.000009, 0.226470),
        (0.017206, 0.706894, 0.017214, 0.706900),
        (0.038226, 1.570449, 0.038242),
        0.0605,
    ),
    Row(
        "so101",
        (20, -30, 25, 40, -60),
        (0.285976, -0.082769, 0.150579),
        (0.586525, 0.665413, 0.168445, 0.429931),
        (1.463457, 1.660293, 0.420292),
        0.0752,
    ),
]

# (lower, upper, speed, effort) of each joint; rad, rad/s, N·m; None: without end, not published.
LIMITS = {
    "amor": [
        (-3.141593, 3.141593, 0.523599, None),
        (-2.181662, 0.698132, 0.523599, None),
        (-2.617994, 2.617994, 0.523599, None),
        (0, 2.687807, 0.523599, None),
        (-3.141593, 3.141593, 0.523599, None),
        (-1.570796, 1.570796, 0.523599, None),
        (-3.141593, 3.141593, 0.523599, None),
    ],
    "asibot": [
        (-6.283185, 6.283185, 0.436332, None),
        (-2.356194, 2.356194, 0.436332, None),
        (-2.356194, 2.356194, 0.436332, None),
        (-2.356194, 2.356194, 0.436332, None),
        (-6.283185, 6.283185, 0.436332, None),
    ],
    "gofa_crb15000_5": [
        (-3.141593, 3.141593, 2.181662, None),
        (-3.141593, 3.141593, 2.181662, None),
        (-3.926991, 1.48353, 2.443461, None),
        (-3.141593, 3.141593, 3.490659, None),
        (-3.141593, 3.141593, 3.490659, None),
        (-3.141593, 3.141593, 3.490659, None),
    ],
    "gp8": [
        (-2.967, 2.967, 7.9412, 150.92),
        (-1.1344, 2.5307, 6.7495, 176.4),
        (-1.2217, 3.3161, 9.0757, 107.56),
        (-3.3161, 3.3161, 9.5993, 55.86),
        (-2.3561, 2.3561, 9.5993, 32.68),
        (-6.2944, 6.2944, 17.4845, 22.54),
    ],
    "panda": [
        (-2.8973, 2.8973, 2.175, 87),
        (-1.7628, 1.7628, 2.175, 87),
        (-2.8973, 2.8973, 2.175, 87),
        (-3.0718, -0.0698, 2.175, 87),
        (-2.8973, 2.8973, 2.61, 12),
        (-0.0175, 3.7525, 2.61, 12),
        (-2.8973, 2.8973, 2.61, 12),
    ],
    "pr2_left_arm": [
        (-0.564602, 2.135398, 2.088, 30),
        (-0.3536, 1.2963, 2.082, 30),
        (-0.65, 3.75, 3.27, 30),
        (-2.1213, -0.15, 3.3, 30),
        (None, None, 3.6, 30),
        (-2.0, -0.1, 3.078, 10),
        (None, None, 3.6, 10),
    ],
    "pr2_right_arm": [
        (-2.135398, 0.564602, 2.088, 30),
        (-0.3536, 1.2963, 2.082, 30),
        (-3.75, 0.65, 3.27, 30),
        (-2.1213, -0.15, 3.3, 30),
        (None, None, 3.6, 30),
        (-2.0, -0.1, 3.078, 10),
        (None, None, 3.6, 10),
    ],
    # Speed and torque of the joint's servos.
    "so101": [
        (-1.91986, 1.91986, math.radians(270), 2.94),
        (-1.74533, 1.74533, math.radians(270), 2.94),
        (-1.69, 1.69, math.radians(270), 2.94),
        (-1.65806, 1.65806, math.radians(270), 2.94),
        (-2.74385, 2.84121, math.radians(270), 2.94),
    ],
    "teo_left_arm": [
        (-1.689479, 1.975713, 0.872665, None),
        (-0.417134, 1.335177, 0.872665, None),
        (-0.90059, 1.467822, 0.872665, None),
        (-1.764528, 1.689479, 0.872665, None),
        (-1.768019, 1.333432, 0.872665, None),
        (-1.977458, 1.069887, 0.872665, None),
    ],
    "teo_right_arm": [
        (-1.712168, 1.850049, 0.872665, None),
        (-1.317724, 0.390954, 0.872665, None),
        (-1.398009, 0.994838, 0.872665, None),
        (-1.738348, 1.717404, 0.872665, None),
        (-1.403245, 1.738348, 0.872665, None),
        (-2.008874, 0.780162, 0.872665, None),
    ],
    "ur5": [
        (-6.283185, 6.283185, 3.141593, 150),
        (-6.283185, 6.283185, 3.141593, 150),
        (-3.141593, 3.141593, 3.141593, 150),
        (-6.283185, 6.283185, 3.141593, 28),
        (-6.283185, 6.283185, 3.141593, 28),
        (-6.283185, 6.283185, 3.141593, 28),
    ],
}
LIMITS["ur5e"] = LIMITS["ur5"]

# Each capsule as (body, end, end, radius), m.
CAPSULES = {
    "amor": [
        (0, (-0.018, -0.041, 0.006), (-0.018, 0.041, 0.006), 0.045),
        (1, (0, 0, 0.079), (0.032, 0, 0.147), 0.074),
        (2, (0, 0, 0), (0, 0, 0.243), 0.05),
        (3, (0.049, 0, 0.421), (0.001, 0, 0.344), 0.08),
        (4, (0, 0, 0), (0, 0, 0.154), 0.046),
        (5, (0.029, 0, 0.353), (0.002, 0, 0.222), 0.057),
        (6, (0, 0, 0.015), (0, 0, -0.096), 0.035),
        (7, (0, 0, -0.157), (0.001, 0, -0.261), 0.061),
    ],
    "asibot": [
        (1, (0, 0, 0.05), (0, 0, 0.3), 0.068),
        (2, (0, 0, 0), (0, 0, 0.4), 0.065),
        (3, (0, 0, 0), (0, 0, 0.4), 0.065),
        (4, (0, 0, 0), (0, 0, 0.25), 0.068),
        (5, (0, 0, -0.05), (0, 0, 0), 0.062),
    ],
    "gofa_crb15000_5": [
        (0, (-0.01, 0, 0.045), (0, 0, 0.076), 0.128),
        (1, (0, 0.031, -0.001), (0, -0.016, -0.005), 0.097),
        (2, (0, -0.123, 0.444), (0, -0.123, 0), 0.073),
        (3, (0, 0.009, 0), (0.039, 0.004, 0.064), 0.114),
        (4, (0.16, 0.003, -0.001), (0.44, 0.101, 0.002), 0.084),
        (5, (-0.025, 0, 0.08), (-0.005, -0.006, 0.019), 0.107),
        (6, (-0.033, 0, 0), (-0.033, 0, 0), 0.053),
    ],
    "gp8": [
        (0, (0, 0, 0.052), (-0.008, 0, 0.091), 0.139),
        (1, (0.038, 0, -0.01), (0.001, -0.001, -0.12), 0.099),
        (2, (-0.012, 0, 0.008), (-0.016, 0, 0.326), 0.126),
        (3, (-0.006, -0.002, 0.023), (-0.022, 0, 0.007), 0.103),
        (4, (-0.224, 0, 0), (-0.014, 0, 0), 0.067),
        (5, (0.044, 0, 0), (0, 0.001, 0), 0.048),
        (6, (0.079, 0, 0), (0.079, 0, 0), 0.03),
    ],
    "panda": [
        (1, (0, 0, -0.138), (0, -0.052, 0.001), 0.078),
        (2, (0, -0.142, 0.001), (0, 0.001, 0.054), 0.077),
        (3, (0.002, -0.001, -0.08), (0.084, 0.046, 0.002), 0.071),
        (4, (0.001, -0.001, 0.044), (-0.082, 0.083, -0.002), 0.071),
        (5, (-0.001, 0.002, -0.207), (0, 0.06, -0.06), 0.078),
        (5, (0, 0.033, -0.003), (0, 0.081, -0.003), 0.059),
    ],
    "pr2_left_arm": [
        (1, (0.056, 0, 0.042), (0, 0, -0.323), 0.208),
        (2, (0.001, 0, 0), (0.007, 0, 0.009), 0.149),
        (3, (0.4, 0, 0), (0.045, 0, -0.011), 0.098),
        (4, (0.036, 0, -0.013), (0, 0, 0), 0.082),
        (5, (0.016, 0, 0), (0.119, 0, 0.007), 0.045),
        (5, (0.119, 0, 0.007), (0.311, 0, -0.007), 0.069),
        (6, (0, 0, 0), (0.004, 0, -0.006), 0.042),
        (7, (0.08, 0, 0), (0.079, 0, 0), 0.054),
        (7, (0.077, 0, 0), (0.18, 0, 0), 0.045),
    ],
    "so101": [],
    "teo_left_arm": [
        (1, (-0.003, 0.003, 0.009), (-0.003, -0.055, 0.01), 0.051),
        (2, (-0.011, 0.003, -0.002), (-0.007, 0.016, -0.049), 0.052),
        (3, (0, 0, 0.208), (0, 0, 0), 0.043),
        (4, (0, 0, -0.105), (0, 0, 0), 0.04),
        (5, (-0.004, 0, 0.043), (0, 0, 0), 0.036),
        (6, (0, 0, 0), (0, 0, -0.09), 0.035),
        (6, (-0.002, 0, -0.048), (-0.002, 0, -0.241), 0.075),
    ],
    "teo_right_arm": [
        (1, (-0.003, -0.003, 0.009), (-0.003, 0.055, 0.01), 0.051),
        (2, (-0.011, -0.003, -0.002), (-0.007, -0.016, -0.049), 0.052),
        (3, (0, 0, 0.208), (0, 0, 0), 0.043),
        (4, (0, 0, -0.105), (0, 0, 0), 0.04),
        (5, (-0.004, 0, 0.043), (0, 0, 0), 0.036),
        (6, (0, 0, 0), (0, 0, -0.09), 0.035),
        (6, (-0.002, 0, -0.048), (-0.002, 0, -0.241), 0.075),
    ],
    "ur5": [
        (0, (0, 0, 0.009), (0, 0.036, 0.009), 0.074),
        (1, (0, -0.001, -0.009), (0, -0.013, 0), 0.082),
        (2, (-0.425, 0, 0.131), (0.001, 0, 0.131), 0.084),
        (3, (0, 0, 0.045), (-0.388, 0, 0.016), 0.064),
        (4, (0, 0.008, -0.003), (0, -0.006, -0.002), 0.057),
        (5, (0, -0.008, -0.004), (0, 0.006, -0.002), 0.057),
        (6, (0, 0, -0.021), (0, -0.003, -0.02), 0.04),
    ],
    "ur5e": [
        (0, (0, 0, 0.02), (0, 0.036, 0.02), 0.08),
        (1, (0, -0.001, -0.012), (0, -0.016, 0), 0.085),
        (2, (-0.425, 0, 0.135), (0.001, 0, 0.135), 0.088),
        (3, (0, 0, 0.04), (-0.388, 0, 0.01), 0.068),
        (4, (0, 0.008, -0.003), (0, -0.012, -0.002), 0.06),
        (5, (0, -0.008, -0.004), (0, 0.012, -0.002), 0.06),
        (6, (0, 0, -0.024), (0, -0.004, -0.02), 0.045),
    ],
}
CAPSULES["pr2_right_arm"] = CAPSULES["pr2_left_arm"]

# Each box as (body, center, size), m, along the body's axes. The Panda's flange has one turned by
# 45 degrees, and the SO-101's jaw a rotated one.
BOXES = {
    "panda": [
        (0, (-0.0415, 0, 0.038), (0.227, 0.19, 0.078)),
        (0, (-0.0235, 0, 0.1085), (0.173, 0.15, 0.065)),
        (6, (0.042, 0.015, 0.0065), (0.182, 0.134, 0.101)),
        (7, (0.012021, 0.012021, 0.079), (0.142, 0.088, 0.056)),
    ],
    "so101": [
        (0, (0.0165, 0, 0.019), (0.097, 0.112, 0.044)),
        (0, (0.0125, -0.0005, 0.055), (0.089, 0.079, 0.03)),
        (1, (-0.0285, 0.001, -0.009), (0.045, 0.056, 0.112)),
        (1, (0.003, 0.0005, 0.0025), (0.02, 0.039, 0.089)),
        (2, (-0.085, -0.031, 0.019), (0.086, 0.016, 0.052)),
        (2, (-0.059, -0.0055, 0.02), (0.144, 0.037, 0.068)),
        (3, (-0.0665, 0.003, 0.02), (0.159, 0.038, 0.066)),
        (4, (-0.0025, -0.027, 0.022), (0.037, 0.08, 0.064)),
        (5, (-0.007, 0, -0.0835), (0.044, 0.03, 0.043)),
        (5, (-0.0025, -0.002, -0.0305), (0.067, 0.054, 0.065)),
        (5, (0.0192, 0.0003, -0.0594), (0.024, 0.094, 0.049)),
    ],
}


def matrix(rotation, position):
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = rotation, position
    return result


def of_pose(pose):
    w, x, y, z = pose.orientation
    rotation = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return matrix(rotation, pose.position)


def turn(axis, angle):
    """Rotation matrix by Rodrigues' formula."""
    x, y, z = axis
    k = np.array(((0, -z, y), (z, 0, -x), (-y, x, 0)))
    return np.eye(3) + math.sin(angle) * k + (1 - math.cos(angle)) * k @ k


def bodies(arm, q):
    """Return placements of the base and of every body, and each joint's axis with a point on it."""
    placements, axes = [np.eye(4)], []
    for joint, value in zip(arm.joints, q, strict=True):
        assert joint.kind is not JointKind.PRISMATIC
        frame = placements[-1] @ of_pose(joint.placement)
        axes.append((frame[:3, :3] @ joint.axis, frame[:3, 3]))
        placements.append(frame @ matrix(turn(joint.axis, value), (0, 0, 0)))
    return placements, axes


def plain(arm, q):
    """Return TCP and Jacobian (TCP axes), computed with matrices only."""
    placements, axes = bodies(arm, q)
    tcp = placements[-1] @ of_pose(arm.tcp)
    back = tcp[:3, :3].T
    columns = [
        np.concatenate((back @ np.cross(axis, tcp[:3, 3] - point), back @ axis))
        for axis, point in axes
    ]
    return tcp, np.column_stack(columns)


def pinocchio(arm, q):
    """Return the same from Pinocchio's own URDF reader; only link names are shared."""
    model = pin.buildModelFromXML(arm.urdf)
    assert [name for name in model.names if name != "universe"] == list(arm.joint_names)
    values = []
    for joint, value in zip(model.joints[1:], q, strict=True):
        values += [value] if joint.nq == 1 else [math.cos(value), math.sin(value)]
    data, frame = model.createData(), model.getFrameId(TCP_LINKS[arm.name])
    assert frame < model.nframes
    jacobian = pin.computeFrameJacobian(model, data, np.array(values), frame, pin.LOCAL)
    pin.framesForwardKinematics(model, data, np.array(values))
    return data.oMf[frame].homogeneous, jacobian


def test_every_arm_is_here():
    assert set(arm_names()) == set(LIMITS) == set(CAPSULES) == set(TCP_LINKS)
    assert {row.arm for row in ROWS} == set(LIMITS)


@pytest.mark.parametrize("forward", [plain, pinocchio])
@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row.arm}{row.q_deg}")
def test_worked_poses(row, forward):
    tcp, jacobian = forward(load_arm(row.arm), np.radians(row.q_deg))
    np.testing.assert_allclose(tcp[:3, 3], row.position, atol=1e-6)
    # Quaternion and rotation vector have six decimals, which doubles the error of the rotation.
    x, y, z, w = row.quaternion
    given = pin.Quaternion(w, x, y, z).normalized().toRotationMatrix()
    np.testing.assert_allclose(tcp[:3, :3], given, atol=2e-6)
    np.testing.assert_allclose(tcp[:3, :3], pin.exp3(np.array(row.rotation_vector)), atol=2e-6)
    got = pin.Quaternion(tcp[:3, :3]).coeffs()
    assert min(np.abs(got - row.quaternion).max(), np.abs(got + row.quaternion).max()) < 1e-6
    smallest = np.linalg.svd(jacobian, compute_uv=False)[-1]
    assert smallest == pytest.approx(row.singular, abs=1e-4)


@pytest.mark.parametrize("name", arm_names())
def test_both_kinematics_agree_everywhere(name):
    arm, random = load_arm(name), np.random.default_rng(1)
    low, high = np.maximum(arm.lower, -math.pi), np.minimum(arm.upper, math.pi)
    for _ in range(20):
        q = random.uniform(low, high)
        (one, columns), (other, others) = plain(arm, q), pinocchio(arm, q)
        np.testing.assert_allclose(one, other, atol=1e-6)
        np.testing.assert_allclose(columns, others, atol=1e-6)


def dh(links, q):
    """Return classic DH frames for (offset deg, D, A, alpha deg) and joints in rad."""
    frame = np.eye(4)
    for (offset, d, a, alpha), value in zip(links, q, strict=True):
        first = matrix(turn((0, 0, 1), math.radians(offset) + value), (0, 0, 0))
        frame = frame @ first @ matrix(turn((1, 0, 0), math.radians(alpha)), (a, 0, d))
    return frame


TEO_LINKS = [
    (0, 0, 0, -90),
    (-90, 0, 0, -90),
    (-90, -0.32901, 0, -90),
    (0, 0, 0, 90),
    (0, -0.215, 0, -90),
    (-90, 0, -0.09, 0),
]
TEO_HAND = matrix([[0, 0, -1], [-1, 0, 0], [0, 1, 0]], (-0.0975, 0, 0))


def teo_shoulder(y):
    return matrix([[0, 1, 0], [0, 0, 1], [1, 0, 0]], (0, y, 0.4982))


# Constant frames: before the first link, of the links, after the last one.
DH = {
    "teo_right_arm": (teo_shoulder(-0.3469), TEO_LINKS, TEO_HAND),
    "teo_left_arm": (teo_shoulder(0.3469), TEO_LINKS, TEO_HAND),
    "amor": (
        np.eye(4),
        [
            (0, 0.156, 0.062, 90),
            (0, 0, 0, -90),
            (0, 0.41746, 0.097, 90),
            (0, 0, 0, -90),
            (0, 0.356, 0.0502, 90),
            (0, 0, 0, 90),
            (0, 0.0976, 0, 0),
        ],
        matrix(np.eye(3), (0, 0, 0.2)),
    ),
    "gofa_crb15000_5": (
        np.eye(4),
        [
            (0, 0.265, 0, -90),
            (-90, 0, 0.444, 0),
            (0, 0, 0.110, -90),
            (0, 0.470, 0, 90),
            (0, 0, 0.080, -90),
            (180, 0.101, 0, 0),
        ],
        np.eye(4),
    ),
    # Franka's parameters follow Craig's convention.
    "panda": (
        np.eye(4),
        [
            (0, 0.333, 0, -90),
            (0, 0, 0, 90),
            (0, 0.316, 0.0825, 90),
            (0, 0, -0.0825, -90),
            (0, 0.384, 0, 90),
            (0, 0, 0.088, 90),
            (0, 0, 0, 0),
        ],
        matrix(np.eye(3), (0, 0, 0.107)),
    ),
    "ur5": (
        matrix(np.diag((-1.0, -1.0, 1.0)), (0, 0, 0)),
        [
            (0, 0.089159, 0, 90),
            (0, 0, -0.425, 0),
            (0, 0, -0.39225, 0),
            (0, 0.10915, 0, 90),
            (0, 0.09465, 0, -90),
            (0, 0.0823, 0, 0),
        ],
        np.eye(4),
    ),
}


@pytest.mark.parametrize("name", DH)
def test_dh_parameters_give_the_same_arm(name):
    before, links, after = DH[name]
    arm, random = load_arm(name), np.random.default_rng(2)
    for _ in range(20):
        q = random.uniform(arm.lower, arm.upper)
        np.testing.assert_allclose(before @ dh(links, q) @ after, plain(arm, q)[0], atol=1e-6)


def test_closed_form_solutions_of_teo_reach_one_pose():
    solutions = [
        (-20, -15, 10, -60, 25, -30),
        (-20, -15, -170, 60, -155, -30),
        (160, -165, 10, 60, -155, -30),
        (160, -165, -170, -60, 25, -30),
        (-55.96, 9.31, 56.02, 60, -25, -98.47),
        (-55.96, 9.31, -123.98, -60, 155, -98.47),
        (124.04, 170.69, -123.98, 60, -25, -98.47),
        (124.04, 170.69, 56.02, -60, 155, -98.47),
    ]
    arm = load_arm("teo_right_arm")
    first, _ = plain(arm, np.radians(solutions[0]))
    inside = 0
    for solution in solutions:
        q = np.radians(solution)
        # Given to 0.01 deg, which is 0.1 mm at this arm's length.
        atol = 1e-9 if solution[0] in (-20, 160) else 3e-4
        np.testing.assert_allclose(plain(arm, q)[0], first, atol=atol)
        inside += bool(np.all(q >= arm.lower) and np.all(q <= arm.upper))
    assert inside == 2


@pytest.mark.parametrize("name", arm_names())
def test_limits_are_those_of_the_table(name):
    arm = load_arm(name)
    for joint, (lower, upper, velocity, effort) in zip(arm.joints, LIMITS[name], strict=True):
        assert joint.kind is (JointKind.CONTINUOUS if lower is None else JointKind.REVOLUTE)
        assert joint.lower == (-math.inf if lower is None else lower)
        assert joint.upper == (math.inf if upper is None else upper)
        assert joint.velocity == velocity
        assert joint.effort == (math.inf if effort is None else effort)


def test_limits_of_teo_in_deg():
    right = [(-98.1, 106.0), (-75.5, 22.4), (-80.1, 57.0), (-99.6, 98.4), (-80.4, 99.6)]
    right.append((-115.1, 44.7))
    left = [(-96.8, 113.2), (-23.9, 76.5), (-51.6, 84.1), (-101.1, 96.8), (-101.3, 76.4)]
    left.append((-113.3, 61.3))
    for name, table in (("teo_right_arm", right), ("teo_left_arm", left)):
        for joint, (low, high) in zip(load_arm(name).joints, table, strict=True):
            assert math.degrees(joint.lower) == pytest.approx(low, abs=1e-4)
            assert math.degrees(joint.upper) == pytest.approx(high, abs=1e-4)
            assert math.degrees(joint.velocity) == pytest.approx(50.0, abs=1e-4)


@pytest.mark.parametrize("name", arm_names())
def test_bodies_are_those_of_the_tables(name):
    arm, given = load_arm(name), CAPSULES[name]
    fixed = {"torso", "head", "hip"}
    found = [shape for shape in arm.shapes if shape.name not in fixed]
    boxes = [shape for shape in found if isinstance(shape.shape, OrientedBox)]
    assert len(found) == len(given) + len(boxes)
    for box, (body, center, size) in zip(boxes, BOXES.get(name, ()), strict=True):
        assert box.body == body
        assert box.shape.pose.position == pytest.approx(center, abs=1e-6)
        assert box.shape.size_m == pytest.approx(size)
    for body, start, end, radius in given:
        if name in ("ur5", "ur5e") and body == 0:
            # Given in base_link_inertia, which is rotated by pi from the base.
            start, end = ((-x, -y, z) for x, y, z in (start, end))
        same = [
            shape
            for shape in found
            if shape.body == body
            and isinstance(shape.shape, Capsule)
            and shape.shape.radius_m == radius
            and {
                tuple(round(x, 6) + 0.0 for x in point)
                for point in (shape.shape.start, shape.shape.end)
            }
            == {tuple(float(x) for x in point) for point in (start, end)}
        ]
        assert len(same) == 1, (body, start, end, radius)


def test_teo_has_its_trunk_and_head_to_avoid():
    for name in ("teo_right_arm", "teo_left_arm"):
        fixed = {s.name: s.shape for s in load_arm(name).shapes if s.body == 0}
        assert set(fixed) == {"torso", "head", "hip"}
        assert tuple(fixed["torso"].size_m) == pytest.approx((0.17, 0.526, 0.398))
        assert tuple(fixed["hip"].pose.position) == pytest.approx((-0.018, 0.0, 0.0675))
        assert fixed["head"].radius_m == 0.111


def distances(arm, q):
    """Return the distances of all checked pairs of bodies, m: neither ignored nor neighbors."""
    placements, _ = bodies(arm, q)
    solids = []
    for shape in arm.shapes:
        if isinstance(shape.shape, OrientedBox):
            geometry = coal.Box(*shape.shape.size_m)
            local = of_pose(shape.shape.pose)
        else:
            start, end = np.array(shape.shape.start), np.array(shape.shape.end)
            length = float(np.linalg.norm(end - start))
            geometry = coal.Capsule(shape.shape.radius_m, length)
            z = (end - start) / length if length else np.array((0.0, 0.0, 1.0))
            local = matrix(
                pin.Quaternion.FromTwoVectors(np.array((0.0, 0.0, 1.0)), z).toRotationMatrix(),
                0.5 * (start + end),
            )
        world = placements[shape.body] @ local
        solids.append((shape, geometry, coal.Transform3s(world[:3, :3], world[:3, 3])))
    found = {}
    for i, (one, geometry, placement) in enumerate(solids):
        for other, second, there in solids[i + 1 :]:
            pair = tuple(sorted((one.body, other.body)))
            if pair[1] - pair[0] < 2 or pair in arm.ignored_pairs:
                continue
            result = coal.DistanceResult()
            coal.distance(geometry, placement, second, there, coal.DistanceRequest(), result)
            found[one.name, other.name] = result.min_distance
    return found


LEAST_SINGULAR_VALUE_AT_HOME = 0.12
"""Fully stretched poses have 0; the table's poses for work have 0.08 to 0.23."""

LEAST_OF_A_SMALL_ARM = {"so101": 0.07}
"""Lower limits of small arms: the links have 12 and 13 cm, and the highest value anywhere is hardly
above 0.08."""


@pytest.mark.parametrize("name", arm_names())
def test_home_is_a_place_to_start_from(name):
    arm = load_arm(name)
    home = np.array(arm.home)
    margin = np.minimum(home - arm.lower, np.array(arm.upper) - home)
    assert margin.min() > math.radians(15)
    least = LEAST_OF_A_SMALL_ARM.get(name, LEAST_SINGULAR_VALUE_AT_HOME)
    assert np.linalg.svd(plain(arm, home)[1], compute_uv=False)[-1] > least
    touching = {pair: d for pair, d in distances(arm, home).items() if d < 0.01}
    assert touching == {}


@pytest.mark.parametrize("name", arm_names())
def test_only_pairs_that_always_touch_are_ignored(name):
    arm = load_arm(name)
    expected = {
        "gp8": {(0, 2), (2, 4), (4, 6)},
        "ur5": {(0, 2)},
        "ur5e": {(0, 2)},
        "pr2_right_arm": {(1, 3), (3, 5), (5, 7)},
        "pr2_left_arm": {(1, 3), (3, 5), (5, 7)},
    }
    assert arm.ignored_pairs == expected.get(name, set())


def test_the_hand_of_amor_touches_its_forearm_at_zero():
    arm = load_arm("amor")
    touching = {pair for pair, d in distances(arm, np.zeros(7)).items() if d <= 0.0}
    assert touching == {("link_3", "link_7"), ("link_4", "link_7"), ("link_5", "link_7")}


@pytest.mark.parametrize("name", ["teo_right_arm", "teo_left_arm"])
def test_a_teo_arm_can_hit_the_trunk(name):
    """With the elbow bent and the upper arm turned inwards to its end stop."""
    inwards = 50 if name == "teo_right_arm" else -50
    found = distances(load_arm(name), np.radians((0, 0, inwards, -90, 0, 0)))
    assert min(d for (one, other), d in found.items() if "torso" in (one, other)) < 0.0


def test_published_masses():
    for name in ("teo_right_arm", "teo_left_arm"):
        inertias = load_arm(name).inertias
        assert [round(i.mass_kg, 6) for i in inertias] == [0.0, 0.0, 1.750625, 0.0, 2.396, 0.75]
        # Plate 0.3 kg at -0.09, hand 0.45 kg at -0.1675 m.
        assert inertias[5].center_m.z == pytest.approx((0.3 * -0.09 + 0.45 * -0.1675) / 0.75)
    ur5 = load_arm("ur5").inertias
    assert [i.mass_kg for i in ur5] == pytest.approx([3.7, 8.393, 2.275, 1.219, 1.219, 0.1879])
    xx, xy, xz, yy, yz, zz = ur5[1].moments  # cylinder along x
    assert (xy, xz, yz) == pytest.approx((0, 0, 0), abs=1e-9)
    assert xx == pytest.approx(8.393 * 0.06**2 / 2, rel=1e-3)
    assert yy == zz == pytest.approx(8.393 * (3 * 0.06**2 + 0.425**2) / 12, rel=1e-3)
    panda = [4.970684, 0.646926, 3.228604, 3.587895, 1.225946, 1.666555, 0.735522]
    assert [i.mass_kg for i in load_arm("panda").inertias] == pytest.approx(panda)
    # The last one includes the jaw's 12 g.
    so101 = [0.100006, 0.103, 0.104, 0.079, 0.099]
    assert [i.mass_kg for i in load_arm("so101").inertias] == pytest.approx(so101)
    pr2 = [25.799, 2.750, 6.118, 1.903, 2.680, 0.614, 0.680]
    assert [i.mass_kg for i in load_arm("pr2_left_arm").inertias] == pytest.approx(pr2)


@pytest.mark.parametrize("name", arm_names())
def test_every_arm_can_be_simulated(name):
    """Its mass matrix has no direction without inertia, and Pinocchio reads the same masses."""
    arm = load_arm(name)
    model = pin.buildModelFromXML(arm.urdf)
    assert [i.mass for i in model.inertias[1:]] == pytest.approx([i.mass_kg for i in arm.inertias])
    for there, here in zip(list(model.inertias)[1:], arm.inertias, strict=True):
        if here.mass_kg == 0.0:
            continue
        xx, xy, xz, yy, yz, zz = here.moments
        np.testing.assert_allclose(there.lever, here.center_m, atol=1e-9)
        given = np.array(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))
        np.testing.assert_allclose(there.inertia, given, atol=1e-9)
        one, two, three = sorted(np.linalg.eigvalsh(given))
        assert one > 0.0
        assert one + two > three * (1.0 - 1e-3)
    random = np.random.default_rng(3)
    data = model.createData()
    for _ in range(20):
        q = pin.integrate(model, pin.neutral(model), random.normal(size=model.nv))
        mass = pin.crba(model, data, q)
        mass = np.triu(mass) + np.triu(mass, 1).T
        assert np.linalg.eigvalsh(mass)[0] > 1e-6


@pytest.mark.parametrize("name", ["asibot", "so101"])
def test_an_arm_of_five_joints_never_trades_position_for_orientation(name):
    task = load_arm(name).task
    assert task.weights[:3] == (1.0, 1.0, 1.0)
    assert max(task.weights[3:]) <= 0.05


PAGE = (Path(__file__).parents[2] / "docs" / "robots.md").read_text(encoding="utf-8")


def test_the_page_s_own_arm_works(tmp_path):
    for name, language in (("crane.urdf", "xml"), ("crane.toml", "toml")):
        block, *_ = re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)
        (tmp_path / name).write_text(block, encoding="utf-8")
    arm = load_arm(str(tmp_path / "crane.toml"))
    assert arm.joint_names == ("turn", "lift", "roll")
    assert arm.home == (0.0, 0.3, 0.0)
    assert [shape.name for shape in arm.shapes] == ["column", "boom", "pedestal", "hook"]
    tcp, _ = plain(arm._replace(joints=(arm.joints[0],)), (0.0,))
    assert tcp[2, 3] == pytest.approx(-0.1)


@pytest.mark.parametrize("name", arm_names())
def test_the_page_lists_every_arm_and_its_home(name):
    arm = load_arm(name)
    home = ", ".join(f"{math.degrees(q):.0f}".replace("-0", "0") for q in arm.home)
    (row,) = re.findall(rf"^\| `{name}` \| (.*?) \| .*? \| (.*?) \|", PAGE, re.MULTILINE)
    assert row == (str(len(arm.joints)), home.replace("-", "−"))


def test_the_page_has_every_key_of_the_file():
    named = set(re.findall(r"^\| `(\w+)` \| ", PAGE, re.MULTILINE)) - set(arm_names())
    tables = (ArmFile, Task, CollisionTable, ShapeTable)
    keys = {key for table in tables for key in keys_of(table)}
    assert named == keys - {"task", "collision"}
