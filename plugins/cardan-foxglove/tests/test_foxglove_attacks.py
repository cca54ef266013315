"""Attempts of unauthorized clients at the Foxglove server; docs/safety-and-access.md.

The tests are those of the other servers; those marked ``real`` there are marked ``matrix`` here.
"""

from __future__ import annotations

import pytest

pytest.importorskip("foxglove", reason="foxglove-sdk: pip install ./plugins/cardan-foxglove")

from foxglove_pair import foxglove_server
from tests.gateway.servers.memory_network import MemoryNetwork
from tests.gateway.servers.test_attacks import (  # noqa: F401 - fixtures and tests
    UPGRADE,
    Target,
    certificate,
    running,
    test_a_replayed_handshake_comes_in_nowhere,
    test_a_right_token_comes_in_by_the_header,
    test_as_many_as_come_at_once_are_kept_by_the_system,
    test_connections_that_speak_no_tls_are_hung_up_on,
    test_foreign_pages_and_names_stay_out_even_with_the_token,
    test_garbage_and_what_is_too_long_is_refused,
    test_guesses_are_counted,
    test_many_connections_keep_nobody_out,
    test_old_tls_is_not_spoken,
    test_plain_requests_to_tls_are_not_answered,
    test_what_a_refused_client_sends_later_is_not_heard,
    test_who_says_a_little_all_the_time_is_hung_up_on,
    test_who_says_nothing_is_hung_up_on,
    test_wrong_tokens_and_none,
)

pytestmark = pytest.mark.matrix


@pytest.fixture
def target():
    return Target(
        lambda **o: foxglove_server(MemoryNetwork(), **o), "/", UPGRADE, 101, ("foxglove.sdk.v1",)
    )
