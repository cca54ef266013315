"""`cardan share`: what is wrong on its command line is said before anything is opened."""

import sys

import pytest

from cardan.errors import ConfigurationError
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
    # The log of this process stays as it is.
    monkeypatch.setattr(sys.modules["cardan.cli.share"], "begin_serving", lambda *_: None)
    with pytest.raises(ConfigurationError, match=said):
        command_line.main(["share", *words], standalone_mode=False)
