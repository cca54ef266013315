"""Tables of drivers, simulated peers and demos in the pages equal the declarations."""

import pytest

from cardan.cli.common import page_path
from cardan.demos.examples import find_demos
from cardan.drivers import registry as drivers
from cardan.drivers.base import OperatorDevice
from cardan.sim_peers import registry as peers
from tests import docs_tables


@pytest.mark.parametrize(("page", "name"), docs_tables.TABLES)
def test_the_page_has_the_table_as_it_is_declared(page, name):
    text = (docs_tables.ROOT / page).read_text(encoding="utf-8")
    made = docs_tables.TABLES[page, name]()
    marker = docs_tables.begin(name)
    assert docs_tables.replaced(text, marker, made) == text, "make docs-tables rewrites it"


@pytest.mark.parametrize("name", docs_tables.DRIVERS)
def test_every_driver_declares_what_the_lists_say(name):
    driver = drivers.load(name)
    assert driver.summary
    assert (docs_tables.ROOT / page_path(driver.page)).is_file()
    assert driver.peer in peers.names()
    if issubclass(driver, OperatorDevice):
        assert driver.gives
        assert driver.suits


@pytest.mark.parametrize("name", docs_tables.DRIVERS)
def test_every_driver_has_a_demo_that_its_page_names(name):
    page = (docs_tables.ROOT / page_path(drivers.load(name).page)).read_text(encoding="utf-8")
    demos = [each for each, demo in find_demos().items() if name in demo.drivers]
    assert any(f"`cardan demo {each}`" in page for each in demos), demos


@pytest.mark.parametrize("name", docs_tables.ours(peers))
def test_every_peer_declares_what_the_lists_say(name):
    peer = peers.load(name)
    assert (peer.__doc__ or "").endswith(".")
    assert peer.speaks
    assert (docs_tables.ROOT / page_path(peer.page)).is_file()


def test_a_page_without_the_marks_is_refused():
    with pytest.raises(ValueError, match="there is no <!-- made by"):
        docs_tables.replaced("text\n", docs_tables.begin("nothing"), "")
