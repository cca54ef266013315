"""Requests that are well-formed and harmful: the daemon must survive them."""

import json

import pytest

from cardan.gateway.daemon.control import Ask, decode_response
from fuzz.targets.texts import idle_daemon


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (Ask(3, "watch", "", 10**400), "is not allowed; from"),
        (Ask(3, "watch", "", -(10**400)), "is not allowed; from"),
        (Ask(3, "watch", "", float("nan")), "is not allowed; from"),
        (Ask(3, "switch", "", ["a"]), "not a device that sessions share"),
        (Ask(3, "log", "", ["a"]), "true or false"),
    ],
)
def test_values_of_another_kind_are_refused(ask, words):
    daemon, program = idle_daemon()
    daemon._handle(ask, program)
    reported = decode_response(program.reported[-1])
    assert (reported.id, reported.kind) == (3, "error")
    assert words in reported.value


@pytest.mark.parametrize("verb", [[1], {"a": 1}, None, 3, "no such verb"])
def test_a_verb_of_any_kind_goes_to_its_session_which_refuses_it(verb):
    daemon, program = idle_daemon()
    sent = []
    name, service = next(iter(daemon._services.items()))
    service.process.send = sent.append
    daemon._handle(Ask(5, "ask", name, {"id": 7, "source": "verbs", "verb": verb}), program)
    assert program.reported == []
    assert json.loads(sent[0])["verb"] == verb
