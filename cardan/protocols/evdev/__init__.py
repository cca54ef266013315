"""Linux's evdev: events and requests of /dev/input/eventN, and of uinput."""
