"""What the hand feels: virtual fixtures, and forces that are measured where the robot is.

`tables` is the configuration, `fixtures` makes geometry of it, `sources` say where a force comes
from, `conditioning` makes of a raw force one for the hand, `rendering` hands all that to the haptic
device in every cycle, `link` and `service` are the way to a force node of its own process, and
`node` is that process.
"""
