"""``cardan net export``: records as data sets for robot learning."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cardan.cli.common import EXIT_INCOMPLETE
from cardan.common.text_sanitizer import printable


def export(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Records (MCAP).")],
    lerobot: Annotated[
        Path,
        typer.Option("--lerobot", metavar="FOLDER", help="The LeRobotDataset to write, a new one."),
    ],
    fps: Annotated[int, typer.Option(help="Frames a second.")] = 30,
    task: Annotated[
        str, typer.Option(metavar="TEXT", help="What was done, in words, for all episodes.")
    ] = "teleoperation",
    repo_id: Annotated[
        str,
        typer.Option(metavar="USER/NAME", help="LeRobot's name for it; default: by the folder."),
    ] = "",
    arm: Annotated[
        str, typer.Option(metavar="NODE", help="Arm to take, if a record has several.")
    ] = "",
    each_engagement: Annotated[
        bool,
        typer.Option(
            "--each-engagement",
            help="An episode for each time in which a source had the authority over the arm, and "
            "not one for each FILE.",
        ),
    ] = False,
    longest_gap: Annotated[
        float,
        typer.Option(
            metavar="S",
            help="At a longer time without a state an episode ends, and another begins.",
        ),
    ] = 10.0,
) -> None:
    """Write records as a data set for robot learning: joints, TCP and gripper at a fixed rate, with
    the commanded poses. Uses LeRobot's own program if it is installed."""
    from cardan_learning.export import export_lerobot

    report = export_lerobot(
        files,
        lerobot,
        fps=fps,
        task=task,
        repo_id=repo_id,
        arm=arm,
        each_engagement=each_engagement,
        longest_gap_s=longest_gap,
    )
    for line in report.lines():
        print(printable(line))
    if not report.complete:
        raise typer.Exit(EXIT_INCOMPLETE)
