"""Protocol of operator devices on a web page: jog buttons, phone, headset's controllers, gamepad.

`frames` has the bytes, `orientation` the axes of phones and of WebXR, `motion` the displacement of
the device, `teleop` the message of the public teleop page. docs/phone.md.
"""

from cardan.protocols.handheld.frames import (
    BUTTONS as BUTTONS,
    MAX_JOINTS as MAX_JOINTS,
    VERSION as VERSION,
    Body as Body,
    BodyPart as BodyPart,
    GamepadFrame as GamepadFrame,
    JogJoints as JogJoints,
    JogTwist as JogTwist,
    MalformedFrame as MalformedFrame,
    OperatorFrame as OperatorFrame,
    PhoneFrame as PhoneFrame,
    XrFrame as XrFrame,
    decode_frame as decode_frame,
    encode_frame as encode_frame,
)
from cardan.protocols.handheld.motion import (
    LEAP_M as LEAP_M,
    LEAP_RAD as LEAP_RAD,
    Held as Held,
    PoseSample as PoseSample,
    Yaw as Yaw,
    drag_on_screen as drag_on_screen,
    elsewhere as elsewhere,
    leap as leap,
    pitched as pitched,
)
from cardan.protocols.handheld.orientation import (
    from_angles as from_angles,
    heading_rad as heading_rad,
    orientation_from_xr as orientation_from_xr,
    orientation_to_xr as orientation_to_xr,
    position_from_xr as position_from_xr,
    position_to_xr as position_to_xr,
    to_angles as to_angles,
)
from cardan.protocols.handheld.teleop import (
    TeleopLog as TeleopLog,
    TeleopPose as TeleopPose,
    decode_teleop as decode_teleop,
)
