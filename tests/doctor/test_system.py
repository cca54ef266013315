"""Scheduling, memory, frequency, clock and load, from the kernel's files."""

import pytest

from cardan.doctor.base import Subject
from cardan.doctor.system import (
    CAP_SYS_NICE,
    UNLIMITED,
    Clock,
    Governor,
    Load,
    MemoryLock,
    Scheduling,
    check_clock,
    check_governors,
    check_load,
    check_memory_lock,
    check_scheduling,
    has_capability,
)
from tests.doctor.levels_and_codes import levels_and_codes


@pytest.mark.parametrize(
    ("limit", "capable", "haptic", "level"),
    [
        (0, False, False, "caution"),
        (0, True, False, "good"),
        (9, False, False, "caution"),
        (10, False, False, "good"),
        (10, False, True, "caution"),
        (99, False, True, "good"),
        (UNLIMITED, False, True, "good"),
    ],
)
def test_real_time_scheduling(limit, capable, haptic, level):
    found = check_scheduling(limit, capable, haptic)
    assert levels_and_codes(Scheduling, found) == [(level, "real-time")]
    if level == "caution":
        assert f"rtprio {99 if haptic else 10}" in found.mend


@pytest.mark.parametrize(
    ("limit", "capable", "haptic", "level"),
    [
        (8 << 20, False, False, "good"),
        (8 << 20, False, True, "caution"),
        (8 << 20, True, True, "good"),
    ],
)
def test_memory_that_may_be_locked(limit, capable, haptic, level):
    assert levels_and_codes(MemoryLock, check_memory_lock(limit, capable, haptic)) == [
        (level, "memory-lock")
    ]


def test_capabilities():
    assert has_capability("Name:\tx\nCapEff:\t0000000000800000\n", CAP_SYS_NICE)
    assert not has_capability("Name:\tx\nCapEff:\t00000000007fffff\n", CAP_SYS_NICE)
    assert not has_capability("", CAP_SYS_NICE)


def test_governors():
    assert levels_and_codes(Governor, check_governors({})) == [("good", "governor")]
    assert levels_and_codes(Governor, check_governors({"cpu0": "performance"})) == [
        ("good", "governor")
    ]
    found = check_governors({"cpu0": "performance", "cpu1": "powersave"})
    assert levels_and_codes(Governor, found) == [("caution", "governor")]
    assert found.mend == "sudo cpupower frequency-set -g performance"


def test_clocks():
    assert levels_and_codes(Clock, check_clock("tsc", "tsc hpet")) == [("good", "clock")]
    better = check_clock("hpet", "hpet tsc acpi_pm")
    assert levels_and_codes(Clock, better) == [("caution", "clock")]
    assert better.mend.startswith("echo tsc | sudo tee /sys/")
    assert "dmesg" in check_clock("hpet", "hpet acpi_pm").mend


def test_load():
    assert levels_and_codes(Load, check_load(1.9, 2)) == [("good", "load")]
    assert levels_and_codes(Load, check_load(2.1, 2)) == [("caution", "load")]


def write(root, path, text):
    (root / path).parent.mkdir(parents=True, exist_ok=True)
    (root / path).write_text(text)


def test_where_the_kernel_says_it(tmp_path):
    for number, governor in enumerate(("powersave\n", "performance\n")):
        write(tmp_path, f"sys/devices/system/cpu/cpu{number}/cpufreq/scaling_governor", governor)
    clock = "sys/devices/system/clocksource/clocksource0"
    write(tmp_path, f"{clock}/current_clocksource", "hpet\n")
    write(tmp_path, f"{clock}/available_clocksource", "tsc hpet \n")
    write(tmp_path, "proc/loadavg", "1000.5 0.1 0.1 1/100 4711\n")
    subject = Subject(root=tmp_path)
    assert levels_and_codes(Governor, Governor.look(subject)) == [("caution", "governor")]
    assert levels_and_codes(Clock, Clock.look(subject)) == [("caution", "clock")]
    assert levels_and_codes(Load, Load.look(subject)) == [("caution", "load")]


def test_a_system_that_says_nothing(tmp_path):
    subject = Subject(root=tmp_path)
    assert levels_and_codes(Governor, Governor.look(subject)) == [("good", "governor")]
    assert levels_and_codes(Clock, Clock.look(subject)) == [("good", "clock")]
    assert levels_and_codes(Load, Load.look(subject)) == []
    assert len(levels_and_codes(Scheduling, Scheduling.look(subject))) == 1
    assert len(levels_and_codes(MemoryLock, MemoryLock.look(subject))) == 1
