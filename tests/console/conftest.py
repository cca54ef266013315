"""Fixtures shared by all tests of the console page: browser, robot, its session and the server.
They end with the last of these tests, because a browser draws for as long as it runs."""

from __future__ import annotations

import pytest

from tests.console.browser import chromium, find_chromium


@pytest.fixture(scope="package")
def built():
    """Build of the page; skips if it is missing."""
    from cardan.errors import ConfigurationError
    from cardan.gateway.servers.console.site import Site

    try:
        return Site()
    except ConfigurationError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="package")
def browser(tmp_path_factory):
    """Browser for all tests; each test opens its own pages."""
    program = find_chromium()
    if program is None:
        pytest.skip("no Chromium is installed: tools/debian-packages judges")
    with chromium(program, tmp_path_factory.mktemp("chromium")) as browser:
        yield browser


@pytest.fixture(scope="package")
def bench(built, browser, tmp_path_factory):
    """A robot, its session, the server, and a proxy between server and browser."""
    from tests.console.hold_table import bench

    with bench(browser, tmp_path_factory.mktemp("session")) as made:
        yield made


@pytest.fixture
def page(bench, browser):
    """A page for one test, which shows the arm."""
    from tests.console.page_input import RELOADED

    with browser.open(bench.address) as page:
        page.until(RELOADED)
        yield page
