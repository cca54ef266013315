"""The HID protocol of 3Dconnexion's six-axis devices (SpaceMouse, SpaceNavigator and kin)."""
