"""Options of every WebSocket server: places of its token and its certificate."""

from __future__ import annotations

import asyncio
import socket
import stat
import subprocess
from collections import Counter
from concurrent.futures import ThreadPoolExecutor

import pytest

from cardan.errors import AddressError, ConfigurationError, OptionError
from cardan.gateway.servers.tokens import Role, made_tokens, own_token_file
from cardan.gateway.servers.web import TOKEN_VARIABLE, WebOptions, WebSocketListener

TOKEN, OTHER = "0123456789abcdef-token", "another-0123456789"


@pytest.fixture(autouse=True)
def no_token_around(monkeypatch):
    monkeypatch.delenv(TOKEN_VARIABLE, raising=False)


@pytest.fixture
def state(tmp_path, monkeypatch):
    """An empty state folder of the user."""
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return tmp_path


@pytest.fixture
def token_file(tmp_path):
    def made(text=f"{TOKEN}\n", mode=0o600):
        path = tmp_path / "token"
        path.write_text(text)
        path.chmod(mode)
        return str(path)

    return made


def test_without_a_token_none_is_needed_on_this_machine():
    assert not WebOptions().tokens()


def role(given, **options):
    return WebOptions(plaintext=True, **options).tokens().role([given])


def test_the_token_is_in_a_file_or_in_the_environment(token_file, monkeypatch):
    assert role(TOKEN, host="0.0.0.0", token_file=token_file()) is Role.OPERATOR
    assert role(TOKEN, token_file=token_file(mode=0o400)) is Role.OPERATOR
    monkeypatch.setenv(TOKEN_VARIABLE, f"{OTHER}\n")
    assert role(OTHER, host="0.0.0.0") is Role.OPERATOR
    assert role(OTHER, token_file=token_file()) is None, "the option has priority over the variable"
    assert role(TOKEN, token_file=token_file()) is Role.OPERATOR
    assert role(TOKEN, token=TOKEN) is Role.OPERATOR
    assert role(OTHER, token=TOKEN) is None


def test_a_file_has_tokens_of_several_roles(token_file):
    text = f"# for the page\nviewer {TOKEN}v\n\noperator\t{TOKEN}o\r\nadmin {TOKEN}a\n{OTHER}\n"
    path = token_file(text)
    found = [role(f"{TOKEN}{each}", token_file=path) for each in "voax"]
    assert found == [Role.VIEWER, Role.OPERATOR, Role.ADMIN, None]
    assert role(OTHER, token_file=path) is Role.OPERATOR


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o666])
def test_a_token_that_others_can_read_is_none(token_file, mode):
    path = token_file(mode=mode)
    with pytest.raises(ConfigurationError, match=f"token_file: .*mode {mode:04o}.*chmod 600"):
        WebOptions(token_file=path).tokens()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "at least 16 characters"),
        ("short", "at least 16 characters"),
        (f"{TOKEN}\n{TOKEN}", "a token is there twice"),
        (f"# {TOKEN}", "at least 16 characters"),
        (f"viewer {TOKEN} x", "without spaces, one a line, after its role"),
        (f"root {TOKEN}", "one a line, after its role: viewer, operator, admin"),
        (f"{TOKEN}\x07", "without spaces and line ends"),
        ("x" * 5000, "cannot be read: it is longer"),
    ],
)
def test_what_is_no_token_in_a_file(token_file, text, words):
    with pytest.raises(ConfigurationError, match=words) as refused:
        WebOptions(token_file=token_file(text)).tokens()
    assert "0123456789abcdef" not in str(refused.value)


def test_a_token_file_that_is_not_there(tmp_path):
    with pytest.raises(ConfigurationError, match="none cannot be read: No such file"):
        WebOptions(token_file=str(tmp_path / "none")).tokens()
    with pytest.raises(ConfigurationError, match="it is a directory"):
        WebOptions(token_file=str(tmp_path)).tokens()


def test_the_environments_former_name_of_the_token_is_refused_by_the_new_one(monkeypatch):
    monkeypatch.setenv("CARDAN_FACE_TOKEN", f"{OTHER}\n")
    with pytest.raises(ConfigurationError, match=f"CARDAN_FACE_TOKEN: is now: {TOKEN_VARIABLE}"):
        WebOptions().given_tokens()


def test_a_short_token_in_the_environment_is_refused_by_its_name(monkeypatch):
    monkeypatch.setenv(TOKEN_VARIABLE, "short")
    with pytest.raises(OptionError, match=f"{TOKEN_VARIABLE}: .*16 characters") as refused:
        WebOptions(host="0.0.0.0", plaintext=True).tokens()
    assert "short" not in str(refused.value)


def test_two_tokens_are_one_too_many():
    with pytest.raises(OptionError, match="left out, because there is a token"):
        WebOptions(token=TOKEN, token_file="x")


def test_no_command_line_has_the_token():
    """Every user of a computer can read every command line."""
    from cardan.cli.options_from_dataclass import all_given

    flags = {each.flag for each in all_given(WebOptions, described=True)}
    assert "--token-file" in flags
    assert "--token" not in flags


def test_where_it_serves_is_an_address_that_clients_can_open():
    assert WebOptions().endpoint(9) == "ws://127.0.0.1:9"
    assert WebOptions(host="::1", certificate="c", key="k").endpoint(9) == "wss://[::1]:9"


# -- generated tokens -----------------------------------------------------------------------------


def away(**options):
    """Options of a server that is reachable from other computers."""
    return WebOptions(host="0.0.0.0", plaintext=True, **options)


def test_others_need_tokens_that_are_made_at_the_first_start(state, caplog):
    assert not WebOptions().tokens()
    assert not own_token_file().exists(), "loopback needs no token"
    tokens = away().tokens()
    path = own_token_file()
    assert path.parent.parent == state
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    made = dict(line.split() for line in path.read_text().splitlines() if line[0] != "#")
    assert {word: tokens.role([each]) for word, each in made.items()} == {
        "viewer": Role.VIEWER,
        "operator": Role.OPERATOR,
        "admin": Role.ADMIN,
    }
    assert all(len(each) == 32 for each in made.values())
    assert str(path) in caplog.text
    assert not [each for each in made.values() if each in caplog.text]
    caplog.clear()
    assert away().tokens().role([made["admin"]]) is Role.ADMIN, "tokens survive a restart"
    assert not caplog.records
    assert list(path.parent.iterdir()) == [path]


def test_made_tokens_that_others_can_read_are_none(state):
    away().tokens()
    own_token_file().chmod(0o644)
    with pytest.raises(ConfigurationError, match="mode 0644"):
        away().tokens()


def test_no_tokens_where_none_can_be_kept(state):
    state.joinpath("cardan").write_text("a file")
    with pytest.raises(ConfigurationError, match="token_file: no token was given, and none can be"):
        away().tokens()


def test_servers_that_start_together_have_the_same_tokens(state):
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda _: tuple(made_tokens()), range(16)))
    assert len(set(found)) == 1


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.7", "::"])
def test_others_are_not_served_in_the_clear(host):
    with pytest.raises(OptionError, match=r"host: .* unless there is a certificate"):
        WebOptions(host=host, token=TOKEN)
    WebOptions(host=host, token=TOKEN, certificate="c", key="k")
    WebOptions(host=host, token=TOKEN, plaintext=True)


# -- certificates ---------------------------------------------------------------------------------


def openssl(*words):
    made = subprocess.run(["openssl", *words], capture_output=True, check=False)
    if made.returncode:
        pytest.skip("openssl is not installed")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Valid and invalid files of certificates and keys."""
    folder = tmp_path_factory.mktemp("tls")
    for name in ("one", "other"):
        openssl(
            *("req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes"),
            *("-days", "2", "-subj", "/CN=localhost", "-keyout", folder / f"{name}.key"),
            *("-out", folder / f"{name}.pem"),
        )
    locked = ("pkcs8", "-topk8", "-passout", "pass:abcd", "-in", folder / "one.key")
    openssl(*locked, "-out", folder / "locked.key")
    openssl("x509", "-in", folder / "one.pem", "-outform", "der", "-out", folder / "one.der")
    (folder / "text.pem").write_text("hello")
    return lambda name: str(folder / name)


def opened(**options):
    """Open and close a listener."""

    async def run():
        front = WebSocketListener(
            WebOptions(**options), Counter(), lambda connection, peer, role: None
        )
        try:
            await front.open()
        finally:
            await front.close()

    asyncio.run(run())


@pytest.mark.parametrize(
    ("certificate", "key", "words"),
    [
        ("none.pem", "one.key", "certificate: .*none.pem cannot be used: No such file.*openssl"),
        ("one.pem", "none.key", "key: .*none.key cannot be used: No such file"),
        ("one.pem", "other.key", "the key is that of another certificate"),
        ("one.pem", "locked.key", "key: .*has a password.*openssl pkey"),
        ("one.der", "one.key", "certificate: .*cannot be used"),
        ("text.pem", "one.key", "certificate: .*not a PEM file"),
        ("one.key", "one.pem", "cannot be used"),
    ],
)
def test_a_certificate_that_cannot_be_used_says_what_to_do(made, certificate, key, words):
    with pytest.raises(ConfigurationError, match=words):
        opened(certificate=made(certificate), key=made(key))


def test_a_certificate_that_can(made):
    opened(certificate=made("one.pem"), key=made("one.key"))


def test_a_port_in_use_is_said():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(AddressError, match=f"cannot listen at 127.0.0.1:{port}"):
            opened(port=port)
