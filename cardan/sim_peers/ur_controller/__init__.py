"""A Universal Robots controller (UR5, UR5e): RTDE, client interfaces, dashboard, and programs."""

from cardan.sim_peers.ur_controller.controller import UrController as UrController
from cardan.sim_peers.ur_controller.options import UrControllerOptions as UrControllerOptions
from cardan.sim_peers.ur_controller.servers import UrServers as UrServers
from cardan.sim_peers.ur_controller.tcp import UrControllerPeer as UrControllerPeer
