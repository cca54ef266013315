"""Browsers load the page from the server, with the right headers for each file."""

from __future__ import annotations

import urllib.error
import urllib.request
from http import HTTPStatus

import pytest

pytest.importorskip("cbor2", reason="cbor2 is not installed: pip install cardan[network]")

from cardan.common.cache import cache_bytes
from cardan.errors import ConfigurationError
from cardan.gateway.servers.console.site import SECURITY, Site
from cardan.robots.visuals import KIND
from tests.gateway.servers.bench import WAIT_S
from tests.gateway.servers.console.bench import console
from tests.gateway.servers.memory_network import MemoryNetwork

pytestmark = pytest.mark.matrix


def get(running, path="/", **headers):
    """Response to GET."""
    request = urllib.request.Request(f"http://127.0.0.1:{running.port}{path}", headers=headers)
    try:
        return urllib.request.urlopen(request, timeout=WAIT_S)
    except urllib.error.HTTPError as answer:
        return answer


def test_a_package_without_a_page_says_what_to_do(tmp_path):
    with pytest.raises(ConfigurationError, match=r"console: the page is not built .*tools/console"):
        Site(tmp_path)


def test_a_browser_gets_the_page_once_and_with_its_policy(tmp_path):
    with console(MemoryNetwork(), tmp_path) as running:
        with get(running) as answer:
            assert answer.status == HTTPStatus.OK
            assert answer.read() == b"<p>page</p>"
            assert answer.headers.get_all("Content-Type") == ["text/html; charset=utf-8"]
            for name, value in SECURITY:
                assert answer.headers.get_all(name) == [value]
            etag = answer.headers["ETag"]
        with get(running, **{"If-None-Match": etag}) as answer:
            assert answer.status == HTTPStatus.NOT_MODIFIED
        with get(running, **{"Accept-Encoding": "gzip"}) as answer:
            assert answer.headers["Content-Encoding"] == "gzip"
            assert answer.read() == b"<p>page.gz</p>"
        with get(running, "/../server.py") as answer:
            assert answer.status == HTTPStatus.NOT_FOUND


def test_a_mesh_is_for_who_has_the_token(tmp_path, monkeypatch):
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path / "cache"))
    key, token = "a1" * 32, "0123456789abcdef"
    cache_bytes(KIND, key, b"a mesh")
    with console(MemoryNetwork(), tmp_path, token=token) as running:
        with get(running, f"/visuals/{key}", Authorization=f"Bearer {token}") as answer:
            assert answer.status == HTTPStatus.OK
            assert answer.read() == b"a mesh"
            assert answer.headers["Content-Type"] == "application/octet-stream"
            assert "immutable" in answer.headers["Cache-Control"]
        for path in (f"/visuals/{key}", f"/visuals/{key}?t=fedcba9876543210"):
            with get(running, path) as answer:
                assert answer.status == HTTPStatus.UNAUTHORIZED
        with get(running, f"/visuals/{key}", Authorization="Bearer fedcba9876543210") as answer:
            assert answer.status in (HTTPStatus.UNAUTHORIZED, HTTPStatus.TOO_MANY_REQUESTS)
        given = {"Authorization": f"Bearer {token}"}
        with get(running, f"/visuals/{key}", Host="elsewhere.example", **given) as answer:
            assert answer.status == HTTPStatus.FORBIDDEN
        for path in (f"/visuals/{'b2' * 32}", f"/visuals/../visuals/{key}", "/visuals/"):
            with get(running, path, **given) as answer:
                assert answer.status == HTTPStatus.NOT_FOUND
        with get(running) as answer:
            assert answer.status == HTTPStatus.OK
