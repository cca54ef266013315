"""Table of devices: each has its row, and the page has the measured times."""

from tests import docs_tables, site_tables, test_device_faults

PAGE = site_tables.read("docs/devices.md")


def test_the_page_has_the_times_that_the_tests_measure():
    assert test_device_faults.table() in PAGE, "make device-table rewrites it"


def test_every_device_has_its_line_on_the_page():
    assert [name for name in docs_tables.DEVICES if f"| `{name}` |" not in PAGE] == []
