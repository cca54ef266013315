"""The command line in this process, built once, since its commands hold no state."""

import functools
from typing import Any

import typer.main

from cardan.cli import app


@functools.cache
def the_command_line() -> Any:
    """``cardan`` as a command of click."""
    return typer.main.get_command(app)
