"""Force feedback: virtual fixtures, and forces measured at the robot.

`tables` is the configuration, `fixtures` turns it into geometry, `sources` give readings of a
force, `conditioning` turns a reading into a force for the hand, `input` checks its age, `servo_on`
enables the device's force, `watchdog` disengages teleoperation when it is lost, and `rendering`
commands the device in every cycle. `link` and `service` connect a force node in another process.
"""
