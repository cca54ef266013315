"""ABB Externally Guided Motion (EGM): robots with IRC5 or OmniCore controllers over UDP."""

from cardan.drivers.abb_egm.driver import AbbEgm
from cardan.drivers.abb_egm.options import AbbEgmOptions
from cardan.drivers.abb_egm.session import EgmSession
from cardan.drivers.abb_egm.stream import EgmStream

__all__ = ["AbbEgm", "AbbEgmOptions", "EgmSession", "EgmStream"]
