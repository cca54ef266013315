"""Base of the drivers of Linux input devices (gamepad, keyboard)."""
