"""Two computers with a link between them, made of network namespaces on this computer.

Each computer is a network namespace with one veth interface. The other ends of both are in a third
namespace, where a process moves Ethernet frames between them as :class:`bench.link.Way` says. TCP
and UDP are the kernel's, and lost segments are really retransmitted. No root is needed if users may
make user namespaces, and no netem; required are Linux, util-linux (unshare, nsenter) and iproute2
(ip).
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import json
import math
import os
import random
import select
import shutil
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import astuple
from pathlib import Path
from typing import Any, Final

from bench.link import Carried, Conditions, Way

OPERATOR: Final = "operator"
ROBOT: Final = "robot"
ADDRESSES: Final = {OPERATOR: "10.77.0.1", ROBOT: "10.77.0.2"}
OTHER_ADDRESSES: Final = {OPERATOR: "10.77.0.3", ROBOT: "10.77.0.4"}
"""Addresses after :meth:`TwoComputers.change_address`."""
INTERFACE: Final = "net0"
SENDER: Final = {ROBOT: OPERATOR, OPERATOR: ROBOT}
"""Sending computer of each way, by its destination."""

READY_WITHIN_S: Final = 30.0
_MAC: Final = {OPERATOR: "02:00:00:00:00:01", ROBOT: "02:00:00:00:00:02"}
_CONGESTION: Final = Path("/proc/sys/net/ipv4/tcp_congestion_control")
_FRAME: Final = 65536
_MOST_CARRIED: Final = 512
_PRIORITY: Final = 10
_CLONE_NEWNET: Final = 0x40000000
_ETH_P_ALL: Final = 3
_SIOCETHTOOL: Final = 0x8946
# linux/ethtool.h: receive and send checksums, scatter-gather, segmentation (TCP, generic), GRO.
_ETHTOOL_OFFLOADS: Final = (0x15, 0x17, 0x19, 0x1F, 0x24, 0x2C)


_NONE: Final = (
    "no network namespaces can be made here: unshare, nsenter (util-linux) and ip (iproute2) have "
    "to be installed, and user namespaces allowed; try: "
    "unshare --user --map-root-user --net ip link add ve0 type veth peer name ve1"
)


class NoNamespacesError(RuntimeError):
    """This computer does not let this user make network namespaces."""


class TwoComputers:
    """The two computers of :func:`two_computers`."""

    def __init__(self, process: subprocess.Popen[bytes], control: socket.socket) -> None:
        self._process, self._control = process, control
        self._control.settimeout(READY_WITHIN_S)
        try:
            self._namespaces, self.congestion = json.loads(self._control.recv(_FRAME))
            """Congestion control of TCP in the namespaces."""
        except (OSError, ValueError):
            self._process.kill()
            raise NoNamespacesError(_NONE) from None

    def at(self, computer: str) -> tuple[str, ...]:
        """Return the command prefix that runs a command at OPERATOR or ROBOT."""
        process = f"/proc/{self._process.pid}"
        return (
            "nsenter",
            "--preserve-credentials",
            f"--user={process}/ns/user",
            f"--net={process}/fd/{self._namespaces[computer]}",
            "--",
        )

    def _ask(self, question: dict[str, Any]) -> tuple[Any, list[int]]:
        self._control.send(json.dumps(question).encode())
        answer, fds, _, _ = socket.recv_fds(self._control, _FRAME, 1)
        return json.loads(answer), fds

    def datagrams(self, computer: str) -> socket.socket:
        """Return a UDP socket of that computer for this process."""
        _, (fd,) = self._ask({"socket": computer})
        return socket.socket(fileno=fd)

    def set(self, **ways: Conditions) -> None:
        """Change the conditions of the ways to `robot` and to `operator`."""
        self._ask({"ways": {to: way._asdict() for to, way in ways.items()}})

    def counts(self) -> dict[str, dict[str, int]]:
        """Return :attr:`bench.link.Way.counts` by the way's destination; under "forwarder" the
        longest delay of a frame beyond its due time, "late_us"."""
        found: dict[str, dict[str, int]] = self._ask({})[0]["counts"]
        return found

    def carried(self, to: str, since_s: float, until_s: float) -> list[Carried]:
        """Return the first frames to that computer that were sent in the interval, at most
        _MOST_CARRIED. The times are :func:`time.monotonic`'s, which all processes share."""
        found = self._ask({"carried": [to, since_s, until_s]})[0]["carried"]
        return [Carried(*each) for each in found]

    def change_address(self, computer: str = OPERATOR, *, back: bool = False) -> None:
        """Replace the address of OPERATOR or ROBOT by its second one; `back`: restore the first
        one."""
        addresses = [each[computer] for each in (ADDRESSES, OTHER_ADDRESSES)]
        gone, new = reversed(addresses) if back else addresses
        for change in (("del", f"{gone}/24"), ("add", f"{new}/24")):
            subprocess.run(
                [*self.at(computer), "ip", "address", *change, "dev", INTERFACE], check=True
            )


@contextlib.contextmanager
def two_computers(
    to_robot: Conditions, to_operator: Conditions, seed: int = 0
) -> Iterator[TwoComputers]:
    """Run both computers until the end of the context. Raises NoNamespacesError."""
    if not all(map(shutil.which, ("unshare", "nsenter", "ip"))):
        raise NoNamespacesError(_NONE)
    here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    words = ["unshare", "--user", "--map-root-user", "--net", "--", sys.executable]
    words += ["-m", __name__, str(there.fileno()), str(seed)]
    with here:
        process = subprocess.Popen(words, pass_fds=[there.fileno()])
        there.close()
        with contextlib.suppress(OSError):  # The load of this computer must not delay the network.
            os.sched_setscheduler(process.pid, os.SCHED_FIFO, os.sched_param(_PRIORITY))
        try:
            both = TwoComputers(process, here)
            both.set(robot=to_robot, operator=to_operator)
            yield both
        finally:
            here.close()  # which ends the process
            process.wait()


# -- the forwarding process ------------------------------------------------------------------------


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True)


def _checked(libc: ctypes.CDLL, name: str, *arguments: int) -> None:
    if getattr(libc, name)(*arguments):
        raise OSError(ctypes.get_errno(), f"{name}: {os.strerror(ctypes.get_errno())}")


def _without_offloads(interface: str) -> None:
    """Disable offloads: frames are sent whole, with complete checksums and of at most the wire's
    length."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        for command in _ETHTOOL_OFFLOADS:
            value = ctypes.create_string_buffer(struct.pack("=II", command, 0))
            request = struct.pack("16sP16x", interface.encode(), ctypes.addressof(value))
            with contextlib.suppress(OSError):  # A kernel may refuse to change some of them.
                fcntl.ioctl(any_socket, _SIOCETHTOOL, request)


class _Forwarder:
    """Creates the namespaces and forwards frames between them."""

    def __init__(self, control: socket.socket, seed: int) -> None:
        self._control = control
        self._libc = ctypes.CDLL(None, use_errno=True)
        self._between = os.open("/proc/self/ns/net", os.O_RDONLY)
        self._namespaces = {name: self._made(name) for name in ADDRESSES}
        self._enter(self._between)
        self._ends = {name: self._end(name) for name in ADDRESSES}
        chosen = random.Random(seed)
        self._ways = {name: Way(Conditions(), chosen) for name in ADDRESSES}
        self._late_s = 0.0
        control.send(json.dumps([self._namespaces, self._congestion]).encode())

    def _enter(self, namespace: int) -> None:
        _checked(self._libc, "setns", namespace, _CLONE_NEWNET)

    def _made(self, name: str) -> int:
        _checked(self._libc, "unshare", _CLONE_NEWNET)
        between = f"/proc/{os.getpid()}/fd/{self._between}"
        for congestion in ("reno", "cubic"):  # A kernel may not offer each of them to a namespace.
            with contextlib.suppress(OSError):
                _CONGESTION.write_text(congestion)
        _ip("link", "set", "lo", "up")
        _ip(
            *f"link add {INTERFACE} address {_MAC[name]} type veth".split(),
            *f"peer name {name} netns {between}".split(),
        )
        _without_offloads(INTERFACE)
        _ip(*f"link set {INTERFACE} up addrgenmode none".split())
        _ip(*f"address add {ADDRESSES[name]}/24 dev {INTERFACE}".split())
        # A lost ARP request would cost a second, which does not happen on a long-distance link.
        for addresses in (ADDRESSES, OTHER_ADDRESSES):
            address, mac = addresses[SENDER[name]], _MAC[SENDER[name]]
            _ip(*f"neighbor add {address} lladdr {mac} dev {INTERFACE}".split())
        self._congestion = _CONGESTION.read_text().strip()
        return os.open("/proc/self/ns/net", os.O_RDONLY)

    def _end(self, name: str) -> socket.socket:
        _ip(*f"link set {name} up addrgenmode none".split())
        end = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(_ETH_P_ALL))
        end.bind((name, _ETH_P_ALL))
        end.setblocking(False)
        return end

    def _answer(self, question: dict[str, Any]) -> None:
        fds = []
        for to, conditions in question.get("ways", {}).items():
            self._ways[to].conditions = Conditions(**conditions)
        if name := question.get("socket"):
            self._enter(self._namespaces[name])
            fds.append(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            self._enter(self._between)
        counts = {to: dict(way.counts) for to, way in self._ways.items()}
        counts["forwarder"] = {"late_us": round(1e6 * self._late_s)}
        found: dict[str, Any] = {"counts": counts}
        if asked := question.get("carried"):
            to, since_s, until_s = asked
            carried = self._ways[to].carried(since_s, until_s)
            found["carried"] = [astuple(each) for each in carried[:_MOST_CARRIED]]
        socket.send_fds(
            self._control, [json.dumps(found).encode()], [each.fileno() for each in fds]
        )
        for each in fds:
            each.close()

    def _take(self, to: str) -> None:
        end = self._ends[SENDER[to]]
        with contextlib.suppress(BlockingIOError):
            while True:
                frame, address = end.recvfrom(_FRAME)
                if address[2] != socket.PACKET_OUTGOING:
                    self._ways[to].send(frame, time.monotonic())

    def _give(self, to: str) -> None:
        way, now_s = self._ways[to], time.monotonic()
        if way.next_s <= now_s:
            self._late_s = max(self._late_s, now_s - way.next_s)
            for frame in way.arrived(now_s):
                with contextlib.suppress(OSError):  # full queue of the interface: frame lost
                    self._ends[to].send(frame)

    def run(self) -> None:
        """Run until the control's other end is closed."""
        readers = [self._control, *self._ends.values()]
        while True:
            due_s = min(way.next_s for way in self._ways.values())
            waits_s = None if math.isinf(due_s) else max(0.0, due_s - time.monotonic())
            if self._control in select.select(readers, [], [], waits_s)[0]:
                if not (question := self._control.recv(_FRAME)):
                    return
                self._answer(json.loads(question))
            for to in self._ways:
                self._take(to)
                self._give(to)


def _main() -> None:
    fd, seed = sys.argv[1:]
    with socket.socket(fileno=int(fd)) as control:
        _Forwarder(control, int(seed)).run()


if __name__ == "__main__":
    _main()
