"""ABB Externally Guided Motion (EGM): datagrams to values in SI units and back.

Source: ABB Application manual, Externally Guided Motion, RobotWare 7.16 (3HAC073318-001), and the
published ``egm.proto`` of RobotWare 6.08 to 7.16.
"""
