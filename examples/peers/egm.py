"""An EGM controller and a session of the driver in virtual time: an emergency stop after 2 s.

`cycle` is called once per period and returns the datagram for the PC; `receive` processes the PC's.
`controller.do` performs a verb of a script. It prints:

    0.000 s: a session begins: its first answer is the measured position
    0.004 s: ready
    2.004 s: the motors are off
"""

from cardan.drivers.abb_egm import AbbEgmOptions, EgmSession
from cardan.sim_peers.egm_controller import EgmController, EgmControllerOptions
from cardan.types import HoldCommand

controller = EgmController(EgmControllerOptions(faults={"estop": 2.0}))
session = EgmSession(AbbEgmOptions(), 0.0)
reason = ""
for cycle in range(750):  # 3 s, in virtual time
    now_s = cycle * controller.options.period_s
    data = controller.cycle(now_s)
    if data is not None:
        state = session.receive(data, ("127.0.0.1", 40000), now_s)
        if state is not None:
            if state.hold_reason != reason:
                reason = state.hold_reason
                print(f"{now_s:.3f} s: {reason or 'ready'}")
            controller.receive(session.reply(HoldCommand(), now_s))
