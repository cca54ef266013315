"""A network within the test, and a console with tokens."""

import pytest

from tests.gateway.servers.console.bench import OPERATOR, console, page_program, token_file
from tests.gateway.servers.memory_network import MemoryNetwork


@pytest.fixture
def network():
    return MemoryNetwork()


@pytest.fixture
def with_tokens(network, tmp_path):
    """A console for a viewer and an operator."""
    with console(network, tmp_path, token_file=token_file(tmp_path)) as running:
        yield running


@pytest.fixture
def operator(with_tokens):
    """An operator's page."""
    with page_program(with_tokens, f"/ws?t={OPERATOR}") as page:
        page.begin()
        yield page
