"""Protocol of operator devices on a web page: jog buttons, phone, headset's controllers, gamepad.

`frames` has the bytes, `orientation` the axes of phones and of WebXR, `motion` the displacement of
the device, `teleop` the message of the public teleop page. docs/phone.md.
"""
