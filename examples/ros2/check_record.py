"""A record as a regression test: the control core has to return the same commands, bit for bit.

cardan run examples/ros2/session.toml --record session.mcap
python examples/ros2/check_record.py session.mcap
"""

from __future__ import annotations

import sys
from pathlib import Path

from cardan.recording.verify import verify


def main(path: str) -> int:
    """Return 1 if a command differs, or if the record could not be replayed to its end."""
    reports = verify(Path(path))
    for report in reports:
        print("\n".join(report.lines()))
    return int(not all(report.same and not report.ended for report in reports))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
