"""``cardan explain``: the meaning of a message, and instructions."""

from __future__ import annotations

from typing import Annotated

import typer

from cardan.cli import completion
from cardan.cli.common import AsJson, page_path, print_json


def explain(
    message: Annotated[
        str,
        typer.Argument(
            metavar="CODE|MESSAGE",
            help="A code, such as S004, or the text of a message.",
            autocompletion=completion.codes,
        ),
    ],
    as_json: AsJson = False,
) -> None:
    """Explain a message by its code or its words. Prints its cause, what happens meanwhile, what
    to do, and the page of the documentation."""
    from cardan.common.troubles import explained

    found = explained(message)
    if as_json:
        print_json(found._asdict())
        return
    print(f"{found.code}: {found.words[0]}\n")
    for title, text in (
        ("cause", found.cause),
        ("meanwhile", found.now),
        ("what to do", found.do),
        ("page", page_path(found.page)),
    ):
        print(f"{title:<10}  {text}")
