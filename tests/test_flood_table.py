"""Table of floods in tests/results/floods.md, with some cells measured again."""

import pytest

from tests import flood_table
from tests.flood_table import ENDS, NONE, RATES, REST_S, RESULTS, SERVERS, WITHOUT


def test_the_table_has_all_servers_rates_and_ends():
    head, *found = RESULTS.rows()
    assert tuple(head[2:]) == ENDS
    assert [(name, float(rate)) for name, rate, *_ in found] == [
        (name, rate) for name in SERVERS for rate in RATES
    ]


def test_the_arm_is_at_rest_in_time_after_the_last_byte():
    for name, _, *cells in RESULTS.rows()[1:]:
        for end, cell in zip(ENDS, cells, strict=True):
            assert (cell == NONE) == ((name, end) in WITHOUT)
            if cell != NONE:
                assert float(cell.strip("*")) <= 1e3 * REST_S, (name, end)


@pytest.mark.matrix
@pytest.mark.parametrize("name", SERVERS)
def test_a_flood_moves_nothing_late(name):
    if name == "Foxglove":
        pytest.importorskip("cardan_foxglove", reason="pip install ./plugins/cardan-foxglove")
    for row in flood_table.rows([name], [10.0], ["silence", "server stopped for 1 s"]):
        # Time without a processor does not count as the server's delay.
        assert row.late_s <= REST_S + 0.1 + row.waited_s, row
        assert row.moved_s, row
