"""`cardan devices share`: errors of its command line come before it opens anything, and changes
during sharing are reported once."""

import sys
from collections import Counter

import pytest

from cardan.errors import ConfigurationError
from cardan.gateway.bus.sharing import News
from cardan.types import NEUTRAL, DeviceLink, DeviceState
from tests.command_line import the_command_line

NO_DEVICE = '[robot]\ndriver = "sim_arm"\n'


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["spacemouse", "--router", "tcp/a:1", "--listen", "tcp/b:1"], "give one of them"),
        (["spacemouse", "--listen", "tcp/b:1", "--zenoh-config", "x"], "give one of them"),
        (["spacemouse", "--router", "nonsense"], "--router: .*an endpoint of Zenoh"),
        (["spacemouse", "--listen", "nonsense"], "--listen: .*an endpoint of Zenoh"),
        (["spacemouse", "--name", "a b"], "--name: .*a name of ROS 2"),
        (["spacemouse", "--name", "a/b"], "--name: .*a name without /"),
        (["spacemice"], "spacemice.*did you mean 'spacemouse'"),
        (["sim_arm"], "'sim_arm' is not an operator device"),
        (["none.toml"], "none.toml"),
        (["robot.toml"], "robot.toml.*device"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot.toml").write_text(NO_DEVICE, encoding="utf-8")
    command_line = the_command_line()
    # The log of this process is not changed.
    monkeypatch.setattr(sys.modules["cardan.cli.share"], "begin_serving", lambda *_: None)
    with pytest.raises(ConfigurationError, match=said):
        command_line.main(["devices", "share", *words], standalone_mode=False)


def there(link=DeviceLink.LIVE, reason=""):
    return DeviceState(1.0, link, NEUTRAL, frozenset(), reason=reason)


def test_who_shares_is_reported_each_change_once():
    news, counts = News("tcp/a:1", routed=True), Counter()
    assert news.of(there(), "", counts) == []
    lost = there(DeviceLink.LOST, "unplugged")
    assert news.of(lost, "arm at robot", counts) == [
        "there is no device: unplugged",
        "used by arm at robot",
    ]
    counts["claims while another session has it"] += 1
    counts["edges that were not acknowledged in time"] += 1
    assert news.of(lost, "arm at robot", counts) == [
        "refused: claims while another session has it",
        "edges that were not acknowledged in time",
    ]
    counts["claims while another session has it"] += 1
    assert news.of(lost, "arm at robot", counts) == []
    assert news.of(there(), "", counts) == ["the device is there", "not in use"]


def test_who_shares_is_reported_the_router_and_of_others():
    news = News("tcp/a:1", routed=True)
    assert news.of_bus([], routed=True) == []
    (line,) = news.of_bus([], routed=False)
    assert "the router tcp/a:1 cannot be reached" in line
    assert news.of_bus([], routed=False) == []
    assert news.of_bus([], routed=True) == ["the router tcp/a:1 is there again"]
    (line,) = news.of_bus(["/cardan_share_hand"], routed=True)
    assert "/cardan_share_hand shares under this name, too" in line
    assert news.of_bus(["/cardan_share_hand"], routed=True) == []
    assert len(news.of_bus(["/cardan_share_hand", "/other"], routed=True)) == 1


def test_who_needs_no_router_is_reported_none():
    news = News("", routed=False)
    assert news.of_bus([], routed=False) == []
