"""``python -m cardan`` is the ``cardan`` command."""

from cardan.common.resource_errors import run


def main() -> None:
    """Run the command line."""
    run("cardan.cli")


if __name__ == "__main__":
    main()
