"""ROS-Industrial simple message as MotoROS uses it, and the velocity mode added to it.

Sources: ROS-Industrial simple_message and motoman_driver (MotoROS 1.9.12). The velocity mode
(2040 to 2042, START_VEL_MODE, STOP_VEL_MODE) is docs/protocols/simple-message.md.
"""
