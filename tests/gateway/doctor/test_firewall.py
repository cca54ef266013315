"""Firewalls' rules, followed for a datagram to one port."""

import json

import pytest
from hypothesis import given, strategies as st

from cardan.gateway.doctor.base import Subject
from cardan.gateway.doctor.files import read_files
from cardan.gateway.doctor.firewall import (
    Firewall,
    Verdict,
    judge,
    judge_firewall,
    read_iptables,
    read_nftables,
)
from tests.gateway.doctor.told import told

PORT = 6510
LET_IN, DROPPED, MAYBE = Verdict.LET_IN, Verdict.DROPPED, Verdict.MAYBE


def nft(*rules, policy="drop", **chains):
    """A ruleset with a base chain of these expressions, and others that it may jump to."""
    items = [{"metainfo": {"version": "1.0.6"}}]
    base = {"family": "inet", "table": "filter", "name": "input", "type": "filter"}
    items.append({"chain": {**base, "hook": "input", "prio": 0, "policy": policy}})
    own = {"family": "inet", "table": "filter"}
    items += [{"chain": {**own, "name": name}} for name in chains]
    for name, each in (
        *(("input", rule) for rule in rules),
        *((name, rule) for name, them in chains.items() for rule in them),
    ):
        items.append({"rule": {"family": "inet", "table": "filter", "chain": name, "expr": each}})
    return json.dumps({"nftables": items})


def match(left, right, op="=="):
    return {"match": {"op": op, "left": left, "right": right}}


UDP_PORT = {"payload": {"protocol": "udp", "field": "dport"}}
STATE = {"ct": {"key": "state"}}
SOURCE = {"payload": {"protocol": "ip", "field": "saddr"}}
PROTOCOL = {"meta": {"key": "l4proto"}}
INTERFACE = {"meta": {"key": "iifname"}}
ACCEPT, DROP = {"accept": None}, {"drop": None}


@pytest.mark.parametrize(
    ("ruleset", "verdict"),
    [
        (json.dumps({"nftables": []}), LET_IN),
        (nft(policy="accept"), LET_IN),
        (nft(), DROPPED),
        (nft([match(UDP_PORT, PORT), ACCEPT]), LET_IN),
        (nft([match(UDP_PORT, 6511), ACCEPT]), DROPPED),
        (nft([match(UDP_PORT, {"set": [53, PORT]}), ACCEPT]), LET_IN),
        (nft([match(UDP_PORT, {"range": [6500, 6600]}), ACCEPT]), LET_IN),
        (nft([match(UDP_PORT, {"set": [{"range": [1, 9]}, 53]}), ACCEPT]), DROPPED),
        (nft([match(UDP_PORT, PORT, "!="), ACCEPT]), DROPPED),
        (nft([match(UDP_PORT, "@robots"), ACCEPT]), MAYBE),
        (nft([match(STATE, ["established", "related"], "in"), ACCEPT]), DROPPED),
        (nft([match(INTERFACE, "lo"), ACCEPT]), DROPPED),
        (nft([match(INTERFACE, "eth1"), ACCEPT]), MAYBE),
        (nft([match(PROTOCOL, "tcp"), ACCEPT], [match(PROTOCOL, "udp"), ACCEPT]), LET_IN),
        (nft([match(SOURCE, "10.0.0.1"), match(UDP_PORT, PORT), ACCEPT]), MAYBE),
        (nft([match(SOURCE, "10.0.0.1"), DROP], policy="accept"), MAYBE),
        (nft([{"reject": {"type": "icmp"}}], policy="accept"), DROPPED),
        (nft([{"counter": None}, ACCEPT]), LET_IN),
        (nft([{"jump": {"target": "own"}}], own=[[match(UDP_PORT, PORT), ACCEPT]]), LET_IN),
        (nft([{"jump": {"target": "own"}}], own=[[{"return": None}], [ACCEPT]]), DROPPED),
        (nft([{"jump": {"target": "own"}}], own=[[{"jump": {"target": "own"}}]]), DROPPED),
        (nft([match(SOURCE, "x"), {"jump": {"target": "own"}}], own=[[ACCEPT]]), MAYBE),
    ],
)
def test_nftables(ruleset, verdict):
    assert judge(read_nftables(ruleset, PORT)) is verdict


@pytest.mark.parametrize(
    ("rules", "verdict"),
    [
        ("", LET_IN),
        ("-P INPUT ACCEPT", LET_IN),
        ("-P INPUT DROP", DROPPED),
        ("-P INPUT DROP\n-A INPUT -p udp -m udp --dport 6510 -j ACCEPT", LET_IN),
        ("-P INPUT DROP\n-A INPUT -p udp -m multiport --dports 53,6500:6600 -j ACCEPT", LET_IN),
        ("-P INPUT DROP\n-A INPUT -p tcp -m tcp --dport 6510 -j ACCEPT", DROPPED),
        ("-P INPUT DROP\n-A INPUT ! -p tcp -j ACCEPT", LET_IN),
        ("-P INPUT DROP\n-A INPUT -i lo -j ACCEPT", DROPPED),
        ("-P INPUT DROP\n-A INPUT -s 10.0.0.0/8 -j ACCEPT", MAYBE),
        (
            "-P INPUT DROP\n-A INPUT -m conntrack --ctstate RELATED,ESTABLISHED -j ACCEPT",
            DROPPED,
        ),
        ("-P INPUT ACCEPT\n-A INPUT -j LOG --log-prefix 'a b'\n-A INPUT -j DROP", DROPPED),
        (
            "-P INPUT ACCEPT\n-N own\n-A INPUT -j own\n"
            "-A own -p udp --dport 6510 -j REJECT --reject-with icmp-port-unreachable",
            DROPPED,
        ),
        ("-P FORWARD DROP\n-P OUTPUT DROP\n-P INPUT ACCEPT\n'", LET_IN),
    ],
)
def test_iptables(rules, verdict):
    assert judge(read_iptables(rules, PORT)) is verdict


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"nftables": [1]}', '{"nftables": 7}', "x"])
def test_what_is_no_ruleset(text):
    assert read_nftables(text, PORT) == {}


@given(st.text(alphabet="-PAINUT DROPjsdport6510:,'\n! ", max_size=200))
def test_no_text_raises(text):
    judge(read_iptables(text, PORT))


@pytest.mark.parametrize(
    ("verdict", "active", "level"),
    [
        (LET_IN, "ufw", "good"),
        (None, "", "good"),
        (None, "ufw", "caution"),
        (DROPPED, "nftables", "caution"),
        (MAYBE, "", "caution"),
    ],
)
def test_findings(verdict, active, level):
    found = list(judge_firewall([("robot of gofa", PORT)], {PORT: verdict}, active))
    assert told(Firewall, found) == [(level, "firewall")]


@pytest.mark.parametrize(
    ("active", "mend"),
    [
        ("ufw", "sudo ufw allow 6510/udp"),
        ("firewalld", "--add-port=6510/udp"),
        ("nftables", "udp dport 6510 accept"),
        ("", "sudo iptables -I INPUT -p udp --dport 6510 -j ACCEPT"),
    ],
)
def test_what_opens_a_port(active, mend):
    found = list(judge_firewall([("robot of gofa", PORT)], {PORT: DROPPED}, active))
    assert mend in found[0].mend


def subject_of(tmp_path, host, answers):
    file = tmp_path / "lab.toml"
    file.write_text(f'[robot]\ndriver = "abb_egm"\nlisten_host = "{host}"\n')
    layout, _ = read_files([file])
    return Subject((file,), layout, root=tmp_path, run=lambda words: answers.get(words[0]))


def test_the_check(tmp_path):
    assert told(Firewall, Firewall.look(subject_of(tmp_path, "127.0.0.1", {"nft": nft()}))) == []
    shut = list(Firewall.look(subject_of(tmp_path, "0.0.0.0", {"nft": nft()})))
    assert told(Firewall, shut) == [("caution", "firewall")]
    shut = list(Firewall.look(subject_of(tmp_path, "0.0.0.0", {"iptables": "-P INPUT DROP"})))
    assert told(Firewall, shut) == [("caution", "firewall")]
    assert told(Firewall, Firewall.look(subject_of(tmp_path, "0.0.0.0", {}))) == [
        ("good", "firewall")
    ]
    (tmp_path / "etc/ufw").mkdir(parents=True)
    (tmp_path / "etc/ufw/ufw.conf").write_text("# x\nENABLED=yes\n")
    ufw = list(Firewall.look(subject_of(tmp_path, "0.0.0.0", {})))
    assert told(Firewall, ufw) == [("caution", "firewall")]
    assert ufw[0].mend == "sudo ufw allow 6510/udp"
