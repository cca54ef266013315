"""Fixtures for every test of dissectors."""

import functools

import pytest

from cardan_dissect import registry


@pytest.fixture(autouse=True, scope="module")
def what_is_installed_is_looked_for_once():
    """Shared by a file's tests, because reading the metadata of all packages takes longer than a
    capture."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(registry.FINDER, "_installed", functools.cache(registry.FINDER._installed))
        yield
