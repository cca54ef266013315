"""Checks of `cardan doctor` for haptic devices."""

from __future__ import annotations

from collections.abc import Iterable

from cardan.doctor.base import Check, Finding, Subject, caution, failure, good
from cardan_omni.driver import Omni
from cardan_omni.driver.native import NativeMissingError, tick_library


class Compiled(Check):
    """The compiled loop of haptic devices."""

    group, tells = "installation", ("compiled",)

    @classmethod
    def look(cls, subject: Subject) -> Iterable[Finding]:
        try:
            tick_library()
        except NativeMissingError as error:
            wanted = any(isinstance(each.driver, Omni) for each in subject.used())
            make = failure if wanted else caution
            mend = "sudo apt-get install gcc libc6-dev && pip install --force-reinstall cardan-omni"
            why = "haptic devices need it" + ("" if wanted else "; nothing else does")
            return [make("compiled", str(error).partition(": ")[0], why, mend)]
        return [good("compiled", "the compiled force loop can be loaded")]
