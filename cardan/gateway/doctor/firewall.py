"""Checks whether a firewall lets in what UDP controllers send.

Rules are read where the user may read them, from nftables or iptables, and followed for one new
packet to one port; what cannot be judged of a rule (an address, a mark) makes it one that may hold.
"""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from enum import Enum
from typing import Any, Final, NamedTuple

from cardan.gateway.doctor.base import Check, Finding, Subject, caution, good
from cardan.sockets import is_loopback

GROUP = "firewall"

_MOST_JUMPS: Final = 16
_NO_TRAFFIC_YET: Final = frozenset({"established", "related", "invalid", "untracked"})
"""States of a connection that a first datagram does not have."""


class Verdict(str, Enum):
    """What becomes of a packet."""

    LET_IN = "let in"
    DROPPED = "dropped"
    MAYBE = "let in from some"
    """It depends on where it comes from, or on what is not judged here."""


class Rule(NamedTuple):
    """One rule, for the packet in question."""

    holds: bool | None
    """Whether its conditions are met; None: that cannot be judged."""
    action: str
    """ "accept", "drop", "return", "jump NAME", or "" for what ends nothing."""


class Chain(NamedTuple):
    """A list of rules."""

    rules: tuple[Rule, ...]
    policy: str = ""
    """What a base chain does at its end: "accept" or "drop"; empty: it is no base chain."""


def judge(chains: Mapping[str, Chain]) -> Verdict:
    """What becomes of the packet: it has to pass every base chain."""
    found = {_follow(name, chains) for name, each in chains.items() if each.policy}
    if Verdict.DROPPED in found:
        return Verdict.DROPPED
    return Verdict.MAYBE if Verdict.MAYBE in found else Verdict.LET_IN


def _follow(name: str, chains: Mapping[str, Chain]) -> Verdict:
    ended, maybe = _walk(name, chains, 0)
    if ended == "drop":
        return Verdict.MAYBE if "accept" in maybe else Verdict.DROPPED
    return Verdict.MAYBE if "drop" in maybe else Verdict.LET_IN


def _walk(name: str, chains: Mapping[str, Chain], depth: int) -> tuple[str, set[str]]:
    """How a chain ends ("accept", "drop", or "" to go on) and how it may have ended before."""
    maybe: set[str] = set()
    chain = chains.get(name)
    if chain is None or depth > _MOST_JUMPS:
        return "", maybe
    for rule in chain.rules:
        if rule.holds is False or not rule.action:
            continue
        action, _, target = rule.action.partition(" ")
        if action in ("jump", "goto"):
            ended, inside = _walk(target, chains, depth + 1)
            maybe |= inside
            action = ended
        elif action == "return" and rule.holds:
            break
        if action not in ("accept", "drop"):
            continue
        if rule.holds:
            return action, maybe
        maybe.add(action)
    return chain.policy, maybe


# -- nftables -------------------------------------------------------------------------------------


def read_nftables(text: str, port: int) -> dict[str, Chain]:
    """The chains of `nft -j list ruleset`, for a new UDP packet to `port`; none where the text is
    of another form."""
    try:
        items = json.loads(text)["nftables"]
        chains = [each["chain"] for each in items if "chain" in each]
        rules = [each["rule"] for each in items if "rule" in each]
    except (ValueError, KeyError, TypeError, RecursionError):
        return {}
    found: dict[str, Chain] = {}
    for each in chains:
        if each.get("family") not in ("ip", "inet"):
            continue
        table = f"{each['family']}/{each.get('table')}/"
        policy = each.get("policy", "accept") if each.get("hook") == "input" else ""
        found[f"{table}{each.get('name')}"] = Chain(
            tuple(
                _nft_rule(rule.get("expr", ()), table, port)
                for rule in rules
                if (rule.get("family"), rule.get("table"), rule.get("chain"))
                == (each["family"], each.get("table"), each.get("name"))
            ),
            policy,
        )
    return found


def _nft_rule(parts: Sequence[Any], table: str, port: int) -> Rule:
    holds: bool | None = True
    action = ""
    for part in parts:
        if not isinstance(part, dict):
            continue
        for key, value in part.items():
            if key == "match":
                one = _nft_match(value, port)
                holds = False if one is False or holds is False else (holds and one)
            elif key in ("accept", "drop", "return"):
                action = key
            elif key == "reject":
                action = "drop"
            elif key in ("jump", "goto") and isinstance(value, dict):
                action = f"{key} {table}{value.get('target')}"
            elif key == "vmap":
                holds, action = None, action or "accept"
    return Rule(holds, action)


def _nft_match(match: Any, port: int) -> bool | None:
    """Whether a condition holds; None: not judged."""
    if not isinstance(match, dict):
        return None
    left, right, negated = match.get("left"), match.get("right"), match.get("op") == "!="
    found: bool | None = None
    if isinstance(left, dict):
        of = left.get("payload") or left.get("meta") or left.get("ct") or {}
        if not isinstance(of, dict):
            return None
        what = (of.get("protocol"), of.get("field")) if "payload" in left else of.get("key")
        if what in (("udp", "dport"), ("th", "dport")):
            found = _has_port(right, port)
        elif isinstance(what, tuple) and what[0] in ("tcp", "icmp", "icmpv6", "sctp", "ip6"):
            found = False
        elif what in ("l4proto", ("ip", "protocol")):
            found = _has(right, "udp")
        elif what in ("iif", "iifname"):
            found = False if right == "lo" else None
        elif what == "state" and "ct" in left:
            found = _has(right, "new")
    return found if found is None else found != negated


def _has(right: Any, wanted: str) -> bool:
    return wanted in _members(right)


def _members(right: Any) -> list[Any]:
    if isinstance(right, dict):
        right = right.get("set", ())
    return list(right) if isinstance(right, (list, tuple)) else [right]


def _has_port(right: Any, port: int) -> bool | None:
    """None for a set by name, whose members stand elsewhere."""
    if isinstance(right, str) and right.startswith("@"):
        return None
    if isinstance(right, dict) and "range" in right:
        return _in_range(right["range"], port)
    return any(
        _in_range(each["range"], port)
        if isinstance(each, dict) and "range" in each
        else each == port
        for each in _members(right)
    )


def _in_range(ends: Any, port: int) -> bool:
    try:
        low, high = ends
        return int(low) <= port <= int(high)
    except (TypeError, ValueError):
        return False


# -- iptables -------------------------------------------------------------------------------------

_IPTABLES_ACTIONS: Final = {
    "ACCEPT": "accept",
    "DROP": "drop",
    "REJECT": "drop",
    "RETURN": "return",
}
_ENDS_NOTHING: Final = frozenset({"LOG", "NFLOG", "MARK", "CONNMARK", "AUDIT", "TRACE"})


def read_iptables(text: str, port: int) -> dict[str, Chain]:
    """The chains of `iptables -S`, for a new UDP packet to `port`."""
    policies: dict[str, str] = {}
    rules: dict[str, list[Rule]] = {}
    for line in text.splitlines():
        try:
            words = shlex.split(line)
        except ValueError:
            continue
        if len(words) < 2:
            continue
        if words[0] == "-P" and len(words) > 2:
            rules.setdefault(words[1], [])
            if words[1] == "INPUT":
                policies["INPUT"] = _IPTABLES_ACTIONS.get(words[2], "drop")
        elif words[0] == "-N":
            rules.setdefault(words[1], [])
        elif words[0] == "-A":
            rules.setdefault(words[1], []).append(_iptables_rule(words[2:], port))
    return {name: Chain(tuple(each), policies.get(name, "")) for name, each in rules.items()}


def _iptables_rule(words: Sequence[str], port: int) -> Rule:
    holds: bool | None = True
    action, negated, at = "", False, 0
    while at < len(words):
        word, value = words[at], words[at + 1] if at + 1 < len(words) else ""
        at += 2
        if word == "!":
            negated, at = True, at - 1
            continue
        one: bool | None
        if word in ("-j", "-g"):
            known = "" if value in _ENDS_NOTHING else f"jump {value}"
            action = _IPTABLES_ACTIONS.get(value, known)
            continue
        if word in ("-m", "--reject-with", "--comment", "--log-prefix", "--log-level"):
            continue
        if word == "-p":
            one = value in ("udp", "all", "17")
        elif word in ("--dport", "--dports"):
            one = any(_in_range(_ends(each), port) for each in value.split(","))
        elif word in ("--ctstate", "--state"):
            one = not set(value.lower().split(",")) <= _NO_TRAFFIC_YET
        elif word == "-i":
            one = False if value == "lo" else None
        else:
            one = None
        if one is not None and negated:
            one = not one
        negated = False
        holds = False if one is False or holds is False else (holds and one)
    return Rule(holds, action)


def _ends(text: str) -> tuple[str, str]:
    low, colon, high = text.partition(":")
    return low, high if colon else low


# -- the check ------------------------------------------------------------------------------------


def judge_firewall(
    ports: Iterable[tuple[str, int]], verdicts: Mapping[int, Verdict | None], active: str
) -> Iterator[Finding]:
    """Whether controllers are heard. `ports`: who listens at which UDP port; `verdicts`: by port,
    None where the rules cannot be read; `active`: the name of a firewall that is on, or empty."""
    for who, port in ports:
        verdict = verdicts[port]
        why = f"{who} listens there, and the controller sends first: it is never heard"
        if verdict is Verdict.LET_IN:
            yield good("firewall", f"no rule keeps UDP port {port} closed")
        elif verdict is None and not active:
            yield good(
                "firewall",
                f"UDP port {port}: no rules can be read (nft, iptables; the superuser may), and "
                "neither ufw nor firewalld is on",
            )
        elif verdict is None:
            yield caution(
                "firewall",
                f"{active} is on, and its rules for UDP port {port} cannot be read",
                f"where it lets nothing in there, {why}",
                opening(active, port),
            )
        else:
            what = (
                "a firewall drops what comes to"
                if verdict is Verdict.DROPPED
                else ("a firewall lets only some computers reach")
            )
            yield caution("firewall", f"{what} UDP port {port}", why, opening(active, port))


def opening(active: str, port: int) -> str:
    """The command that opens a UDP port."""
    if active == "ufw":
        return f"sudo ufw allow {port}/udp"
    if active == "firewalld":
        return f"sudo firewall-cmd --permanent --add-port={port}/udp && sudo firewall-cmd --reload"
    if active == "nftables":
        return "sudo nft list ruleset, then: sudo nft insert rule inet TABLE CHAIN udp dport " + (
            f"{port} accept"
        )
    return f"sudo iptables -I INPUT -p udp --dport {port} -j ACCEPT"


def active_firewall(subject: Subject) -> str:
    """ "ufw" or "firewalld", where it is on."""
    if re.search(r"^ENABLED=yes", subject.read("etc/ufw/ufw.conf"), re.MULTILINE | re.IGNORECASE):
        return "ufw"
    return "firewalld" if (subject.root / "run/firewalld").exists() else ""


class Firewall(Check):
    """Whether a firewall lets in what controllers send that send first."""

    group, tells = GROUP, ("firewall",)

    @classmethod
    def look(cls, subject: Subject) -> Iterable[Finding]:
        ports = [
            (f"{used.key} of {used.session}", each.port)
            for used in subject.used()
            for each in used.driver.endpoints()
            if each.listens and each.transport == "udp" and not is_loopback(each.host)
        ]
        if not ports:
            return []
        active = active_firewall(subject)
        nft = subject.run(("nft", "-j", "list", "ruleset"))
        legacy = subject.run(("iptables", "-S"))
        verdicts: dict[int, Verdict | None] = {}
        for _, port in ports:
            chains = {}
            if nft is not None:
                chains.update(read_nftables(nft, port))
            if legacy is not None:
                chains.update(read_iptables(legacy, port))
            verdicts[port] = None if nft is None and legacy is None else judge(chains)
        if not active and nft is not None:
            active = "nftables"
        return judge_firewall(ports, verdicts, active)
