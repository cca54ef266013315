"""Every benchmark, one after the other, or those named on the command line."""

from __future__ import annotations

import sys

from bench import egm_codec, egm_latency, hid_parse

BENCHMARKS = {
    "hid-parse": hid_parse.main,
    "egm-codec": egm_codec.main,
    "egm-latency": egm_latency.main,
}


def main() -> None:
    """Run them."""
    for name in sys.argv[1:] or BENCHMARKS:
        if name not in BENCHMARKS:
            sys.exit(f"there is no benchmark {name!r}; there are: {', '.join(BENCHMARKS)}")
        BENCHMARKS[name]()


if __name__ == "__main__":
    main()
