"""Commands on the pages, and the tests that run them.

A command is a line of a code block without a language or in a shell's. test_docs_commands itself
runs those that end at once, and simulated peers. RUN names the tests of the others. BY_HAND has
those that no test can run unchanged, each with its substitute.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
PAGES = sorted(
    [
        *ROOT.glob("*.md"),
        *ROOT.glob("docs/**/*.md"),
        *ROOT.glob("examples/**/README.md"),
        *ROOT.glob("plugins/**/README.md"),
    ]
)
PROGRAMS = re.compile(
    r"(?:sudo |[A-Z_]+=\S+ )*(?:cardan|make|pip|python|python3|cp|adb|ros2|export|modprobe|"
    r"\.\w+/bin/python|tools/[\w-]+|udevadm|ip|tee) "
    r"|make$|cardan (?:daemon (?:ps|top)|devices|doctor|devices udev)$"
)
PRINTED = re.compile(r"cardan(?: \w+)?: |cardan +\d")
"""Version and error lines in Cardan's own output, which are not commands."""
BLOCK = re.compile(r"^ *```(\w*)\n(.*?)^ *```$", re.MULTILINE | re.DOTALL)


class Command(NamedTuple):
    line: str
    page: str


def commands() -> list[Command]:
    """Return the commands of all pages, each once."""
    found: dict[str, str] = {}
    for page in PAGES:
        for language, block in BLOCK.findall(page.read_text(encoding="utf-8")):
            if language not in ("", "sh"):
                continue
            for each in block.replace("\\\n", " ").splitlines():
                line = re.sub(r" +# .*$| &$", "", each.strip()).strip()
                line = " ".join(re.sub(r" & *#.*$", "", line).split()) if "'" not in line else line
                if PROGRAMS.match(line) and not PRINTED.match(line):
                    found.setdefault(line, str(page.relative_to(ROOT)))
    return [Command(line, page) for line, page in sorted(found.items())]


AT_ONCE = re.compile(
    r"cardan (?:devices(?: drivers\b.*| udev)?|check \S+|sim \S+ --(?:library|list-\w+))$"
)
"""Commands run unchanged, with the names of files that exist."""

PEER = re.compile(
    r"cardan sim (?!omni\b)(?!.*--(?:uhid|uinput|usbip|keyboard|list-|serve-socketcand))"
)
"""Commands run until they serve."""

DAEMON = "tests/gateway/daemon"
RECORDS = "tests/recording/test_commands.py"
RUN = {
    r"cardan devices share": "tests/gateway/session/test_remote_device.py",
    r"cardan run examples/ros2/": "tests/test_ros2_examples.py::test_the_programs_move_the_arm",
    r"cardan run examples/[\w-]+-simulated\.toml": "tests/test_device_examples.py::test_the_example_runs",
    r"cardan run \S+ --record \S+": f"{RECORDS}::test_a_session_is_recorded_while_it_runs_from_its_first_cycle_on",
    r"cardan run \S+ --console": "tests/test_console_page.py",
    r"cardan run": "tests/test_tutorials.py::test_the_tutorial_works",
    r"cardan demo ros2-(joy|spacenav)": "tests/test_device_examples.py::test_the_example_runs",
    r"cardan demo (phone-ur5)": "tests/test_device_examples.py::test_the_example_runs",
    r"cardan demo omni-sphere": "plugins/cardan-omni/tests/test_omni_demo.py::test_the_haptic_example_runs_and_is_felt",
    r"cardan demo omni-remote": "plugins/cardan-omni/tests/test_omni_demo.py::test_a_wall_far_away_is_felt_as_stiff_as_it_is",
    r"cardan demo omni ": "plugins/cardan-omni/tests/test_omni_demo.py::test_the_drawing_runs_and_is_felt",
    r"cardan demo console": "tests/demos/test_console.py::test_the_page_waits_for_a_person_and_says_where",
    r"cardan demo lever-ur5": "tests/test_template_packages.py::test_its_demos_run",
    r"cardan (devices drivers|sim) lever": "tests/test_template_packages.py::test_it_is_in_every_list",
    r"cardan doctor": "tests/test_doctor_command.py::test_what_fails_stands_with_why_and_the_command_that_mends_it",
    r"cardan net messages": "tests/protocols/test_ros2_packages.py::test_the_command_writes_them_and_says_where",
    r"cardan net pair": "tests/bus/test_pairing.py::test_the_router_takes_the_paired_operator_and_nobody_else",
    r"cardan net list": "tests/test_server_command.py::test_the_network_is_joined_as_a_session_joins_it",
    r"cardan net server router": "tests/test_server_command.py::test_a_router_serves_until_a_signal",
    r"cardan net server dds": "plugins/cardan-dds/tests/test_dds_server.py",
    r"cardan net server foxglove": "plugins/cardan-foxglove/tests/test_foxglove_server.py::test_the_server_tells_what_it_does_and_what_its_options_mean",
    r"cardan net server rosbridge": "tests/test_server_command.py::test_every_server_tells_what_it_does_and_what_its_options_mean",
    r"cardan daemon run examples/two-arms": f"{DAEMON}/test_two_arms.py",
    r"cardan daemon (run|ps|top|stop|arm)": f"{DAEMON}/test_serve.py",
    r"cardan daemon service (install|show)": f"{DAEMON}/test_service.py",
    r"sudo cardan daemon service install": f"{DAEMON}/test_service.py",
    r"cardan robots (add|show)": "tests/test_robots_command.py",
    r"cardan net record --repair": f"{RECORDS}::test_a_record_that_was_cut_off_is_repaired",
    r"cardan net record": f"{RECORDS}::test_a_record_is_ended_by_ctrl_c",
    r"cardan net replay --verify": f"{RECORDS}::test_a_record_is_verified_in_another_process",
    r"cardan net replay": "tests/recording/test_replay.py::test_topics_can_be_chosen",
    r"cardan net export": "plugins/cardan-learning/tests/test_learning_export.py::test_as_a_program",
    r"cardan net plot": "tests/recording/test_plot.py::test_a_picture",
    r"cardan dissect": "plugins/cardan-dissect/tests",
    r"cardan conform --(list|compare)": "tests/test_conform_command.py",
    r"cardan conform \w+ --target": "tests/conform/test_live.py",
    r"cardan conform \w+": "tests/test_conform_command.py",
    r"cardan evaluate --compare": "studies/tests/test_command.py::test_two_reports_are_compared",
    r"cardan evaluate": "studies/tests/test_command.py::test_a_study_becomes_a_report_with_pictures",
    r"cardan devices force": "tests/gateway/force/test_service.py",
    r"cardan net server spnav": "plugins/cardan-spnav-server/tests/test_spnav_bus_server.py",
    r"cardan devices spnav": "plugins/cardan-spnav-server/tests/test_spnav_server.py",
    r"cardan sim \S+ .*--keyboard": "tests/sim_peers",
    r"cardan sim jr3 --serve-socketcand": "plugins/cardan-jr3/tests",
    r"cardan sim omni .*cardan devices haptic": "plugins/cardan-omni/tests/test_omni_alone.py",
    r"cardan sim omni .*cardan run": "plugins/cardan-omni/tests/test_omni_demo.py::test_the_haptic_example_runs_and_is_felt",
    r"cardan sim network": "tests/sim_peers/test_network.py",
    r"cardan sim omni": "plugins/cardan-omni/tests/test_omni_wrapper.py",
    r"(sudo )?cardan sim \S+ --(uhid|uinput|usbip)": "tests/kernel",
    r"python examples/ros2/check_record\.py": "tests/test_ros2_examples.py::test_a_record_is_a_regression_test",
    r"python examples/ros2/": "tests/test_ros2_examples.py::test_the_programs_move_the_arm",
    r"python examples/lerobot/": "tests/lerobot/test_example.py::test_the_example_records_and_loads",
    r"python plugins/cardan-filters/\S+/say\.py": "plugins/cardan-filters/tests/test_filters_session.py::test_the_example_of_a_sensor_says_its_words",
    r"python \w+\.py$": "tests/test_tutorials.py::test_the_tutorial_works",
    r"\S+/python -m fuzz": "tests/test_fuzz.py",
    r"tools/mutants": "tests/test_mutants.py",
    r"ros2 (topic|service|param|action) .*(cartesian_control|servo|joint_states|diagnostics|cmd_vel|target_frame|state_command|delta)": "tests/test_ros2_examples.py::test_the_lines_of_ros2_do_what_the_page_says",
    r"ros2 topic (echo|pub).* /(spacenav|joy)": "tests/test_ros2_examples.py::test_a_device_of_ours_is_one_of_ros",
    r"ros2 (topic|service|param) .*/omni": "tests/gateway/bus/test_haptic_server.py",
    r"tools/kernel-vm": "tests/kernel",
    r"sudo tools/debian-packages": "tests/kernel",
}
"""Test or folder of tests that runs a command, by a pattern of the command."""

BY_HAND = {
    r"make": "test_docs_commands has make plan it; CI runs demo, test, lint, types, docs and the kernel",
    r"pip install": "test_docs_commands holds the extras to those there are; test_distribution and test_tutorials install",
    r"cp ": "test_docs_commands holds the file to those there are",
    r"cardan --install-completion": "changes the user's shell: tests/test_completion.py",
    r"cardan run plugins/cardan-jr3/\S+/jr3-ur5\.toml": "a CAN bus: plugins/cardan-jr3/tests/kernel, and test_docs checks the file",
    r"cardan devices udev \| sudo tee": "changes the system: `cardan devices udev` itself is run",
    r"sudo (ip|udevadm|modprobe)|modprobe|sudo tools/bare-debian|adb|export": "changes the system, or another one",
    r"ros2 (launch|run|node list)": "needs ROS 2",
}
"""Reason why no test runs a command unchanged, and its substitute, by a pattern of the command."""
