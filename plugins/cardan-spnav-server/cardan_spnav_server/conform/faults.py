"""Defects of daemons, some of them seen in public ones, for the simulated server."""

from __future__ import annotations

from cardan.sim_peers.base import FaultSwitch

FAULTS: tuple[FaultSwitch, ...] = (
    FaultSwitch("refuse", "there is no socket for the first VALUE s", 1.0),
    FaultSwitch("hang-up", "closes every connection at VALUE s", 2.0),
    FaultSwitch.flag("mute", "takes connections, and never sends anything"),
    FaultSwitch.flag("version-0", "knows no handshake, as spacenavd before 1.0"),
    FaultSwitch.flag("grants-all", "grants every requested version"),
    FaultSwitch("short", "every VALUE-th record is cut short", 20.0, 1.0),
    FaultSwitch("unknown", "a record of no known type before every VALUE-th motion", 20.0, 1.0),
    FaultSwitch.flag("tells-all", "reports its device to clients of version 0, too"),
    FaultSwitch.flag("unmirrored", "rotations are left-handed"),
    FaultSwitch(
        "repeat", "repeats the last deflection every VALUE ms, as repeat-interval", 1.0, 0.1, 999.0
    ),
    FaultSwitch("silence", "no motion from VALUE s on", 1.5),
    FaultSwitch("burst", "for VALUE s in every 2·VALUE s nothing, then all at once", 0.3, 0.001),
    FaultSwitch.flag("missing-zero", "the motion that ends a deflection is lost"),
    FaultSwitch("drift", "an axis rests VALUE counts off zero, and trembles", 20.0),
    FaultSwitch("overrange", "motions have VALUE times the usual counts", 2.0, 0.01, 100.0),
    FaultSwitch("period", "the time since the last motion is VALUE ms in all of them", 0.0),
    FaultSwitch("key-lost", "every VALUE-th edge of a button is lost", 2.0, 1.0),
    FaultSwitch("key-twice", "every VALUE-th edge of a button is reported twice", 1.0, 1.0),
    FaultSwitch("key-number", "buttons are reported with VALUE added to their numbers", 100.0),
    FaultSwitch("slow-answer", "replies come VALUE ms late", 400.0, 0.0, 10_000.0),
    FaultSwitch("no-answer", "every VALUE-th request is not answered", 5.0, 1.0),
    FaultSwitch.flag("bare-word", "replies have the request's code only, without libspnav's mark"),
    FaultSwitch.flag("name-answered", "the client's name is answered, too"),
    FaultSwitch.flag("grants-unknown", "unknown requests are granted"),
    FaultSwitch.flag("mask-ignored", "an event mask is granted, but has no effect"),
    FaultSwitch.flag("mask-zeros", "sends zeros in place of an event that the mask leaves out"),
    FaultSwitch("mask", "clients of version 1 have the mask VALUE after the handshake", 3.0),
    FaultSwitch("axes", "the device is said to have VALUE axes", 2.0),
    FaultSwitch.flag("string", "pieces of a string are not marked as such"),
    FaultSwitch("type", "the device is said to be of type VALUE", 0x300),
    FaultSwitch.flag("nan", "the daemon's sensitivity is not a number"),
    FaultSwitch("repeat-interval", "the daemon says that it repeats every VALUE ms", 250.0),
    FaultSwitch.flag("led-unreported", "a change of the LED is reported to no client"),
    FaultSwitch.flag("one-client", "motion goes to the newest connection only"),
    FaultSwitch.flag("deaf-v1", "the sensitivity of version 1 is granted, but has no effect"),
    FaultSwitch.flag("deaf-v0", "the sensitivity of version 0 has no effect"),
    FaultSwitch.flag("ends-all", "ends all connections when one is closed"),
    FaultSwitch.flag("unplug-unreported", "no client is informed that the device is gone"),
    FaultSwitch.flag("keeps-device", "answers for a device that is gone"),
    FaultSwitch.flag("replug-unreported", "no client is informed that the device is back"),
)
