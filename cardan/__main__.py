"""``python -m cardan`` is the ``cardan`` command."""

from cardan.cli import main

main()
