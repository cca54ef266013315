"""Build the peers in C and C++, and print what cannot be built: `python -m bench.native`."""

from __future__ import annotations

import sys

from bench.native import PARTS, NotBuiltError, built


def main() -> int:
    """Build all peers; return 1 if something is missing."""
    missing = 0
    for part in PARTS:
        try:
            print(f"{part}: {built(part).name}", flush=True)
        except NotBuiltError as error:
            missing = 1
            print(f"{part} is not built: {error}", flush=True)
    return missing


if __name__ == "__main__":
    sys.exit(main())
