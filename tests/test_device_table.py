"""The table of what was shown is what the tests show."""

from tests import device_table, docs_tables, test_device_faults


def test_the_page_has_the_table_that_the_tests_make():
    page = device_table.PAGE.read_text(encoding="utf-8")
    assert device_table.table() in page, "make device-table writes it anew"


def test_the_page_has_the_times_that_the_tests_measure():
    page = device_table.PAGE.read_text(encoding="utf-8")
    assert test_device_faults.table() in page, "make device-table writes it anew"


def test_every_device_has_its_line_on_the_page():
    page = device_table.PAGE.read_text(encoding="utf-8")
    assert [name for name in docs_tables.DEVICES if f"| `{name}` |" not in page] == []
