"""JSON lines by which the judges of an arm receive commands and report observations.

This module runs in each judge's Python and uses only the standard library.
"""

import json
import sys
import threading

_telling = threading.Lock()


def tell(event, **fields):
    """Report an observation, from any thread."""
    with _telling:
        print(json.dumps({"event": event, **fields}), flush=True)


def obey(judge):
    """Call a method of `judge` for each line of standard input: `do` names it, other keys are its
    arguments."""
    for line in sys.stdin:
        words = json.loads(line)
        getattr(judge, words.pop("do"))(**words)
