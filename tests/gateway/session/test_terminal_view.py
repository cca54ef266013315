"""Terminal view of a session."""

import dataclasses
import io
import operator

import pytest
from rich.console import Console

from cardan.gateway.session.snapshot import Snapshot
from cardan.gateway.session.terminal_view import SessionView, plain, render, summary
from tests.snapshots import changed

MOVING = Snapshot.of(
    {
        "elapsed_s": 12.0,
        "diagnosis": ["the motion is capped"],
        "arm": {
            "phase": "moving",
            "reference": [0.501, -0.1, 0.8, 1, 0, 0, 0],
            "twist": [0.05, 0, 0, 0, 0, -0.4],
        },
        "device": {
            "link": "live",
            "axes": [0.5, 0, 0, 0, 0, -1.0],
            "buttons": ["left"],
            "battery": 0.55,
        },
        "robot": {
            "link": "live",
            "pose": [0.5, -0.1, 0.8, 1, 0, 0, 0],
            "joints_rad": [0.1] * 6,
            "utilization": 0.37,
            "metrics": {"lost": 2, "superseded": 1, "sessions": 1, "period_s": 0.004032},
        },
        "loop": {"cycles": 3000, "tick_p50_s": 42e-6},
    }
)


def shown(renderable):
    console = Console(file=io.StringIO(), width=140, no_color=True)
    console.print(renderable)
    return console.file.getvalue()


def test_the_live_view_shows_hand_robot_and_trouble():
    text = shown(render(MOVING))
    for words in (
        "+0.50",
        "-400.0 mrad/s",
        "500.0",
        "501.0",
        "left",
        "55%",
        "42 µs",
        "37%",
        "3,000, 3",
    ):
        assert words in text
    assert "the motion is capped" in text


def test_a_session_that_has_not_begun_can_be_shown():
    assert "starting" in shown(render(Snapshot()))
    assert "starting" in plain(Snapshot())


def test_summary():
    text = shown(summary(MOVING))
    assert "4.032 ms" in text
    assert MOVING.robot.missed_cycles == 3


def view():
    return SessionView(Console(file=io.StringIO(), force_terminal=False))


def test_plain_lines_come_once_a_second_and_when_there_is_news(capsys):
    with view() as v:
        for tenth in range(21):
            v.show(
                Snapshot.of(
                    {
                        "elapsed_s": tenth / 10,
                        "arm": {"message": f"no datagram for {tenth / 10:.1f} s"},
                    }
                )
            )
        assert len(capsys.readouterr().out.splitlines()) == 3
        v.show(Snapshot.of({"elapsed_s": 2.05, "arm": {"message": "the motors are off"}}))
        assert "the motors are off" in capsys.readouterr().out


def test_diagnosis_is_printed_when_it_is_new(capsys):
    with view() as v:
        v.show(MOVING)
        v.show(MOVING)
    assert capsys.readouterr().out.count("the motion is capped") == 1


NASTY = "[/x][red]seen\x1b[2J\x1b]0;title\x07\r\nforged\u202e\x9b1m"
"""Control sequences, line breaks, bidirectional text and rich's markup, which must be shown but not
interpreted."""


def parts(snapshot):
    return {f"{k}__": v for k, v in vars(snapshot).items() if dataclasses.is_dataclass(v)}


def reported(**fields):
    """A snapshot received from a session."""
    return Snapshot.from_bytes(changed(MOVING, **fields).to_bytes())


@pytest.mark.parametrize(
    "field",
    [
        f"{prefix}{each.name}"
        for prefix, part in {"": MOVING, **parts(MOVING)}.items()
        for each in dataclasses.fields(part)
        if each.type == "str"
    ],
)
def test_no_text_of_others_commands_the_terminal(field, capsys):
    snapshot = reported(**{field: NASTY})
    SessionView(Console(file=io.StringIO())).show(snapshot)
    shows = capsys.readouterr().out, shown(render(snapshot)), shown(summary(snapshot))
    for text in (*shows, operator.attrgetter(field.replace("__", "."))(snapshot)):
        assert text.replace("\n", "").isprintable()
        assert not any(line.startswith("forged") for line in text.splitlines())


def test_neither_does_a_diagnosis_a_filter_a_button_or_a_metric(capsys):
    snapshot = reported(
        diagnosis=[NASTY],
        arm__filters=[NASTY],
        device__buttons=[NASTY],
        arm__limits_in_words=[NASTY],
        robot__metrics={NASTY: 1},
    )
    SessionView(Console(file=io.StringIO())).show(snapshot)
    for text in (capsys.readouterr().out, shown(render(snapshot)), shown(summary(snapshot))):
        assert text.replace("\n", "").isprintable()
    assert "[/x][red]seen" in shown(render(reported(diagnosis=[NASTY])))
    assert "[/x][red]seen" in shown(summary(reported(arm__message=NASTY)))


def test_a_terminal_that_is_behind_is_given_no_older_frames(monkeypatch):
    terminal = io.StringIO()
    console = Console(file=terminal, force_terminal=True, width=140)
    behind = True
    monkeypatch.setattr("cardan.common.output.is_behind", lambda: behind)
    with SessionView(console) as view:
        began = len(terminal.getvalue())
        for tenth in range(20):
            view.show(dataclasses.replace(MOVING, elapsed_s=tenth / 10))
        assert len(terminal.getvalue()) == began
        behind = False
        view.show(dataclasses.replace(MOVING, elapsed_s=77.0))
        assert "77.0 s" in terminal.getvalue()
