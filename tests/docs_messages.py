"""Every message that Cardan can say, from its sources: docs/messages/*.md (``make docs-tables``).

A message is the text of an error that is raised, and a text that a state, a view, a log or a reply
gives as its reason. Where a value stands in it, its name is in capitals, as in a manual. What to do
is what the message itself says, what ADVICE says of it, or what is right for its kind of error
(docs/errors.md) or for its part. test_docs_messages holds the pages current.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "cardan"
PLUGINS = ROOT / "plugins"
BESIDE = ("studies", "plugins/cardan-*/*")
"""Packages of other distributions of this repository, by their folders."""
FOLDER = ROOT / "docs" / "messages"
HEAD = "<!-- made by tests/docs_messages.py -->\n"


class Part(NamedTuple):
    """Of the sources, and of a page."""

    title: str
    sources: tuple[str, ...]
    """Folders and files below cardan/; the first part that has a file, has it."""
    advice: str
    """Where neither the message nor its kind says what to do."""


class Page(NamedTuple):
    title: str
    intro: str
    parts: tuple[Part, ...]


def _driver(title: str, folder: str, page: str, *more: str) -> Part:
    advice = f"[{title}](../{page}) has each situation; `cardan doctor FILE`"
    own = folder if "/" in folder else f"drivers/{folder}"
    return Part(title, (own, *more), advice)


PAGES = {
    "settings": Page(
        "Messages about files, options and commands",
        "Of `cardan check`, `cardan run` and every other command, before anything moves. The name before "
        "the message is the key's, as it stands in the file.",
        (
            Part(
                "Arms and their files",
                ("robots", "gateway/kinematics"),
                "correct the arm's file: [keys](../robots.md#keys-of-the-toml)",
            ),
            Part(
                "An arm of one's own",
                ("own_arm",),
                "[own arms](../robots.md#adding-your-own)",
            ),
            Part(
                "Filters and the hand's mapping",
                ("gateway/operator",),
                "[mapping](../configuration.md#mapping), [shared control](../shared-control.md)",
            ),
            Part(
                "Session files",
                (
                    "gateway/session/config.py",
                    "gateway/session/assembly.py",
                    "demos/examples.py",
                    "common/tables.py",
                    "common/options.py",
                    "common/bounds.py",
                    "common/plugins.py",
                    "common/files.py",
                    "errors.py",
                    "common/histogram.py",
                    "__init__.py",
                ),
                "correct the setting: [configuration](../configuration.md)",
            ),
            Part(
                "The command line",
                (
                    "cli",
                    "common/output.py",
                    "common/logs.py",
                    "common/signals.py",
                    "common/resource_errors.py",
                    "common/text_sanitizer.py",
                ),
                "`cardan COMMAND --help`; [exit codes](../first-ten-minutes.md#ctrl-c-and-exit-codes)",
            ),
            Part(
                "Evaluation",
                ("studies",),
                "[evaluation](../evaluation.md); a quiet machine",
            ),
            Part(
                "Values",
                ("types.py", "common/value_json.py"),
                "[frames, orders and units](../values.md)",
            ),
            Part(
                "What is not installed",
                ("common/extras.py", "common/arm_libraries.py", "common/native.py"),
                "[installing](../installing.md)",
            ),
        ),
    ),
    "devices": Page(
        "Messages of operator devices",
        "Of the driver when it opens, and of the device's state while it is open: then the axes are zero, "
        "and the arm brakes or stands.",
        (
            _driver(
                "3Dconnexion devices",
                "spacemouse",
                "spacemouse.md",
                "cardan-serial-mice/cardan_serial_mice/driver",
            ),
            _driver("spacenavd", "spnav", "spnav.md", "cardan-spnav-server/cardan_spnav_server"),
            _driver("Wii Remote", "cardan-wiimote/cardan_wiimote/driver", "wiimote.md"),
            _driver("Leap Motion", "cardan-leap/cardan_leap/driver", "leap.md"),
            _driver("Gamepads", "gamepad", "gamepad.md", "drivers/evdev"),
            _driver("Keyboards", "keyboard", "keyboard.md"),
            _driver("JR3 force-torque sensor", "cardan-jr3/cardan_jr3/driver", "jr3.md"),
            _driver(
                "Phantom Omni and Touch",
                "cardan-omni/cardan_omni/driver",
                "omni.md",
                "drivers/haptic.py",
                "common/haptics.py",
            ),
            _driver("Phones and headsets", "handheld", "phone.md"),
            _driver("Devices of ROS 2", "ros2_nodes", "ros2-joy.md", "drivers/node_options.py"),
            _driver("Devices on another computer", "remote", "remote.md"),
        ),
    ),
    "robots": Page(
        "Messages of robots",
        "Of the driver when it opens, of the robot's state while it does not act on commands, and of "
        "`diagnosis()`.",
        (
            _driver("ABB over EGM", "abb_egm", "abb-egm.md"),
            _driver("Motoman over MotoROS", "motoros", "motoman.md"),
            _driver("Universal Robots over RTDE", "ur_rtde", "universal-robots.md", "protocols/ur"),
            _driver("An arm of a ROS 2 system", "ros2_arm", "ros2-arm.md"),
            _driver("The simulated arm", "sim_arm", "simulated-arm.md", "drivers/simulated.py"),
            Part(
                "All drivers",
                (
                    "drivers",
                    "api.py",
                    "common/context.py",
                    "common/sockets.py",
                    "common/realtime.py",
                ),
                "`cardan devices`, `cardan doctor FILE`; `diagnosis()` of the driver",
            ),
        ),
    ),
    "motion": Page(
        "Messages about motion",
        "Why the arm stands, why it was stopped, and why a verb was refused. What was refused changed "
        "nothing. [Who may move the arm, and what stops it](../who-moves-the-arm.md).",
        (
            Part(
                "Verbs, streams and supervision",
                ("gateway/arm", "common/braking.py", "spatial.py"),
                "[what stops it](../who-moves-the-arm.md#what-stops-it) has each cause, and how to go on",
            ),
            Part(
                "Paths and the servo",
                ("gateway/motion", "gateway/servo"),
                "choose another pose, a shorter way or a slower motion: [the servo](../servo.md)",
            ),
            Part(
                "Force",
                ("gateway/force",),
                "[force feedback](../force-feedback.md#when-the-force-is-lost)",
            ),
            Part(
                "Sessions",
                ("gateway/session", "demos", "common"),
                "[what stops it](../who-moves-the-arm.md#what-stops-it); `cardan doctor FILE`",
            ),
        ),
    ),
    "network": Page(
        "Messages of the network, the daemon and records",
        "Of sessions with `[network]`, of faces and programs that meet them, of `cardan serve`, and of "
        "`cardan record`, `replay`, `plot` and `export`.",
        (
            Part(
                "The daemon",
                ("gateway/daemon",),
                "[the daemon](../daemon.md); `cardan ps`, `cardan log`",
            ),
            Part(
                "Records",
                ("recording",),
                "[recording and replay](../recording.md), [data sets](../lerobot.md#records-as-data-sets)",
            ),
            Part(
                "Robot learning",
                ("learning", "cardan-learning/cardan_learning"),
                "[LeRobot](../lerobot.md)",
            ),
            Part(
                "Commands from the network",
                ("gateway/bus",),
                "[ROS 2: bad input](../ros2.md#bad-input), [results](../ros2.md#results)",
            ),
            Part(
                "The console's page",
                ("gateway/servers/console",),
                "[why it does not move](../console.md#why-it-does-not-move)",
            ),
            Part(
                "Faces",
                (
                    "gateway/servers",
                    "cardan-dds/cardan_dds/face.py",
                    "cardan-dds/cardan_dds/bridge.py",
                    "cardan-foxglove/cardan_foxglove",
                ),
                "[faces](../ros2.md#faces), [security](../security.md)",
            ),
            Part(
                "The bus",
                ("bus", "cardan-dds/cardan_dds"),
                "`cardan network FILE`; [routers](../ros2.md#routers-and-several-computers)",
            ),
        ),
    ),
    "peers": Page(
        "Messages of simulated peers and captures",
        "Of `cardan sim`, of `cardan dissect`, and of codecs that a program of yours calls.",
        (
            Part(
                "Simulated peers",
                (
                    "sim_peers",
                    "cardan-jr3/cardan_jr3/peer",
                    "cardan-leap/cardan_leap/peer",
                    "cardan-omni/cardan_omni/peer",
                    "cardan-wiimote/cardan_wiimote/peer",
                ),
                "`cardan sim NAME --help`; [simulated peers](../simulated-peers.md)",
            ),
            Part(
                "Captures",
                ("cardan-dissect/cardan_dissect",),
                "`cardan dissect` reads pcap, pcapng and logs of a CAN bus",
            ),
            Part(
                "Conformance",
                (
                    "conform",
                    "cardan-conform-arms/cardan_conform_arms",
                    "cardan-jr3/cardan_jr3/conform",
                    "cardan-leap/cardan_leap/conform",
                    "cardan-omni/cardan_omni/conform",
                    "cardan-serial-mice/cardan_serial_mice/conform",
                    "cardan-spnav-server/cardan_spnav_server/conform",
                    "cardan-wiimote/cardan_wiimote/conform",
                ),
                "`cardan conform --list`; [conformance](../conformance.md)",
            ),
            Part(
                "Protocols",
                (
                    "protocols",
                    "cardan-foxglove/cardan_foxglove/protocol.py",
                    "cardan-jr3/cardan_jr3/protocol",
                    "cardan-leap/cardan_leap/protocol",
                    "cardan-omni/cardan_omni/protocol",
                    "cardan-wiimote/cardan_wiimote/protocol",
                ),
                "what was to be encoded or decoded breaks the protocol: its page says the bytes",
            ),
        ),
    ),
}
"""By the name of the file. The doctor's findings have a page of their own, docs/doctor.md."""

DOCTOR = Part("The doctor", ("doctor", "cardan-omni/cardan_omni/check.py"), "")

ADVICE = {
    r"not seen at rest yet": "let go of the device once: nothing moves by what was held when it was opened",
    r"at rest|let go of": "do so: what was held while something was lost does not move the arm later",
    r"^press |to move$|to go on$": "the deliberate act: [how](../who-moves-the-arm.md#re-arming-the-deliberate-act)",
    r"has authority over the arm": "wait until its lease ends (2 s), have it handed over, or stop it: "
    "[authority](../who-moves-the-arm.md#sources-and-authority)",
    r"something else holds it": "look what holds the arm; free it, then the deliberate act",
    r"stood still for": "close what else is busy here; "
    "[scheduling](../first-ten-minutes.md#scheduling)",
    r"motors are off|servo power|drives? (is|are) off": "switch the motors on at the controller, then the deliberate act",
    r"emergency stop|e-stop|estop": "find out why; release it at the robot, acknowledge it there, then the deliberate act",
    r"no datagram|fell silent|was silent|no report|silent for|no state came|not heard": "look at cable, "
    "power, address and firewall: `cardan doctor FILE`",
    r"unplugged|no longer there|was closed|disconnected|connection .*(lost|ended|closed)|is gone": "plug "
    "it in or start it again: it is found by itself, and wants the deliberate act",
    r"[Pp]ermission|not allowed to open|may not (open|read)|access": "`cardan udev` prints the rules that "
    "give it; log in again",
    r"in use|already (open|has|runs|serves)": "end the other program, or choose another port or path",
    r"did you mean": "take what it proposes",
    r"\bis missing\b": "add it",
    r"there is no .*(key|option)": "correct the name: [configuration](../configuration.md)",
    r"cannot (read|open|write|make)|not (TOML|UTF-8)": "look at the file, its folder and its permissions",
    r"not finite|NaN|no number": "correct the value at its sender: nothing moves by it",
    r"older than|too old|stale|late\b": "look at the network and at what else is busy here; see "
    "[scheduling](../first-ten-minutes.md#scheduling)",
    r"joint .* (range|limit)|leave its range": "another pose or posture, or a shorter way",
    r"reach\b|joint positions put": "a pose that is nearer, or another tool",
    r"joints that are held": "what keeps [two arms](../daemon.md#two-arms) apart",
    r"meet|collision|obstacle": "another way, in several motions; or correct the obstacles",
    r"disk|No space": "make room",
}
"""By what a message has: what to do, where it does not say so itself."""

KINDS = {
    "OptionError": "give it a value that is allowed",
    "ConfigurationError": "correct the setting",
    "DeviceNotFoundError": "plug it in or switch it on; `cardan devices`",
    "DeviceAccessError": "give the permission (`cardan udev`), or end the other program",
    "AddressError": "correct the address, or end who has it",
    "NotOpenError": "call `open()`, or use it in `with`",
    "CommandError": "send what its `capabilities` name",
    "ExtraMissingError": "run the command that it names",
    "ExtraImportError": "run the command that it names",
    "ExtraNameError": "run the command that it names",
    "NativePartError": "install gcc, and Cardan anew",
    "ScriptError": "correct it: `--list-scripts`, `--list-faults`",
    "CaptureError": "check the file",
    "ControlError": "`cardan ps` shows what there is",
    "MotionRefusedError": "do what it says; nothing has changed",
    "OutOfReachError": "a pose that is nearer, or another tool",
    "JointLimitError": "another pose or posture, or a shorter way",
    "CollisionError": "go around in several motions, or correct the obstacles",
    "TrajectoryError": "[trajectories](../ros2.md#moveit)",
    "MotionLoopError": "read what ended it; open the arm again",
    "PacketError": "correct the request",
    "IoConnectionError": "check the network and MotoROS; after a write, read back",
    "IoRefusedError": "correct the address or the value",
}
"""By the error that is raised; in full in docs/errors.md."""

SAYS_SO = re.compile(
    r"(?:^|[:;,.] |, then |or )\(?(?:add|allow|ask|begin|bring|call|change|check|choose|clear|close|"
    r"connect|correct|decide|do|end|enter|find|free|give|go|hold|install|leave|let|lift|log|look|"
    r"lower|make|measure|move|name|open|pair|pip|plug|power|press|put|raise|read|release|remove|"
    r"replace|reset|restart|run|see|send|set|show|start|stop|switch|take|touch|try|turn|update|use|wait|"
    r"write)\b"
    r"|must be|it must|allowed:|there (?:is|are) only|which is at most|instead of|needs? "
)
"""A message that says what to do, or what is allowed."""

NO_MESSAGES = {"help", "epilog", "metavar", "short_help", "rich_help_panel", "panel", "metadata"}
"""Keywords whose texts are said elsewhere."""
DECLARED = {"summary", "gives", "suits", "takes_back", "speaks", "page", "description", "verbs"}
NO_CALLS = {
    "FaultSwitch", "Fault", "Switch", "option", "Option", "Argument", "compile", "argument",
    "debug", "info", "Counter", "Gauge", "field", "dedent", "split", "getLogger", "startswith",
    "endswith", "removeprefix", "removesuffix", "replace", "Struct", "namedtuple", "Choice",
}  # fmt: skip
SAID = re.compile(
    r"REASON|WHY|WORDS|MESSAGE|HINT|TODO|OBSTACLE|REFUS|SILENT|OPENED|RESUMED|LATE|FULL|VIEWER|LOST|"
    r"WARN|REMARK|ADVICE|GONE|MISSING|NOBODY|TEXT|PROBLEM"
)
"""Names of tables and constants whose texts are messages."""
WRONG = re.compile(r"_?(wrong|error|refusal)")
"""Functions that make an error of their text."""
RAISED_ONLY = (
    "sim_peers",
    "peer",
    "cardan_dissect",
    "dissect",
    "protocols",
    "protocol",
    "cli",
    "studies",
)
"""Folders and modules of which only errors are messages: their other texts are output, reports and scripts."""
FEWEST_WORDS = 3


class Message(NamedTuple):
    text: str
    kind: str
    """The error that has it; empty: a reason."""
    line: int


def text_of(node: ast.expr) -> str:
    """A literal's text, with the names of values in capitals; empty where it is none."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else ""
    if isinstance(node, ast.JoinedStr):
        return "".join(
            str(each.value) if isinstance(each, ast.Constant) else placeholder(each)
            for each in node.values
        )
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        left, right = text_of(node.left), text_of(node.right)
        return left + right if left and right else left or right
    return ""


def placeholder(node: ast.expr) -> str:
    """What stands for a value: the last name in the expression."""
    while True:
        if isinstance(node, ast.FormattedValue):
            node = node.value
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            node = node.args[0] if node.func.attr == "join" and node.args else node.func.value
        elif isinstance(node, ast.Call):
            node = node.args[0] if node.args else node.func
        elif isinstance(node, ast.Attribute):
            return _capitals(node.attr) or "VALUE"
        elif isinstance(node, ast.Name):
            return _capitals(node.id) or "VALUE"
        elif isinstance(node, (ast.Subscript, ast.Starred, ast.Await)):
            node = node.value
        elif isinstance(node, ast.BinOp):
            node = node.right if isinstance(node.left, ast.Constant) else node.left
        elif isinstance(node, ast.BoolOp):
            node = node.values[-1 if isinstance(node.op, ast.And) else 0]
        elif isinstance(node, ast.JoinedStr):
            return text_of(node)
        elif isinstance(node, ast.IfExp):
            node = node.body
        elif isinstance(node, ast.Constant):
            return str(node.value)
        else:
            return "..."


def _capitals(name: str) -> str:
    short = re.sub(r"_(s|m|rad|deg|hz|n)$", "", name.strip("_")).upper()
    return {"ERROR": "REASON", "WHY": "REASON", "NUMBER": "N", "SELF": "VALUE", "STR": "VALUE"}.get(
        short, short
    )


class Reader(ast.NodeVisitor):
    """Collects the messages of one file."""

    def __init__(self, errors_only: bool) -> None:
        self.found: list[Message] = []
        self._errors_only = errors_only

    def visit_Expr(self, node: ast.Expr) -> None:
        if not isinstance(node.value, ast.Constant):
            self.generic_visit(node)

    def visit_keyword(self, node: ast.keyword) -> None:
        if node.arg not in NO_MESSAGES:
            self.visit(node.value)

    def visit_Assert(self, node: ast.Assert) -> None:
        """Never seen by a user."""

    def visit_Compare(self, node: ast.Compare) -> None:
        """What is compared with is no message."""

    def visit_arguments(self, node: ast.arguments) -> None:
        """Defaults and annotations are none, either."""

    def _assigned(self, targets: list[ast.expr], value: ast.expr | None) -> None:
        names = [each.id for each in targets if isinstance(each, ast.Name)]
        constant = any(name.strip("_").isupper() for name in names)
        if any(name in DECLARED for name in names) or (
            constant and not any(SAID.search(name) for name in names)
        ):
            return
        if value is not None:
            self.visit(value)

    def visit_Assign(self, node: ast.Assign) -> None:
        self._assigned(node.targets, node.value)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        self._assigned([node.target], node.value)

    def visit_Call(self, node: ast.Call) -> None:
        name = node.func.attr if isinstance(node.func, ast.Attribute) else ""
        name = node.func.id if isinstance(node.func, ast.Name) else name
        if name in NO_CALLS:
            return
        if name.endswith("Error"):
            texts = [text_of(each) for each in node.args]
            if name == "OptionError" and len(node.args) == 3:
                allowed = texts[2] or placeholder(node.args[2])
                key = texts[0] or placeholder(node.args[0])
                self._add(
                    f"{key}: VALUE is not allowed; it must be {allowed}", name, node.lineno, 0
                )
            elif texts and max(texts, key=len):
                self._add(max(texts, key=len), name, node.lineno, 2)
            for each in node.args:
                if not text_of(each):
                    self.visit(each)
            return
        if WRONG.fullmatch(name):
            for each in node.args:
                self._add(text_of(each), "ConfigurationError", node.lineno, 2)
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        self._reason(node)

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        self._reason(node)

    def visit_BinOp(self, node: ast.BinOp) -> None:
        if text_of(node):
            self._reason(node)
        else:
            self.generic_visit(node)

    def _reason(self, node: ast.expr) -> None:
        if not self._errors_only:
            self._add(text_of(node), "", node.lineno, FEWEST_WORDS)

    def _add(self, text: str, kind: str, line: int, fewest: int) -> None:
        text = " ".join(text.split()).strip(" ;:,")
        words = re.findall(r"(?<![\w.])[a-z][a-z']*(?![\w.=/])", text)
        if len(words) < fewest or re.search(r"</|\$\(|\\[dws]|=\"|^[-/{<%#\[]|[{}]", text):
            return
        self.found.append(Message(text, kind, line))


def inside(path: Path) -> Path:
    """Where a source is in Cardan's package, in a plug-in's folder, or in the source tree."""
    if path.is_relative_to(PACKAGE):
        return path.relative_to(PACKAGE)
    return path.relative_to(PLUGINS if path.is_relative_to(PLUGINS) else ROOT)


def messages_of(path: Path) -> list[Message]:
    """Of one file, in its order."""
    reader = Reader(not {*inside(path).parts[:3], path.stem}.isdisjoint(RAISED_ONLY))
    reader.visit(ast.parse(path.read_text(encoding="utf-8")))
    return sorted(reader.found, key=lambda message: message.line)


def home(path: Path) -> Part | None:
    """The part with the most of the path; None: none has it."""
    place = inside(path).as_posix()
    _, part = max(
        (
            (len(source), part)
            for part in (DOCTOR, *(part for page in PAGES.values() for part in page.parts))
            for source in part.sources
            if place == source or place.startswith(f"{source}/")
        ),
        default=(0, None),
        key=lambda found: found[0],
    )
    return part


def files() -> dict[str, list[Path]]:
    """The sources of each part, by its title."""
    found: dict[str, list[Path]] = {}
    beside = [
        path
        for folders in BESIDE
        for folder in ROOT.glob(folders)
        for path in folder.rglob("*.py")
        if "tests" not in inside(path).parts
    ]
    for path in sorted((*PACKAGE.rglob("*.py"), *beside)):
        if (part := home(path)) is not None:
            found.setdefault(part.title, []).append(path)
    return found


def what_to_do(message: Message, part: Part) -> str:
    """The advice for a message."""
    if SAYS_SO.search(message.text):
        return "as it says"
    for pattern, advice in ADVICE.items():
        if re.search(pattern, message.text):
            return advice
    return KINDS.get(message.kind, part.advice)


def cell(text: str) -> str:
    return re.sub(r"([|<*_`\[\]])", r"\\\1", text)


def page_text(page: Page, sources: Mapping[str, Sequence[Path]]) -> str:
    """One page, ready to be written."""
    made = [f"# {page.title}\n\n{HEAD}\n{page.intro} Words in CAPITALS stand for values.\n"]
    for part in page.parts:
        rows: dict[str, str] = {}
        for path in sources.get(part.title, ()):
            for message in messages_of(path):
                rows.setdefault(cell(message.text), what_to_do(message, part))
        if not rows:
            continue
        made.append(f"\n## {part.title}\n\n| message | what to do |\n|---|---|\n")
        lines = sorted(rows.items(), key=lambda row: row[0].lstrip("\\'\"").lower())
        made += [f"| {message} | {advice} |\n" for message, advice in lines]
    return "".join(made)


def pages() -> dict[str, str]:
    """The text of every page, by its name."""
    sources = files()
    return {name: page_text(page, sources) for name, page in PAGES.items()}


def main() -> None:
    """Write the pages."""
    FOLDER.mkdir(exist_ok=True)
    for name, text in pages().items():
        (FOLDER / f"{name}.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
