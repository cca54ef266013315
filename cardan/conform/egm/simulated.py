"""The simulated controller and a pilot in virtual time, with the network between them."""

from __future__ import annotations

from collections.abc import Mapping

from cardan.conform.runner import Act, Exchange
from cardan.conform.timeline import Kind
from cardan.sim_peers.egm_controller import EgmController, EgmControllerOptions
from cardan.sim_peers.link import FaultyLink

LONGEST_S = 300.0
"""Of a simulated run; a script that waits for what never comes ends before."""
_FIRST_PORT = 49_152


class EgmRig:
    """Runs the controller's cycles, carries datagrams both ways, and does what is asked by hand."""

    def __init__(self, conduct: Exchange, faults: Mapping[str, float], seed: int) -> None:
        # Its program runs EGM again by itself, as many do: nobody is there to start it.
        options = EgmControllerOptions(script="teleop-retry", faults=faults, seed=seed)
        self._conduct = conduct
        self._core = EgmController(options)
        self._period_s = options.period_s
        self._out: FaultyLink[bytes] = FaultyLink(faults, seed + 2, True)
        self._in: FaultyLink[bytes] = FaultyLink(faults, seed + 3)
        self._now_s = 0.0

    def run(self) -> None:
        """Until the pilot's script is over."""
        conduct, cycle = self._conduct, 0
        while not conduct.over and self._now_s < LONGEST_S:
            due_s = cycle * self._period_s
            times = (due_s, conduct.next_s, self._out.next_s(), self._in.next_s())
            self._now_s = max(self._now_s, min(each for each in times if each is not None))
            self._do(conduct.due(self._now_s))
            for data in self._in.pop(self._now_s):
                self._core.receive(data)
            if self._now_s >= due_s:
                cycle += 1
                sent = self._core.cycle(due_s)
                if sent is not None:
                    self._out.push(self._now_s, sent)
            for data in self._out.pop(self._now_s):
                port = _FIRST_PORT + self._core.port_changes
                source = f"127.0.0.1:{port}"
                self._do(conduct.heard(self._now_s, "", data, note=source))

    def _do(self, acts: list[Act]) -> None:
        for act in acts:
            if act.kind is Kind.DATA:
                self._in.push(self._now_s, act.data)
            elif act.kind is Kind.OPENED:
                self._do(self._conduct.heard(self._now_s, act.channel, kind=Kind.OPENED))
            elif act.kind is Kind.ASKED:
                verbs = {"estop": ("estop",), "release": ("motors-on", "program-start")}
                for verb in verbs[act.channel]:
                    self._core.do(verb)
