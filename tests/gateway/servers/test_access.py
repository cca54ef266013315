"""Access by tokens, and the rate limit of token guesses, in virtual time."""

from __future__ import annotations

import pytest

from cardan.gateway.servers.access import AccessControl, AccessDenied, ClientInfo
from cardan.gateway.servers.rate_limit import (
    ADDRESS_BURST,
    ADDRESS_FORGOTTEN_S,
    BEGINNING_CHARACTERS,
    BURST,
    FORGOTTEN_S,
    MOST_BEGINNINGS,
    FailedTokens,
)
from cardan.gateway.servers.tokens import WITHOUT_TOKEN, Role, Tokens

VIEWER, OPERATOR, ADMIN = "viewers-0123456789", "operators-0123456789", "admins-0123456789"
TOKENS = Tokens({VIEWER: Role.VIEWER, OPERATOR: Role.OPERATOR, ADMIN: Role.ADMIN})


def asked(path="/", address="10.0.0.2", bearer=None):
    authorizations = [] if bearer is None else [bearer]
    return ClientInfo(address, path, ["localhost"], [], authorizations)


def door(tokens=TOKENS):
    return AccessControl(tokens, (), ())


@pytest.mark.parametrize(
    ("caller", "role"),
    [
        (asked(f"/?t={VIEWER}"), Role.VIEWER),
        (asked(f"/{OPERATOR}"), Role.OPERATOR),
        (asked(bearer=f"Bearer {ADMIN}"), Role.ADMIN),
        (asked(bearer=f"bearer  {ADMIN} "), Role.ADMIN),
        (asked(f"/?token={ADMIN}", bearer="Basic abc"), Role.ADMIN),
    ],
)
def test_a_token_says_the_role(caller, role):
    assert door().check(caller, 0.0) is role


def test_the_first_token_that_is_known_counts():
    assert door().check(asked(f"/?t={ADMIN}", bearer=f"Bearer {VIEWER}"), 0.0) is Role.VIEWER


@pytest.mark.parametrize(
    "caller",
    [
        asked(),
        asked("/?t="),
        asked(f"/?t={ADMIN}x"),
        asked(f"/?t={ADMIN[:-1]}"),
        asked(bearer=ADMIN),
        asked(bearer=f"Basic {ADMIN}"),
        asked(bearer="Bearer"),
        asked(bearer="Bearer \udcff"),
        asked("//["),
    ],
)
def test_without_one_nobody_comes_in_and_no_token_is_said(caller):
    denied = door().check(caller, 0.0)
    assert isinstance(denied, AccessDenied)
    assert denied.status == 401
    assert "0123456789" not in denied.reason


def test_where_no_token_is_needed_all_are_operators():
    assert door(Tokens({})).check(asked("/whatever"), 0.0) is WITHOUT_TOKEN is Role.OPERATOR


def test_guessing_is_slow():
    one, wrong = door(), asked("/?t=guess-0123456789")
    for _ in range(BURST):
        assert one.check(wrong, 5.0).status == 401
    denied = one.check(wrong, 5.0)
    assert denied.status == 429
    assert denied.retry_s == pytest.approx(FORGOTTEN_S)
    assert one.check(asked("/?t=guess-01-another"), 5.0).status == 429, "a similar token, too"
    assert one.check(asked(f"/?t={ADMIN}"), 5.0) is Role.ADMIN, "other tokens are accepted"
    assert one.check(asked(), 5.0).status == 401, "no token, no guess"
    assert one.check(asked("/?t=guess-0123456789", "10.0.0.3"), 5.0).status == 401
    long_s = 100 * int(FORGOTTEN_S)
    tried = sum(one.check(wrong, 100.0 + at_s).status == 401 for at_s in range(long_s))
    assert tried <= long_s / FORGOTTEN_S + BURST


def test_who_knows_how_a_token_begins_guesses_the_rest_slowly():
    one = door()
    for number in range(BURST):
        assert one.check(asked(f"/?t={ADMIN[:8]}{number}"), 5.0).status == 401
    assert one.check(asked(f"/?t={ADMIN}"), 5.0).status == 429, "the right one, too"
    assert one.check(asked(f"/?t={ADMIN}"), 5.0 + FORGOTTEN_S) is Role.ADMIN


def test_wrong_ones_of_any_beginning_are_bounded_and_hold_up_no_right_one():
    one = door()
    answers = [
        one.check(asked(f"/?t={number:08}-guess-67"), 5.0).status
        for number in range(2 * ADDRESS_BURST)
    ]
    assert answers == [401] * ADDRESS_BURST + [429] * ADDRESS_BURST
    assert one.check(asked(f"/?t={ADMIN[:8]}-wrong"), 5.0).status == 429, "no sign of a beginning"
    assert one.check(asked(f"/?t={ADMIN}"), 5.0) is Role.ADMIN
    later_s = 5.0 + ADDRESS_FORGOTTEN_S
    assert one.check(asked("/?t=another--guess-67"), later_s).status == 401


@pytest.mark.matrix
def test_other_beginnings_do_not_displace_the_count_of_a_right_one():
    one = door()
    for number in range(BURST):
        assert one.check(asked(f"/?t={ADMIN[:8]}{number}"), 5.0).status == 401
    for number in range(2 * MOST_BEGINNINGS):
        address = f"10.2.{number % 100}.1"
        one.check(asked(f"/?t={number:08}-guess-67", address), 5.0)
        one.check(asked(f"/?t={number:08}-guess-67"), 5.0)
    assert one.check(asked(f"/?t={ADMIN}"), 5.0).status == 429


def test_each_token_of_a_request_is_a_guess():
    one = door()
    many = "&".join(f"t=guess-01{number}" for number in range(BURST))
    assert one.check(asked(f"/?{many}"), 5.0).status == 401
    assert one.check(asked("/?t=guess-0123456789"), 5.0).status == 429


def test_what_is_in_no_token_s_way_is_no_guess():
    one = door()
    for _ in range(2 * BURST):
        assert one.check(asked("/?t=x")._replace(origins=["https://evil.example"]), 0.0).status
        assert one.check(asked(f"/?t={VIEWER}"), 0.0) is Role.VIEWER
    assert len(one._failed) == 0


def test_addresses_are_forgotten_before_they_fill_the_memory():
    failed = FailedTokens(burst=1, most_beginnings=100)
    for number in range(10_000):
        failed.failed(f"10.1.{number // 256}.{number % 256}", "guess", 0.0)
        assert len(failed) <= 100
    assert failed.wait_s("10.1.39.15", "guess", 0.0) > 0.0
    assert failed.wait_s("10.1.0.0", "guess", 0.0) == 0.0


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("2001:db8::1", "2001:db8::ffff:1", True),
        ("2001:db8::1", "2001:db8::8000:0:0:1", True),
        ("2001:db8::1", "2001:db8:0:1::1", False),
        ("10.0.0.1", "::ffff:10.0.0.1", True),
        ("fe80::1%eth0", "fe80::2%eth0", True),
        ("10.0.0.1", "10.0.0.2", False),
    ],
)
def test_one_address_is_what_one_computer_can_choose(one, other, same):
    failed = FailedTokens(burst=1)
    failed.failed(one, "guess", 0.0)
    assert (failed.wait_s(other, "guess", 0.0) > 0.0) is same


def by_name(said=("localhost",), origins=(), public=True, hosts=(), pages=()):
    caller = ClientInfo("10.0.0.2", "/", said, origins)
    one = AccessControl(TOKENS, hosts, pages)
    return one.check(caller, 0.0, public=public)


def test_what_is_public_needs_no_token_and_gives_no_more_than_a_viewer_has():
    assert by_name() is Role.VIEWER
    assert by_name(public=False).status == 401


@pytest.mark.parametrize("hosts", [(), ("localhost", "localhost"), ("",), ("[",)])
def test_a_request_says_one_name(hosts):
    denied = by_name(hosts)
    assert denied.status == 400
    assert "one Host header" in denied.reason


@pytest.mark.parametrize("host", ["LOCALHOST:8080", "127.0.0.1", "[::1]:80", "10.0.0.7", "Arm.Lab"])
def test_names_and_addresses_of_this_machine_come_in(host):
    assert by_name((host,), hosts=["aRm.lab"]) is Role.VIEWER


def test_a_foreign_name_that_resolves_to_this_machine_does_not():
    denied = by_name(("rebound.example",), hosts=["arm.lab"])
    assert denied.status == 403
    assert "the Host header names another server" in denied.reason


@pytest.mark.parametrize(
    ("host", "origin"),
    [
        ("localhost:8080", "http://localhost:8080"),
        ("localhost", "http://127.0.0.1"),
        ("10.0.0.7", "https://10.0.0.7"),
        ("10.0.0.7", "https://app.example"),
        ("10.0.0.7", "NULL"),
    ],
)
def test_own_pages_and_those_that_the_options_allow_come_in(host, origin):
    pages = ["https://App.example/", "null"]
    assert by_name((host,), (origin,), pages=pages) is Role.VIEWER


@pytest.mark.parametrize(
    ("host", "origins"),
    [
        ("localhost", ["https://evil.example"]),
        ("localhost", ["null"]),
        ("localhost", ["http://10.0.0.7"]),
        ("10.0.0.7", ["http://localhost"]),
        ("10.0.0.7", ["http://10.0.0.8"]),
        ("localhost", ["http://localhost", "http://localhost"]),
        ("localhost", ["http://localhost", "https://evil.example"]),
    ],
)
def test_other_pages_do_not_nor_who_says_two(host, origins):
    denied = by_name((host,), origins)
    assert denied.status == 403
    assert origins[-1] in denied.reason


def test_one_that_must_wait_among_others_waits():
    one = door()
    for number in range(BURST):
        one.check(asked(f"/?t=guess-01{number}"), 5.0)
    assert one.check(asked(f"/?t=guess-01234&t={ADMIN}"), 5.0).status == 429


def test_who_gives_none_is_informed_whatever_was_guessed():
    one = door()
    for number in range(ADDRESS_BURST):
        one.check(asked(f"/?t={number:08}-guess-67"), 5.0)
    assert one.check(asked("/?t=another-guess"), 5.0).status == 429
    assert one.check(asked(), 5.0).status == 401


def test_what_can_be_no_token_is_a_guess_too():
    one = door()
    one.check(asked(bearer=f"Bearer {ADMIN} and more words"), 5.0)
    assert len(one._failed) == 1


def test_the_bounds_of_guessing():
    """docs/safety-and-access.md and the docstrings promise: at most 8640 guesses a day at half a
    token, and one guess a second at any."""
    assert (BURST, FORGOTTEN_S) == (20, 10.0)
    assert (ADDRESS_BURST, ADDRESS_FORGOTTEN_S) == (200, 1.0)
    assert (BEGINNING_CHARACTERS, MOST_BEGINNINGS) == (8, 4096)


def test_a_wrong_one_is_forgotten():
    failed = FailedTokens(burst=1)
    failed.failed("10.0.0.1", "guess", 0.0)
    assert failed.wait_s("10.0.0.1", "guess", 4.0) == pytest.approx(FORGOTTEN_S - 4.0)
    assert failed.wait_s("10.0.0.1", "guess", 3 * FORGOTTEN_S) == 0.0


def test_that_tried_least_lately_gives_way():
    failed = FailedTokens(burst=1, most_beginnings=2)
    for token in ("a", "b", "a", "c"):
        failed.failed("10.0.0.1", token, 0.0)
    assert len(failed) == 2
    waits = [failed.wait_s("10.0.0.1", token, 0.0) > 0.0 for token in ("a", "b", "c")]
    assert waits == [True, False, True]


def test_beginnings_of_right_ones_are_counted_apart_and_always():
    failed = FailedTokens(burst=1, most_beginnings=2, right={"right-01"})
    failed.failed("10.0.0.1", "right-01x", 0.0)
    for number in range(ADDRESS_BURST):
        failed.failed("10.0.0.1", f"{number:08}", 0.0)
    assert failed.wait_s("10.0.0.1", "right-01y", 0.0) > 0.0, "not displaced"
    assert failed.wrong_wait_s("10.0.0.1", 0.0) > 0.0
    failed.failed("10.0.0.1", "right-01z", FORGOTTEN_S / 2)
    failed.failed("10.0.0.2", "x", 0.0)
    assert failed.wait_s("10.0.0.1", "right-01y", FORGOTTEN_S) > 0.0
    for number in range(ADDRESS_BURST):
        failed.failed("10.0.0.3", f"{number:08}", 0.0)
    failed.failed("10.0.0.3", "other-01", 0.0)
    assert failed.wait_s("10.0.0.3", "other-01", 0.0) == 0.0, "the token was not counted"
    failed.failed("10.0.0.3", "right-01", 0.0)
    assert failed.wait_s("10.0.0.3", "right-01", 0.0) > 0.0
