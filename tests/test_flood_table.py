"""The table of floods in docs/faults.md, and some of its cells measured anew."""

import pytest

from tests import flood_table
from tests.docs_tables import END
from tests.fault_table import PAGE
from tests.flood_table import BEGIN, ENDS, LATE_S, RATES, SERVERS


def written():
    """Server, rate and cells of each row that the page has."""
    _, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    lines = [each for each in rest.partition(END)[0].splitlines() if each.startswith("| ")]
    return [[cell.strip() for cell in each.strip("|").split("|")] for each in lines]


def test_the_table_has_all_servers_rates_and_ends():
    head, *found = written()
    assert tuple(head[2:]) == ENDS
    assert [(name, float(rate)) for name, rate, *_ in found] == [
        (name, rate) for name in SERVERS for rate in RATES
    ]


def test_what_is_passed_on_after_the_last_byte_is_in_time():
    for _, _, *cells in written()[1:]:
        for cell in cells:
            assert float(cell.rstrip("*")) <= 1e3 * LATE_S


@pytest.mark.matrix
@pytest.mark.timeout(120)
@pytest.mark.parametrize("name", SERVERS)
def test_a_flood_moves_nothing_late(name):
    for row in flood_table.rows([name], [10.0], ["silence", "server stopped for 1 s"]):
        assert row.late_s <= LATE_S + 0.1, row
        assert row.passed, row
