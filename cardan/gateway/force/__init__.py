"""What the hand feels: virtual fixtures, and forces that are measured where the robot is.

`tables` is the configuration, `fixtures` makes geometry of it, `sources` say where a force comes
from, `conditioning` makes of a raw force one for the hand, `input` minds its age, `enabling` asks
the haptic device to let force out, `guard` watches that it does, and `rendering` hands all that to
the device in every cycle. `link` and `service` are the way to a force node in a process of its own.
"""
