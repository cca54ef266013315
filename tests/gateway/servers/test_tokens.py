"""Token files."""

import stat

import pytest

from cardan.errors import ConfigurationError, OptionError
from cardan.gateway.servers import tokens
from cardan.gateway.servers.tokens import FILE_BYTES, MIN_TOKEN_CHARACTERS, Role, made_tokens

SHORTEST = "0123456789abcdef"


@pytest.fixture
def own_file(tmp_path, monkeypatch):
    path = tmp_path / "state" / "cardan" / "server-tokens"
    monkeypatch.setattr(tokens, "own_token_file", lambda: path)
    return path


def test_a_token_has_sixteen_characters_at_least():
    assert tokens.parse_tokens(SHORTEST, "tokens") == {SHORTEST: Role.OPERATOR}
    assert len(SHORTEST) == MIN_TOKEN_CHARACTERS
    with pytest.raises(OptionError, match="at least 16 characters"):
        tokens.parse_tokens(SHORTEST[1:], "tokens")


@pytest.mark.parametrize("text", ["", "# nothing\n"])
def test_a_text_without_one_is_refused_by_its_key(text):
    with pytest.raises(OptionError, match="a_key_of_twenty_one: "):
        tokens.parse_tokens(text, "a_key_of_twenty_one")


def test_those_that_are_made_are_one_of_each_role_and_their_owners_alone(own_file):
    made = made_tokens()
    assert sorted(made.values()) == [Role.VIEWER, Role.OPERATOR, Role.ADMIN]
    assert {len(token) for token in made} == {32}
    assert stat.S_IMODE(own_file.stat().st_mode) == 0o600
    assert [each.name for each in own_file.parent.iterdir()] == [own_file.name]
    assert made_tokens() == made


def test_those_under_the_files_former_name_stay_what_they_are(own_file):
    made = tokens.made_tokens()
    own_file.rename(own_file.with_name("face-tokens"))
    assert tokens.made_tokens() == made
    assert [each.name for each in own_file.parent.iterdir()] == [own_file.name]


def test_they_are_made_in_a_folder_that_is_there(own_file):
    own_file.parent.mkdir(parents=True)
    assert len(made_tokens()) == 3


def test_a_file_is_read_up_to_its_limit(own_file):
    own_file.parent.mkdir(parents=True)
    own_file.touch(0o600)
    assert FILE_BYTES == 4096
    words = f"admin {SHORTEST}\n"
    own_file.write_text(words + "#" * (FILE_BYTES - len(words)))
    assert tokens.read_tokens(own_file) == {SHORTEST: Role.ADMIN}
    own_file.write_text(words + "#" * (FILE_BYTES - len(words) + 1))
    with pytest.raises(ConfigurationError, match="longer than"):
        tokens.read_tokens(own_file)


@pytest.mark.parametrize(
    ("roles", "found"),
    [
        ({"a": Role.VIEWER, "b": Role.ADMIN, "c": Role.OPERATOR, "d": Role.OPERATOR}, "c"),
        ({"a": Role.VIEWER, "b": Role.ADMIN}, "b"),
        ({"a": Role.VIEWER}, "a"),
        ({}, ""),
    ],
)
def test_who_starts_the_server_is_reported_an_operators_token_rather_than_an_admins(roles, found):
    assert tokens.Tokens(roles).for_starter() == found
