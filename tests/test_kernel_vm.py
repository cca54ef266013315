"""tools/kernel-vm: choice of its machine's accelerator, and prompt reports of failures."""

import os
import subprocess
import sys
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
TESTS = """
import pytest

def test_one():
    assert [1] == [2], "they differ"

def test_two():
    print("the second test runs")
"""


@pytest.fixture
def tool():
    path = str(ROOT / "tools/kernel-vm")
    loader = SourceFileLoader("kernel_vm", path)
    spec = spec_from_loader("kernel_vm", loader)
    module = module_from_spec(spec)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "dont_write_bytecode", True)
        loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("flags", "opens", "accel"),
    [
        ("fpu vmx sse", True, "kvm"),
        ("fpu svm sse", True, "kvm"),
        ("fpu vmx sse", False, "tcg,thread=multi"),
        ("fpu sse hypervisor", True, "tcg,thread=multi"),
    ],
)
def test_kvm_is_taken_where_the_processor_has_it(tool, tmp_path, flags, opens, accel):
    cpus, node = tmp_path / "cpuinfo", tmp_path / "kvm"
    cpus.write_text(f"processor\t: 0\nflags\t\t: {flags}\nbugs\t\t: vmxless\n")
    if opens:
        node.touch()
    assert tool.accelerator(cpus, node) == accel
    assert tool.is_kvm(accel) is (accel == "kvm")


def test_a_failure_is_reported_before_the_next_test(tmp_path):
    (tmp_path / "test_tiny.py").write_text(TESTS)
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-s", "-p", "tests.kernel.failures",
         "-p", "no:cacheprovider", str(tmp_path)],
        cwd=ROOT, env=os.environ | {"PYTEST_ADDOPTS": ""}, capture_output=True, text=True,
        timeout=50,
    )  # fmt: skip
    reported, there, _ = done.stdout.partition("the second test runs")
    assert there
    assert "test_tiny.py::test_one (call, " in reported
    assert "they differ" in reported
