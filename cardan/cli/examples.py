"""Examples of use at the end of the help of each command of a group in `SECTIONS`.

Simulated peers and servers declare theirs beside their options."""

from __future__ import annotations

from typing import Final

EXAMPLES: Final = {
    "cardan demo": "cardan demo gofa",
    "cardan check": "cardan check my-robot.toml",
    "cardan run": "cardan run my-robot.toml --console --record session.mcap",
    "cardan doctor": "cardan doctor my-robot.toml",
    "cardan explain": "cardan explain S002",
    "cardan conform": "cardan conform egm --target 127.0.0.1:6510",
    "cardan dissect": "cardan dissect capture.pcap --summary",
    "cardan evaluate": "cardan evaluate --quick -o report",
    "daemon run": "cardan daemon run lab.toml",
    "daemon ps": "cardan daemon ps",
    "daemon top": "cardan daemon top --period 1",
    "daemon start": "cardan daemon start ur5",
    "daemon stop": "cardan daemon stop ur5",
    "daemon restart": "cardan daemon restart ur5",
    "daemon switch": "cardan daemon switch mouse ur5",
    "daemon reload": "cardan daemon reload --check",
    "daemon log": "cardan daemon log ur5 -f",
    "daemon events": "cardan daemon events ur5 -f",
    "daemon arm": "cardan daemon arm ur5 movl 0.4 0 0.4 3.14 0 0 --wait",
    "service show": "cardan daemon service show lab.toml",
    "service install": "sudo cardan daemon service install --system --user lab /etc/cardan",
    "service remove": "cardan daemon service remove",
    "devices list": "cardan devices list",
    "devices drivers": "cardan devices drivers spacemouse",
    "devices udev": "cardan devices udev | sudo tee /etc/udev/rules.d/70-cardan.rules",
    "devices share": "cardan devices share spacemouse --router tcp/192.168.1.2:7447",
    "devices force": "cardan devices force my-robot.toml --connect force.sock",
    "devices spnav": "cardan devices spnav my-robot.toml --socket spnav.sock",
    "devices haptic": "cardan devices haptic haptic.toml",
    "net list": "cardan net list --router tcp/192.168.1.2:7447",
    "net echo": "cardan net echo /joint_states --count 1",
    "net hz": "cardan net hz /joint_states",
    "net messages": "cardan net messages ~/ros2_ws/src",
    "net pair": "cardan net pair 192.168.1.2",
    "net record": "cardan net record -o session.mcap",
    "net replay": "cardan net replay session.mcap --rate 0.5",
    "net plot": "cardan net plot session.mcap -o session.png",
    "net export": "cardan net export session.mcap --lerobot dataset",
    "robots add": "cardan robots add my-robot.urdf --tcp tool0",
    "robots list": "cardan robots list",
    "robots show": "cardan robots show ur5",
}
"""Examples by the names of the group and of the command."""
