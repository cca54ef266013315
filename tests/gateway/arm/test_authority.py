"""Authority over the arm: one source at a time, for as long as it renews its lease."""

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from cardan.errors import ConfigurationError, OptionError
from cardan.gateway.arm.states import LEASE_S, Authority, AuthorityOptions, AuthorityPolicy
from cardan.gateway.arm.status import OPERATOR, VERBS
from cardan.types import NEVER_S


def owned_by(source, policy=AuthorityPolicy.FIRST, named="", now_s=10.0):
    authority = Authority(AuthorityOptions(policy=policy, named=named))
    assert authority.take(source, now_s) == ""
    return authority


def test_nobody_has_it_at_first():
    assert Authority().state() == ("", NEVER_S, "")


def test_it_is_taken_when_it_is_free_and_known_since_when():
    authority = owned_by("a")
    assert authority.owner == "a"
    assert authority.take("a", 11.0) == ""
    assert authority.state() == ("a", 10.0, "")


def test_who_is_refused_is_reported_and_remembered():
    authority = owned_by("a")
    assert authority.refuses("b") == "'a' has authority over the arm"
    assert authority.state().refused == ""
    assert authority.take("b", 10.1) == "'a' has authority over the arm"
    assert authority.state().refused == "b: 'a' has authority over the arm"
    assert authority.owner == "a"


def test_a_lease_that_is_not_renewed_ends():
    authority = owned_by("a")
    authority.expire(10.0 + LEASE_S, busy=False)
    assert authority.owner == "a"
    authority.expire(10.0 + LEASE_S + 1e-3, busy=False)
    assert authority.owner == ""
    assert authority.take("b", 13.0) == ""


def test_a_refused_attempt_renews_nothing():
    authority = owned_by("a")
    authority.take("b", 11.9)
    authority.expire(12.1, busy=False)
    assert authority.owner == ""


def test_an_owner_whose_motion_is_under_way_keeps_it_and_a_lease_longer():
    authority = owned_by("a")
    authority.expire(100.0, busy=True)
    assert authority.owner == "a"
    authority.expire(100.0 + LEASE_S, busy=False)
    assert authority.owner == "a"
    authority.expire(100.1 + LEASE_S, busy=False)
    assert authority.owner == ""


def test_only_the_owner_gives_it_up():
    authority = owned_by("a")
    authority.release("b")
    assert authority.owner == "a"
    authority.release("a")
    assert authority.owner == ""


def test_a_network_that_is_named_is_each_of_its_nodes():
    authority = Authority(AuthorityOptions(policy=AuthorityPolicy.NAMED, named="ros2"), "ros2")
    for other in ("ros2x /joystick", "ros2-joystick", "ros2 joystick", "/joystick", "pendant"):
        assert "reserved for 'ros2'" in authority.refuses(other)
    for node in ("ros2", "ros2 /left/joystick", "ros2 #3f9a01bc"):
        assert authority.refuses(node) == ""
    assert authority.take("ros2 /joystick", 10.0) == ""
    assert "'ros2 /joystick' has authority" in authority.refuses("ros2 /script")


@pytest.mark.parametrize(
    ("policy", "taken"), [(AuthorityPolicy.OPERATOR, True), (AuthorityPolicy.FIRST, False)]
)
def test_the_policy_says_whether_the_hand_takes_it_from_others(policy, taken):
    authority = owned_by(VERBS, policy)
    assert (authority.take(OPERATOR, 10.1) == "") is taken
    assert authority.owner == (OPERATOR if taken else VERBS)


@pytest.mark.parametrize("policy", [AuthorityPolicy.OPERATOR, AuthorityPolicy.FIRST])
def test_nobody_takes_it_from_the_hand(policy):
    authority = owned_by(OPERATOR, policy)
    assert "'device' has authority" in authority.take(VERBS, 10.1)


def test_where_it_is_reserved_only_who_is_named_has_it():
    authority = Authority(AuthorityOptions(policy=AuthorityPolicy.NAMED, named="pendant"))
    for other in (OPERATOR, VERBS):
        assert authority.take(other, 10.0) == "authority over the arm is reserved for 'pendant'"
    assert authority.take("pendant", 10.0) == ""
    assert "'pendant' has authority" in authority.take(OPERATOR, 10.1)


def test_handing_over_gives_it_to_exactly_one_other_and_starts_a_lease():
    authority = owned_by("a")
    assert authority.hand_over("a", "b", 11.0) == ""
    assert authority.state()[:2] == ("b", 11.0)
    assert "'b' has authority" in authority.take("a", 11.1)
    authority.expire(12.9, busy=False)
    assert authority.owner == "b"
    authority.expire(13.1, busy=False)
    assert authority.owner == ""


def test_only_who_has_it_hands_it_over():
    authority = owned_by("a")
    assert "'b' has no authority over the arm to hand over" in authority.hand_over("b", "c", 10.1)
    assert authority.owner == "a"
    nobodys = Authority()
    assert "no authority" in nobodys.hand_over("a", "b", 10.0)
    assert nobodys.owner == ""


def test_whom_the_named_source_trusts_has_it_until_the_lease_ends_and_no_longer():
    authority = owned_by("pendant", AuthorityPolicy.NAMED, "pendant")
    assert authority.hand_over("pendant", "guest", 10.0) == ""
    assert authority.take("guest", 11.0) == ""
    authority.expire(20.0, busy=False)
    assert authority.owner == ""
    assert "reserved for 'pendant'" in authority.take("guest", 20.0)


SOURCES = st.sampled_from((OPERATOR, VERBS, "a", "b"))


class OneOwner(RuleBasedStateMachine):
    """In any sequence of actions, only these four change the owner, each by its own rule."""

    policy = AuthorityPolicy.OPERATOR

    def __init__(self):
        super().__init__()
        named = "a" if self.policy is AuthorityPolicy.NAMED else ""
        self.authority = Authority(AuthorityOptions(policy=self.policy, named=named))
        self.owner, self.now_s, self.renewed_s = "", 10.0, NEVER_S

    @rule(source=SOURCES)
    def take(self, source):
        forecast = self.authority.refuses(source)
        refusal = self.authority.take(source, self.now_s)
        assert refusal == forecast
        if refusal:
            assert source != self.owner
            return
        by_hand = self.policy is AuthorityPolicy.OPERATOR and source == OPERATOR
        assert self.owner in ("", source) or by_hand
        self.owner, self.renewed_s = source, self.now_s

    @rule(source=SOURCES, to=SOURCES)
    def hand_over(self, source, to):
        refusal = self.authority.hand_over(source, to, self.now_s)
        assert (refusal == "") is (source == self.owner)
        if not refusal:
            self.owner, self.renewed_s = to, self.now_s

    @rule(source=SOURCES)
    def release(self, source):
        self.authority.release(source)
        if source == self.owner:
            self.owner = ""

    @rule(passes_s=st.floats(0.0, 1.5 * LEASE_S), busy=st.booleans())
    def time_passes(self, passes_s, busy):
        self.now_s += passes_s
        self.authority.expire(self.now_s, busy)
        if busy:
            self.renewed_s = self.now_s
        elif self.now_s - self.renewed_s > LEASE_S:
            self.owner = ""

    @invariant()
    def the_owner_is_who_it_was_given_to(self):
        assert self.authority.owner == self.owner == self.authority.state().owner
        if self.owner:
            may = [s for s in (OPERATOR, VERBS, "a", "b") if not self.authority.refuses(s)]
            by_hand = {OPERATOR} if self.policy is AuthorityPolicy.OPERATOR else set()
            assert set(may) == {self.owner} | by_hand


class OneOwnerFirst(OneOwner):
    policy = AuthorityPolicy.FIRST


class OneOwnerNamed(OneOwner):
    policy = AuthorityPolicy.NAMED


TestOneOwner = OneOwner.TestCase
TestOneOwnerFirst = OneOwnerFirst.TestCase
TestOneOwnerNamed = OneOwnerNamed.TestCase


def test_only_a_network_is_reserved_for_with_its_nodes():
    authority = Authority(AuthorityOptions(policy=AuthorityPolicy.NAMED, named="pendant"), "ros2")
    assert "reserved for 'pendant'" in authority.take("pendant /other", 0.0)
    assert "reserved for 'pendant'" in authority.take("pendant #1", 0.0)
    assert authority.take("pendant", 0.0) == ""
    authority = Authority(AuthorityOptions(policy=AuthorityPolicy.NAMED, named="ros2"))
    assert authority.take("ros2 /joystick", 0.0)
    authority = Authority(AuthorityOptions(policy=AuthorityPolicy.NAMED, named="ros2"), "ros2")
    assert authority.take("ros2 /joystick", 0.0) == ""


@pytest.mark.parametrize(
    ("policy", "named"),
    [
        (AuthorityPolicy.NAMED, ""),
        (AuthorityPolicy.OPERATOR, "pendant"),
        (AuthorityPolicy.FIRST, OPERATOR),
    ],
)
def test_the_policy_that_reserves_it_says_for_whom_and_no_other_does(policy, named):
    with pytest.raises(ConfigurationError, match='policy = "named" needs the source'):
        AuthorityOptions(policy=policy, named=named)


@pytest.mark.parametrize("lease_s", [0.0, -1.0, 10.1, float("nan"), float("inf")])
def test_a_lease_that_never_ends_or_at_once_is_refused(lease_s):
    with pytest.raises(OptionError, match="lease_s"):
        AuthorityOptions(lease_s=lease_s)
