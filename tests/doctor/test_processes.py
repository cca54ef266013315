"""Open files of processes, in a /proc that the test provides."""

from cardan.doctor.processes import holders, named


def process(root, pid, *words, comm="x", parent=1, opened=()):
    folder = root / "proc" / str(pid)
    (folder / "fd").mkdir(parents=True)
    (folder / "comm").write_text(f"{comm}\n")
    (folder / "cmdline").write_bytes(b"\0".join(word.encode() for word in words) + b"\0")
    (folder / "status").write_text(f"Name:\t{comm}\nPPid:\t{parent}\n")
    for number, target in enumerate(opened):
        (folder / "fd" / str(number)).symlink_to(target)


def test_holders(tmp_path):
    process(tmp_path, 70, "spacenavd", comm="spacenavd", opened=["/dev/null", "/dev/hidraw0"])
    process(tmp_path, 80, "python", "-m", "cardan", "daemon", "run", "lab.toml")
    process(tmp_path, 90, "python", "-c", "spawn", parent=80, opened=["socket:[4711]"])
    process(tmp_path, 95, "vi", "cardan/x.py", opened=["socket:[1]"])
    (tmp_path / "proc" / "self").mkdir()
    found = holders(["/dev/hidraw0", "socket:[4711]", "socket:[1]", "/dev/none"], tmp_path)
    assert {target: each.pid for target, each in found.items()} == {
        "/dev/hidraw0": 70,
        "socket:[4711]": 90,
        "socket:[1]": 95,
    }
    assert [found[each].is_ours for each in sorted(found)] == [False, False, True]
    assert str(found["/dev/hidraw0"]) == "spacenavd (pid 70)"


def test_a_process_whose_files_cannot_be_seen_is_passed_over(tmp_path):
    process(tmp_path, 70, "a", opened=["/dev/hidraw0"])
    (tmp_path / "proc" / "70" / "fd" / "0").unlink()
    (tmp_path / "proc" / "70" / "fd").rmdir()
    assert holders(["/dev/hidraw0"], tmp_path) == {}


def test_long_command_lines_are_shortened(tmp_path):
    process(tmp_path, 70, "a" * 500, opened=["/dev/hidraw0"])
    assert len(str(holders(["/dev/hidraw0"], tmp_path)["/dev/hidraw0"])) < 100


def test_programs_by_name(tmp_path):
    process(tmp_path, 71, "spacenavd", comm="spacenavd")
    process(tmp_path, 70, "spacenavd", comm="spacenavd")
    assert named("spacenavd", tmp_path) == [70, 71]
    assert named("spacenavd", tmp_path / "nothing") == []
