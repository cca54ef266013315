"""ABB Externally Guided Motion (EGM): robots with IRC5 or OmniCore controllers over UDP."""

from cardan.drivers.abb_egm.driver import AbbEgm as AbbEgm
from cardan.drivers.abb_egm.options import AbbEgmOptions as AbbEgmOptions
from cardan.drivers.abb_egm.session import EgmSession as EgmSession
