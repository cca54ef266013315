"""What the drivers of Linux input devices (gamepad, keyboard) share."""
