"""Program that a client runs at the controller to follow joint targets, and the registers between
them.

The program servos to the joints in the registers. Without a command it continues at the last
speeds, as a resuming client assumes, and after the watchdog's time it stops the arm and ends. It
obeys a single run of the client: the one with the program's token.
"""

from __future__ import annotations

import enum
from typing import Any, Final, NamedTuple

from cardan.protocols.ur.variables import UPPER_REGISTERS

JOINTS: Final = 6

FIRST_WAIT_S: Final = 2.0
"""Timeout of the program for the first command."""
LARGEST_JUMP_RAD: Final = 0.15
"""Largest plausible step of a command from the previous one, or from the place that the program has
reached without commands, at a speed known to both sides."""


class ProgramCommand(enum.IntEnum):
    """Command of the client, in an input register."""

    FOLLOW = 1
    END = 2
    """Stop the arm and end."""


class ProgramStatus(enum.IntEnum):
    """Status of the program, in an output register."""

    NOTHING = 0
    FOLLOWS = 1
    ENDED_BY_ORDER = 2
    ENDED_BY_WATCHDOG = 3
    ENDED_BY_JUMP = 4


def input_names(first: int) -> tuple[str, ...]:
    """Return the registers that the client writes: token, beat, command, joints and joint
    speeds."""
    return (
        *(f"input_int_register_{first + n}" for n in range(3)),
        *(f"input_double_register_{first + n}" for n in range(2 * JOINTS)),
    )


def report_names(first: int) -> tuple[str, str, str]:
    """Return the registers that the program writes: token, status, and the last obeyed beat."""
    return (
        f"output_int_register_{first}",
        f"output_int_register_{first + 1}",
        f"output_int_register_{first + 2}",
    )


def nobody(beat: int) -> list[Any]:
    """Return register values that no program obeys."""
    return [0, beat, int(ProgramCommand.END), *(0.0,) * (2 * JOINTS)]


class Servoing(NamedTuple):
    """Parameters of a program: servoing and watchdog."""

    first_register: int = UPPER_REGISTERS
    """First register between the client and the program."""
    watchdog_s: float = 0.1
    """Time without a command after which it stops the arm and ends."""
    lookahead_s: float = 0.03
    """servoj's `lookahead_time`."""
    gain: int = 500
    """servoj's `gain`."""
    stop_rad_s2: float = 5.0
    """Deceleration of the fastest joint at its end."""


def program(servoing: Servoing, token: int, control_period_s: float) -> str:
    """Return the program's text for a controller whose control loop has this period."""
    first = servoing.first_register
    joints = range(JOINTS)
    goal = ", ".join(f"read_input_float_register({first + n})" for n in joints)
    speeds = ", ".join(f"read_input_float_register({first + JOINTS + n})" for n in joints)
    jump = " or ".join(f"norm(new[{n}] - q[{n}]) > {LARGEST_JUMP_RAD:g}" for n in joints)
    drift = "\n".join(f"      q[{n}] = q[{n}] + v[{n}] * {control_period_s:g}" for n in joints)
    most = round(servoing.watchdog_s / control_period_s)
    waits = round(FIRST_WAIT_S / control_period_s)
    return f"""\
def cardan():
  write_output_integer_register({first + 1}, {ProgramStatus.NOTHING:d})
  q = get_target_joint_positions()
  v = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
  new = q
  seen = read_input_integer_register({first + 1})
  silent = {-waits}
  report = {ProgramStatus.FOLLOWS:d}
  write_output_integer_register({first + 2}, seen)
  write_output_integer_register({first}, {token})
  write_output_integer_register({first + 1}, report)
  while report == {ProgramStatus.FOLLOWS:d}:
    beat = read_input_integer_register({first + 1})
    if beat != seen and read_input_integer_register({first}) == {token}:
      new = [{goal}]
      if read_input_integer_register({first + 2}) != {ProgramCommand.FOLLOW:d}:
        report = {ProgramStatus.ENDED_BY_ORDER:d}
      elif {jump}:
        report = {ProgramStatus.ENDED_BY_JUMP:d}
      else:
        q = new
        v = [{speeds}]
        seen = beat
        silent = 0
        write_output_integer_register({first + 2}, seen)
      end
    else:
      silent = silent + 1
{drift}
      if silent > {most}:
        report = {ProgramStatus.ENDED_BY_WATCHDOG:d}
      end
    end
    if report == {ProgramStatus.FOLLOWS:d}:
      servoj(q, 0, 0, {control_period_s:g}, {servoing.lookahead_s:g}, {servoing.gain:d})
    end
  end
  write_output_integer_register({first + 1}, report)
  stopj({servoing.stop_rad_s2:g})
end
"""
