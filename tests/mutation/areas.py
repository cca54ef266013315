"""Mutated areas, their tests, and equivalent mutants."""

from __future__ import annotations

import json
from pathlib import Path

SERVERS = "cardan/gateway/servers"

AREAS: dict[str, tuple[str, ...]] = {
    "arming": (
        "cardan/gateway/operator/deadman.py",
        "cardan/gateway/operator/input.py",
        "cardan/gateway/operator/mapping.py",
    ),
    "states": ("cardan/gateway/arm/states.py", "cardan/gateway/operator/deadman.py"),
    "limits": (
        "cardan/common/braking.py",
        "cardan/spatial.py::towards",
        "cardan/drivers/limiters.py",
        "cardan/drivers/motoros/trajectory_limiter.py",
        "cardan/drivers/motoros/agreed_limits.py",
        "cardan/gateway/arm/output_check.py",
        "cardan/gateway/motion/speed_limited_reference.py",
        "cardan/gateway/force/watchdog.py",
    ),
    "access": tuple(
        f"{SERVERS}/{name}.py" for name in ("tokens", "access", "rate_limit", "allow_list")
    ),
    "arm": ("cardan/gateway/arm",),
    "operator": ("cardan/gateway/operator",),
    "motion": ("cardan/gateway/motion",),
    "servo": ("cardan/gateway/servo", "cardan/gateway/kinematics"),
    "drivers": ("cardan/drivers",),
    "protocols": ("cardan/protocols",),
}
"""Files, folders and functions of each area; a file may be part of a larger area, too."""

NO_SURVIVORS = ("arming", "states", "limits", "access")
"""Areas in which a surviving mutant is an error."""

_GATEWAY = ("tests/gateway/arm", "tests/gateway/operator", "tests/gateway/motion")
TESTS: dict[str, tuple[str, ...]] = {
    "cardan/gateway/servers": ("tests/gateway/servers",),
    "cardan/gateway/arm": (*_GATEWAY, "tests/test_values.py"),
    "cardan/gateway/operator": _GATEWAY,
    "cardan/gateway/motion": (*_GATEWAY, "tests/gateway/servo"),
    "cardan/gateway/servo": (*_GATEWAY, "tests/gateway/servo"),
    "cardan/gateway/kinematics": ("tests/gateway/kinematics", "tests/gateway/servo"),
    "cardan/gateway/force": ("tests/gateway/force",),
    "cardan/spatial.py": ("tests/test_spatial.py", "tests/drivers/test_limiters.py"),
    "cardan/common/braking.py": ("tests/drivers/test_limiters.py", "tests/gateway/motion"),
    "cardan/drivers/limiters.py": ("tests/drivers/test_limiters.py",),
    "cardan/drivers/motoros/trajectory_limiter.py": (
        "tests/drivers/test_motoros_trajectory_limiter.py",
    ),
    "cardan/drivers/motoros/agreed_limits.py": ("tests/drivers/test_motoros_agreed_limits.py",),
    "cardan/drivers/foreign.py": ("tests/gateway/arm/test_loop.py",),
    "cardan/drivers": (
        "tests/drivers",
        "tests/test_device_faults.py",
        "tests/test_motoros_faults.py",
    ),
    "cardan/protocols": ("tests/protocols", "tests/drivers", "tests/sim_peers"),
}
"""Tests of files by prefix; the first match counts. Each mutant runs those that execute its
statement."""

MATRIX = (
    *(
        f"tests/drivers/test_{name}.py"
        for name in (
            *("egm_driver", "egm_limits", "evdev_devices", "evdev_faults", "motoros_driver"),
            *("sim_arm", "spacemouse_transport", "spacemouse_usb", "ur_driver", "ur_session"),
        )
    ),
    *(
        f"tests/gateway/{name}.py"
        for name in (
            *("arm/test_arrival_motoros", "arm/test_hostile", "arm/test_jogging"),
            *("kinematics/test_arm", "operator/test_absolute", "operator/test_differential"),
            *("operator/test_position", "servo/test_bounds", "servo/test_kernel"),
            "servo/test_servo",
        )
    ),
    "tests/test_device_faults.py",
)
"""Files of `TESTS` whose matrix tests are quick, and are used for mutants, too."""

_EQUIVALENT = Path(__file__).with_name("equivalent.json")


def equivalents() -> dict[str, str]:
    """Return mutants that are equivalent to the original, by name, each with the reason."""
    return json.loads(_EQUIVALENT.read_text(encoding="utf-8"))
