"""Run all benchmarks in sequence, or those named on the command line."""

from __future__ import annotations

import sys

from bench import (
    console,
    cycle_profile,
    device_parse,
    dissect,
    egm_codec,
    egm_latency,
    haptics,
    hid_parse,
    killed,
    kilohertz,
    motoros_link,
    network,
    published_tick,
    recording,
    remote,
    servo_numbers,
    servo_tick,
    session_tick,
    sessions,
    simple_message_codec,
    soak,
    thesis,
    ur_latency,
    yaskawa,
)

BENCHMARKS = {
    "console": console.main,
    "hid-parse": hid_parse.main,
    "device-parse": device_parse.main,
    "dissect": dissect.main,
    "egm-codec": egm_codec.main,
    "egm-latency": egm_latency.main,
    "cycle-profile": cycle_profile.main,
    "haptics": haptics.main,
    "killed": killed.main,
    "kilohertz": kilohertz.main,
    "servo-tick": servo_tick.main,
    "published-tick": published_tick.main,
    "session-tick": session_tick.main,
    "sessions": sessions.main,
    "recording": recording.main,
    "remote": remote.main,
    "motoros-link": motoros_link.main,
    "network": network.main,
    "motoros-soak": motoros_link.soak,
    "servo-numbers": servo_numbers.main,
    "simple-message-codec": simple_message_codec.main,
    "thesis": thesis.main,
    "ur-latency": ur_latency.main,
    "yaskawa": yaskawa.main,
}


def main() -> None:
    """Run the selected benchmarks."""
    words = sys.argv[1:]
    if words[:1] == ["soak"]:  # It takes hours, so it is not part of "all".
        soak.main(words[1:])
        return
    if "-h" in words or "--help" in words:
        print(f"{__doc__}\n\n  {'  '.join([*BENCHMARKS, 'soak'])}")
        return
    if "--plots" in words:
        first = words.index("--plots")
        del words[first : first + 2]
    names = [word for word in words if not word.isdecimal() and not word.startswith("--")]
    for name in names or BENCHMARKS:
        if name not in BENCHMARKS:
            sys.exit(f"there is no benchmark {name!r}; there are: {', '.join(BENCHMARKS)}")
        BENCHMARKS[name]()


if __name__ == "__main__":
    main()
