"""How the judges of an arm are told what to do, and tell what they meet, in lines of JSON.

For every Python that they run in: nothing but the standard library.
"""

import json
import sys
import threading

_telling = threading.Lock()


def tell(event, **fields):
    """Say what was met; from any thread."""
    with _telling:
        print(json.dumps({"event": event, **fields}), flush=True)


def obey(judge):
    """Each line is what to `do`, a method of `judge`, and its arguments; until the last one."""
    for line in sys.stdin:
        words = json.loads(line)
        getattr(judge, words.pop("do"))(**words)
