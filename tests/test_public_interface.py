"""``import cardan``: names, import time, keywords, and a uniform way to open everything."""

import ast
import dataclasses
import json
import pydoc
import subprocess
import sys
from pathlib import Path

import pytest

import cardan
from cardan import api
from cardan.drivers import registry
from cardan.drivers.base import Driver, FoundDevice, OperatorDevice, RobotDriver
from cardan.errors import ConfigurationError, DeviceNotFoundError, DriverError, OptionError
from cardan.types import NEUTRAL, Axes, DeviceLink
from tests.serving import served

DRIVERS = {name: registry.load(name) for name in registry.BUILT_IN}


def in_a_new_python(code):
    """Return the JSON that `code` prints in a new process."""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True
    )
    return json.loads(done.stdout)


# -- names -------------------------------------------------------------------------------------


def test_import_cardan_imports_nothing_else():
    loaded = in_a_new_python(
        "import json, sys; before = set(sys.modules); import cardan\n"
        "print(json.dumps(sorted(set(sys.modules) - before)))"
    )
    assert loaded == ["cardan"]


def test_a_driver_class_costs_no_other_driver():
    loaded = in_a_new_python(
        "import sys, json, cardan; cardan.Keyboard; print(json.dumps(list(sys.modules)))"
    )
    assert "cardan.drivers.keyboard" in loaded
    assert not {"cardan.drivers.spacemouse", "cardan.gateway", "numpy", "typer"} & {*loaded}


NOT_FOR_A_CLASS = {
    "cardan.common.tables", "cardan.robots", "difflib", "importlib.metadata", "numpy", "scipy",
    "tomllib", "typer", "xml.etree.ElementTree",
}  # fmt: skip
"""Modules to open a driver, read a file or write an error, but not to define a class."""


@pytest.mark.parametrize(
    ("name", "others"),
    [
        ("SpaceMouse", {"google.protobuf", "hid", "hidraw", "json", "pickle", "usb"}),
        ("AbbEgm", set()),
    ],
)
def test_a_driver_class_is_imported_without_what_it_uses_later(name, others):
    loaded = in_a_new_python(
        f"import sys; before = set(sys.modules); import cardan; cardan.{name}\n"
        "added = sorted(set(sys.modules) - before); import json; print(json.dumps(added))"
    )
    assert "cardan.drivers.base" in loaded
    assert not (NOT_FOR_A_CLASS | others) & {*loaded}


@pytest.mark.parametrize(("name", "driver"), DRIVERS.items())
def test_every_driver_is_there_by_the_name_of_its_class(name, driver):
    assert getattr(cardan, driver.__name__) is driver
    assert driver.__name__ in dir(cardan)


def test_every_name_is_cardans_own():
    names = sorted(api._names())
    assert names
    for name in names:
        value = getattr(cardan, name)
        assert getattr(value, "__module__", "cardan").startswith("cardan") or name == "RobotCommand"


def test_type_checkers_see_the_drivers_that_are_there():
    imported = {
        (node.module, each.name, each.asname)
        for node in ast.walk(ast.parse(Path(api.__file__).read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom)
        for each in node.names
    }
    for driver in DRIVERS.values():
        package = driver.__module__.rpartition(".")[0]
        assert (package, driver.__name__, driver.__name__) in imported


def test_all_names_are_there_for_a_star_and_for_help():
    code = "from cardan import *; import json; print(json.dumps(sorted(globals())))"
    assert {*api._names()} <= {*in_a_new_python(code)}
    assert {"SpaceMouse", "open_device", "CardanError", "Pose"} <= {*cardan.__all__}
    assert not {"Literal", "overload", "registry", "__version__"} & {*cardan.__all__}
    page = pydoc.plain(pydoc.render_doc(cardan))
    for name in ("open_robot(driver", "class SpaceMouse(", "class OptionError("):
        assert name in page


WITHOUT_AN_EXTRA = """
import sys
sys.modules["coal"] = None
import inspect, pydoc
import cardan
from cardan import *
from cardan.errors import ExtraMissingError

assert "SpaceMouse" in globals() and "CartesianDevice" not in globals()
assert "CartesianDevice" not in dir(cardan) and "SpaceMouse" in dir(cardan)
assert not hasattr(cardan, "CartesianDevice")
assert "SpaceMouse" in dict(inspect.getmembers(cardan))
assert "open_robot(driver" in pydoc.plain(pydoc.render_doc(cardan))
said = []
for how, kind in (
    ("from cardan import CartesianDevice", ImportError),
    ("import cardan.gateway.arm.device", ImportError),
    ("cardan.CartesianDevice", AttributeError),
):
    try:
        exec(how)
    except kind as error:
        assert isinstance(error, ExtraMissingError) and error.extra == "arm"
        said.append(str(error))
import json
print(json.dumps(said))
"""


def test_without_an_extra_only_the_name_that_needs_it_fails():
    said = in_a_new_python(WITHOUT_AN_EXTRA)
    assert len(said) == 3
    assert all(words.endswith('pip install "cardan[arm]"') for words in said)


def test_type_checkers_know_what_a_name_opens():
    """Each built-in name has an overload, in the table's order, without cost at run time."""
    opened = {"open_device": {}, "open_robot": {}}
    for node in ast.parse(Path(api.__file__).read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef) and node.name in opened and node.decorator_list:
            kind = ast.unparse(node.args.posonlyargs[0].annotation)
            opened[node.name][kind] = ast.unparse(node.returns)
    for function, base in (("open_device", OperatorDevice), ("open_robot", RobotDriver)):
        expected = {
            f"Literal['{name}']": driver.__name__
            for name, driver in DRIVERS.items()
            if issubclass(driver, base)
        }
        assert opened[function] == {**expected, "str": base.__name__}


def test_submodules_and_unknown_names():
    code = "import cardan, json; print(json.dumps(cardan.errors.DriverError.__name__))"
    assert in_a_new_python(code) == "DriverError"
    with pytest.raises(AttributeError, match="module 'cardan' has no attribute 'SpaceMous'"):
        _ = cardan.SpaceMous
    with pytest.raises(ImportError):
        from cardan import nothing_of_this_name  # noqa: F401


@pytest.mark.parametrize("driver", DRIVERS.values(), ids=DRIVERS)
def test_type_checkers_know_its_options(driver):
    """Without overloads they would accept Driver's own options, which may be anything."""
    assert (
        vars(driver)["__annotations__"]["Options"] == f"ClassVar[type[{driver.Options.__name__}]]"
    )


# -- options as keywords -----------------------------------------------------------------------


@pytest.mark.parametrize("driver", DRIVERS.values(), ids=DRIVERS)
def test_a_driver_takes_its_options_as_an_object_or_as_keywords(driver):
    options = driver.Options()
    values = {field.name: getattr(options, field.name) for field in dataclasses.fields(options)}
    assert driver().options == driver(options).options == driver(**values).options == options


@pytest.mark.parametrize("driver", DRIVERS.values(), ids=DRIVERS)
def test_both_at_once_are_refused(driver):
    name = dataclasses.fields(driver.Options)[0].name
    with pytest.raises(ConfigurationError, match=f"Options and the keywords {name}: put them into"):
        driver(driver.Options(), **{name: 1})


@pytest.mark.parametrize("driver", DRIVERS.values(), ids=DRIVERS)
def test_an_option_that_does_not_exist_is_refused_with_those_that_do(driver):
    name = dataclasses.fields(driver.Options)[0].name
    with pytest.raises(ConfigurationError) as caught:
        driver(**{name + "s": 1})
    assert caught.value.key == name + "s"
    assert f"{driver.__name__} has no such option; allowed: {name}" in str(caught.value)
    assert str(caught.value).endswith(f"; did you mean {name!r}?")


@pytest.mark.parametrize("driver", DRIVERS.values(), ids=DRIVERS)
def test_something_else_than_options_is_refused(driver):
    with pytest.raises(ConfigurationError, match="or keywords, not '/dev/hidraw0'"):
        driver("/dev/hidraw0")


def test_a_bad_value_is_refused_by_its_name():
    with pytest.raises(OptionError, match=r"dead_zone: 2.0 is not allowed") as caught:
        cardan.SpaceMouse(dead_zone=2.0)
    assert isinstance(caught.value, ValueError)


def test_a_path_may_be_a_path():
    path = Path("/dev/hidraw3")
    mouse = cardan.SpaceMouse(path=path)
    assert mouse.options == cardan.SpaceMouse.Options(path=path)
    assert mouse.options.path == "/dev/hidraw3"


# -- opening -----------------------------------------------------------------------------------


def test_a_device_is_opened_by_name_and_closed_by_with(tmp_path):
    path = str(tmp_path / "hid")
    with served("sim", "spacemouse", "--hid", path, "--script", "circle"):
        with cardan.open_device("spacemouse", transport="socket", path=path) as mouse:
            assert isinstance(mouse, cardan.SpaceMouse)
            assert next(state for state in mouse if state.link is DeviceLink.LIVE)
            assert mouse.read(10.0).link is DeviceLink.LIVE
        assert mouse.state().link is DeviceLink.CLOSED


def test_a_robot_is_opened_by_name():
    with cardan.open_robot("sim_arm", robot="ur5", pacing="virtual") as robot:
        assert next(robot.cycles()).link is cardan.RobotLink.LIVE


def test_an_options_object_opens_too():
    options = cardan.SimArm.Options(pacing="virtual")
    with cardan.open_robot("sim_arm", options) as robot:
        assert robot.options is options


def test_a_robot_is_no_device_and_the_other_way_round():
    with pytest.raises(ConfigurationError, match=r"'abb_egm' drives a robot: use open_rob"):
        cardan.open_device("abb_egm")
    with pytest.raises(ConfigurationError, match=r"'spnav' reads a device: use open_device\(\)"):
        cardan.open_robot("spnav")


def test_a_name_or_an_option_that_is_wrong_opens_nothing():
    with pytest.raises(
        ConfigurationError, match="there is no driver 'spacemous'; allowed: abb_egm"
    ):
        cardan.open_device("spacemous")
    for name in (["spacemouse"], None, cardan.SpaceMouse):
        with pytest.raises(ConfigurationError, match=r"^driver: .* it must be one of abb_egm, "):
            cardan.open_device(name)
    with pytest.raises(ConfigurationError, match="did you mean 'path'"):
        cardan.open_device("spacemouse", pth="/dev/hidraw0")


def test_what_is_not_there_is_an_error_in_words(tmp_path):
    with pytest.raises(DeviceNotFoundError, match="there is no socket at"):
        cardan.open_device("spacemouse", transport="socket", path=str(tmp_path / "none"))


def test_what_is_found_names_its_driver(monkeypatch):
    for driver in DRIVERS.values():
        if issubclass(driver, OperatorDevice):
            monkeypatch.setattr(driver, "find", classmethod(lambda cls: []))
    found = FoundDevice("SpaceNavigator", "046d:c626", "hidraw", "/dev/hidraw3")
    monkeypatch.setattr(cardan.SpaceMouse, "find", classmethod(lambda cls: [found]))
    assert cardan.devices() == [found._replace(driver="spacemouse")]


# -- states ------------------------------------------------------------------------------------


def test_axes_have_names_and_stay_a_tuple():
    axes = Axes(0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    assert (axes.x, axes.y, axes.z, axes.roll, axes.pitch, axes.yaw) == axes
    assert axes[:3] == (0.1, 0.2, 0.3)


@pytest.mark.parametrize(
    "driver", [each for each in DRIVERS.values() if issubclass(each, OperatorDevice)]
)
def test_every_device_gives_axes_by_name(driver):
    axes = driver().state().axes
    assert isinstance(axes, Axes)
    assert axes == NEUTRAL


def test_a_driver_that_is_not_open_has_nothing_to_read():
    for driver in DRIVERS.values():
        if issubclass(driver, OperatorDevice):
            with pytest.raises(DriverError, match=f"{driver.__name__} is not open"):
                driver().read()


def test_every_driver_is_a_context_manager():
    for driver in DRIVERS.values():
        assert issubclass(driver, Driver)
        assert callable(driver.__enter__)
        assert callable(driver.__exit__)
