"""The protocols that ``cardan dissect`` reads, declared without loading their layers."""

from __future__ import annotations

from cardan.dissect import bluetooth, can, network, usbmon
from cardan.dissect.ports import (
    EGM_PORTS,
    RTDE_PORTS,
    SIMPLE_MESSAGE_PORTS,
    SIMPLE_MESSAGE_RT_CONTROL_PORT,
)
from cardan.dissect.reader import Dissector, Numbers

PORTS = range(1, 0x10000)


class Egm(Dissector):
    """ABB's Externally Guided Motion, on UDP ports."""

    name = "EGM"
    page = "protocols/egm.md"
    link_types = network.LINK_TYPES
    always = True
    options = (
        Numbers(
            "egm_ports",
            "port",
            "PORT",
            "Another UDP port of EGM",
            "UDP port",
            PORTS,
            frozenset(EGM_PORTS),
        ),
    )
    reader = "cardan.dissect.egm_reader:EgmReader"


class Connexion(Dissector):
    """3Dconnexion's reports on USB, from usbmon."""

    name = "3Dconnexion"
    page = "protocols/3dconnexion-hid.md"
    link_types = usbmon.LINK_TYPES
    always = True
    reader = "cardan.dissect.connexion_reader:ConnexionReader"


class JointStream(Dissector):
    """The simulated arm's joint stream, on its UDP port or any other by its mark."""

    name = "joint stream"
    page = "protocols/joint-stream.md"
    link_types = network.LINK_TYPES
    always = True
    reader = "cardan.dissect.joint_stream_reader:JointStreamReader"


class SimpleMessage(Dissector):
    """ROS-Industrial's simple message (MotoROS), on TCP ports; the NTNU fork's on UDP."""

    name = "simple message"
    page = "protocols/simple-message.md"
    link_types = network.LINK_TYPES
    always = True
    options = (
        Numbers(
            "simple_message_ports",
            "simple-message-port",
            "PORT",
            "Another TCP port of MotoROS",
            "TCP port",
            PORTS,
            frozenset((*SIMPLE_MESSAGE_PORTS, SIMPLE_MESSAGE_RT_CONTROL_PORT)),
        ),
    )
    reader = "cardan.dissect.simple_message_reader:SimpleMessageReader"


class Rtde(Dissector):
    """Universal Robots' RTDE, on TCP ports."""

    name = "RTDE"
    page = "protocols/ur.md"
    link_types = network.LINK_TYPES
    always = True
    options = (
        Numbers(
            "rtde_ports",
            "rtde-port",
            "PORT",
            "Another TCP port of RTDE",
            "TCP port",
            PORTS,
            frozenset(RTDE_PORTS),
        ),
    )
    reader = "cardan.dissect.rtde_reader:RtdeReader"


class Wiimote(Dissector):
    """Nintendo's Wii Remotes on classic Bluetooth, from a capture of the adapter."""

    name = "Wiimote"
    page = "protocols/wiimote.md"
    link_types = bluetooth.LINK_TYPES
    reader = "cardan.dissect.wiimote_reader:WiimoteReader"


class Jr3Can(Dissector):
    """JR3 force-torque sensors' boards on CAN."""

    name = "JR3"
    page = "protocols/jr3-can.md"
    link_types = can.LINK_TYPES
    options = (
        Numbers(
            "jr3_nodes",
            "jr3-node",
            "ID",
            "Take this CAN node for a JR3",
            "node id",
            range(1, 128),
        ),
    )
    reader = "cardan.dissect.jr3_can_reader:Jr3CanReader"
