"""Fixtures of tests/kernel, for the same virtual machine."""

from tests.kernel.conftest import (
    collect_ignore_glob as collect_ignore_glob,
    modules as modules,
    pytest_runtest_makereport as pytest_runtest_makereport,
)
