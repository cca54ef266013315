"""Check of the definitions by ROS 2's own rosidl, which parses each file and computes each type's
hash.

It runs in an environment of `tools/ros2`, with PYTHONPATH set to this source tree for the
definitions. It prints differences, and then exits with code 1.
"""

import contextlib
import io
import json
import sys
import tempfile
from pathlib import Path

from cardan.protocols.ros2.interfaces import known_types
from cardan.protocols.ros2.packages import package_files
from cardan.protocols.ros2.type_hash import type_hash


def main() -> int:
    from rosidl_adapter import convert_to_idl
    from rosidl_generator_type_description import generate_type_hash

    waiting = {each.split("/")[0] for each in known_types()}
    files = {package: package_files(package) for package in waiting}
    needs = {
        package: {each for each in waiting if f"<depend>{each}<" in texts["package.xml"]}
        for package, texts in files.items()
    }
    for package in waiting:  # implicit dependencies of rosidl
        if any(each.startswith(("srv/", "action/")) for each in files[package]):
            needs[package] |= {"service_msgs"}
        if any(each.startswith("action/") for each in files[package]):
            needs[package] |= {"unique_identifier_msgs", "builtin_interfaces", "action_msgs"}
    folder = Path(tempfile.mkdtemp())
    hashes: dict[str, str] = {}
    while waiting:
        # In the order of dependencies: it reads its own output for earlier packages.
        package = next(each for each in sorted(waiting) if not needs[each] & waiting)
        waiting.remove(package)
        texts = {path: text for path, text in files[package].items() if "/" in path}
        for path, text in texts.items():
            file = folder / "src" / package / path
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text)
            with contextlib.redirect_stdout(io.StringIO()):
                convert_to_idl(folder / "src" / package, package, Path(path), folder / package)
        arguments = folder / f"{package}.json"
        arguments.write_text(
            json.dumps(
                {
                    "package_name": package,
                    "output_dir": str(folder / package),
                    "idl_tuples": [
                        f"{folder / package}:{Path(each).with_suffix('.idl')}" for each in texts
                    ],
                    "include_paths": [
                        f"{each}:{folder / each}" for each in files if each != package
                    ],
                }
            )
        )
        generate_type_hash(str(arguments))
        for each in (folder / package).glob("*/*.json"):
            for row in json.loads(each.read_text())["type_hashes"]:
                hashes[row["type_name"]] = row["hash_string"]
    # The hash of an action as a whole is not on the wire.
    compared = {
        name: theirs
        for name, theirs in sorted(hashes.items())
        if "/action/" not in name or name not in known_types()
    }
    different = {name: each for name, each in compared.items() if type_hash(name) != each}
    for name, theirs in different.items():
        print(f"{name}: {type_hash(name)} here, {theirs} by rosidl")
    print(f"{len(compared) - len(different)} of {len(compared)} the same")
    return 1 if different or not compared else 0


if __name__ == "__main__":
    sys.exit(main())
