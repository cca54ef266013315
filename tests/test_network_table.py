"""Table of judges on the network: it has exactly the contents of the tests' marks."""

import pytest

from tests import network_table
from tests.network_table import Coverage, Row

ROWS = [
    Row("~/state/pose", "published", "geometry_msgs/msg/PoseStamped"),
    Row("~/command/twist", "taken", "geometry_msgs/msg/Twist"),
    Row("~/stop", "service", "std_srvs/srv/Trigger"),
]


def test_a_mark_is_of_kinds_without_some_or_of_names():
    pose, twist, stop = ROWS
    assert Coverage("DDS", "x", ("published", "taken")).rows(ROWS) == [pose, twist]
    assert Coverage("DDS", "x", ("published", "taken"), but=(twist.name,)).rows(ROWS) == [pose]
    assert Coverage("DDS", "x", names=(stop.name,)).rows(ROWS) == [stop]


@pytest.mark.parametrize(
    "mark",
    [
        Coverage("DDS", "x", names=("~/nothing",)),
        Coverage("DDS", "x", ("taken",), but=("~/nothing",)),
        Coverage("DDS", "x", ("nothing",)),
        Coverage("nothing", "x", ("taken",)),
    ],
)
def test_a_mark_of_what_there_is_not_is_refused(mark):
    with pytest.raises(ValueError, match=r"there is no .*nothing"):
        network_table.checked([mark], ROWS)


def test_a_session_has_what_its_tables_declare():
    names = {row.name: row for row in network_table.rows()}
    assert names["~/state/pose"].kind == "published"
    assert names["servo_node/delta_twist_cmds"].kind == "taken"
    assert names["~/action/movl"] == Row("~/action/movl", "action", "cardan_msgs/action/MovePose")
    assert not any(network_table.ACTION_PARTS in name for name in names)
