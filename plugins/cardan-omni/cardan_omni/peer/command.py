"""Simulated haptic device of ``cardan sim omni``: behind libHD, for a program that it runs."""

from __future__ import annotations

import dataclasses
import sys
from dataclasses import dataclass

from cardan.errors import ConfigurationError
from cardan.sim_peers.command import PeerCommand, option
from cardan_omni.peer.hand import SCRIPT_VERBS, SCRIPTS, load_motion
from cardan_omni.peer.library import library_path
from cardan_omni.peer.program import missing_log, run_program
from cardan_omni.peer.settings import FAULTS, OmniSettings


@dataclass(frozen=True, kw_only=True)
class OmniOptions(OmniSettings):
    """Device, motion of the hand, and the program that uses them."""

    program: tuple[str, ...] = option(
        (),
        "To run with the simulated device, and its arguments.",
        metavar="PROGRAM",
        positional=True,
    )
    library: bool = option(False, "Print where the simulated libHD.so is, then end.")
    script: str = "demo"
    """Built-in script or a file, from which `motion` is computed."""


class Omni(PeerCommand[OmniOptions]):
    """A Phantom Omni (Touch) and the hand on it, behind libHD: runs a program with it."""

    Options = OmniOptions
    page = "../plugins/cardan-omni/README.md"
    example = "--script contact -- ./touch"
    speaks = (
        "[HDAPI](../plugins/cardan-omni/README.md#protocol), the C functions of the vendor's "
        "libHD, in the process of the program that uses it"
    )
    epilog = (
        "The program finds it as libHD.so, whether it is linked to that or loads it itself; "
        "CARDAN_LIBHD has its path. The exit code is the program's."
    )
    faults, scripts, verbs = FAULTS, SCRIPTS, SCRIPT_VERBS

    @staticmethod
    def run(options: OmniOptions, seconds: float | None) -> int:
        if options.library:
            print(library_path())
            return 0
        if not options.program:
            raise ConfigurationError(
                "",
                "name the program that is to use the device, as in: cardan sim omni -- ./program; "
                "or take --library, which prints where libHD.so is",
            )
        settings = dataclasses.replace(options, motion=load_motion(options.script))
        code = run_program(options.program, settings, seconds)
        if missing := missing_log(settings):
            print(f"warning: --log: {missing}", file=sys.stderr)
        return code
