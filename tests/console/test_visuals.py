"""The console page in a real browser shows an arm by its visual meshes, if it has them."""

from __future__ import annotations

from importlib.resources import files

import pytest

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install cardan[network]")
pytest.importorskip("pinocchio", reason="pin is not installed: pip install cardan[arm]")

from cardan.robots import load_arm
from tests.console.page_input import RELOADED
from tests.console.served_arm import served_arm

pytestmark = pytest.mark.matrix  # The browser draws by software.

OBJ = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
VISUAL = (
    '<link name="{}_link"><visual><origin xyz="0 0 0.05"/><geometry><mesh filename="{}" '
    'scale="2 2 2"/></geometry><material name="red"><color rgba="0.8 0.1 0.1 1"/></material>'
    "</visual>"
)
LOOKS = "document.querySelector('.picture').dataset.looks"
REPORTED = "document.body.textContent.includes({!r})"


@pytest.fixture(scope="module")
def address(built, tmp_path_factory):
    """Address of a page that shows a UR5 of which three links have meshes, one of them damaged."""
    folder = tmp_path_factory.mktemp("session")
    text = (files("cardan") / "robots" / "ur5.urdf").read_text(encoding="utf-8")
    for link, file in (("upper_arm", "one.obj"), ("forearm", "one.obj"), ("wrist_1", "bad.stl")):
        before = f'<link name="{link}_link">'
        assert before in text
        text = text.replace(before, VISUAL.format(link, file))
    (folder / "one.obj").write_text(OBJ)
    (folder / "bad.stl").write_text("solid")
    (folder / "own.urdf").write_text(text)
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setenv("CACHE_DIRECTORY", str(folder / "cache"))
        load_arm(str(folder / "own.urdf"))  # fills the cache, so that the session starts at once
        with served_arm(folder, built, model=str(folder / "own.urdf")) as (_, address):
            yield address


def test_links_are_shown_as_they_look_and_by_their_bodies_where_that_is_not_known(address, browser):
    with browser.open(address) as page:
        page.until(RELOADED)
        page.until(f"{LOOKS} === '2'")
        page.click("#tab-setup")
        page.until(REPORTED.format("1 of 2 visual meshes are not shown, bodies stand in for them"))
        asked = "performance.getEntriesByType('resource').map(each => new URL(each.name).pathname)"
        (mesh,) = [each for each in page.value(asked) if each.startswith("/visuals/")]
        assert len(mesh) == len("/visuals/") + 64
        box = (
            "[...document.querySelectorAll('.check')]"
            ".find(each => each.textContent.startsWith('The arm as it looks'))"
            ".querySelector('input')"
        )
        page.value(f"{box}.click()")
        assert page.value(LOOKS) == "0"
        page.value(f"{box}.click()")
        assert page.value(LOOKS) == "2"
