"""Button edges: none lost, none reordered, all released when their state is unknown."""

from hypothesis import given, strategies as st

from cardan.drivers import buttons
from cardan.drivers.buttons import ButtonEdges
from cardan.types import ButtonEvent

LABELS = st.lists(st.sampled_from(["a", "b", "c", "d"]), unique=True)


def test_releases_come_before_presses():
    edges = ButtonEdges()
    edges.set(["a"], 1.0)
    edges.set(["c", "b"], 2.0)
    assert edges.events() == [
        ButtonEvent(1.0, "a", True),
        ButtonEvent(2.0, "a", False),
        ButtonEvent(2.0, "c", True),
        ButtonEvent(2.0, "b", True),
    ]
    assert edges.events() == []


@given(st.lists(LABELS))
def test_edges_rebuild_what_is_held(states):
    edges, held = ButtonEdges(), set()
    for now_s, labels in enumerate(states):
        edges.set(labels, now_s)
        for event in edges.events():
            assert (event.button in held) is not event.pressed
            (held.add if event.pressed else held.remove)(event.button)
        assert held == set(labels) == edges.held


def test_release_all():
    edges = ButtonEdges()
    edges.set(["a", "b"], 1.0)
    edges.release_all(2.0)
    assert edges.held == frozenset()
    assert [event.pressed for event in edges.events()] == [True, True, False, False]


def test_a_button_held_through_a_loss_counts_once_it_was_seen_up():
    edges = ButtonEdges()
    edges.set(["a"], 1.0)
    edges.release_all(2.0)
    edges.set(["a", "b"], 3.0)
    assert edges.held == {"b"}
    assert edges.masked == {"a"}
    edges.set(["b"], 4.0)
    assert edges.masked == frozenset()
    edges.set(["a", "b"], 5.0)
    assert edges.held == {"a", "b"}
    assert [event for event in edges.events() if event.button == "a"] == [
        ButtonEvent(1.0, "a", True),
        ButtonEvent(2.0, "a", False),
        ButtonEvent(5.0, "a", True),
    ]


def test_what_a_missing_consumer_loses_is_counted(monkeypatch):
    monkeypatch.setattr(buttons, "MAX_EVENTS", 4)
    edges = ButtonEdges()
    for number in range(5):
        edges.set(["a"] if number % 2 == 0 else [], number)
    assert edges.lost_edges == 1
