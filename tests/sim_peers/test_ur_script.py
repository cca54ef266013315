"""URScript in the simulated controller: results of programs, threads, and sockets."""

from __future__ import annotations

import contextlib
import math
import socket
import time

import pytest

from cardan.protocols.ur.script import LARGEST, Program, parse, whole
from cardan.protocols.ur.states import RobotMode, RuntimeState, SafetyMode
from cardan.sim_peers.ur_controller import UrController, UrControllerOptions
from cardan.sim_peers.ur_controller.language import TOO_MUCH_BEHIND, TOO_MUCH_TIME, TWO_THREADS
from cardan.sim_peers.ur_controller.machine import MOST_STEPS, Machine
from cardan.sim_peers.ur_controller.operators import text
from cardan.sim_peers.ur_controller.tcp import UrControllerPeer
from cardan.sim_peers.ur_controller.values import UrPose


class World:
    """Controller in virtual time, with the output of its program."""

    def __init__(self, program, frames=0, **options):
        self.controller = UrController(
            UrControllerOptions(running=True, program_start_s=0.0, **options)
        )
        self.now_s = 0.0
        self.said = []
        self.controller._said = self.said.append
        self.controller.functions["textmsg"] = self.controller.functions["textmsg"]._replace(
            do=lambda s1, s2: self.said.append(text(s1) + text(s2))
        )
        self.controller.advance(0.0)
        self.controller.upload(program)
        self.run(frames)

    def run(self, frames=1):
        for _ in range(frames):
            self.now_s += self.controller.period_s
            self.controller.advance(self.now_s)
        return self

    @property
    def events(self):
        return " | ".join(text for _, text in self.controller.events)


def lines(body):
    return "def test():\n" + "".join(f"  {each}\n" for each in body.splitlines()) + "end\n"


def computed(expression, before=""):
    """Return the value of an expression."""
    controller = UrController(UrControllerOptions(running=True))
    program = parse(lines(f"{before}\nfound = {expression}\nsync()"))
    assert isinstance(program, Program), program
    machine = Machine(0.002)
    whole(machine.load(program, controller.functions))
    machine.step(lambda action: None)
    return machine.variables["found"]


def said(body, frames=10):
    world = World(lines(body), frames)
    assert "exception" not in world.events, world.events
    return world.said


def failure(body, frames=60):
    world = World(lines(body), frames)
    assert "exception" in world.events, world.events
    return world.events


# -- computations ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ("7 / 2", 3.5),
        ("7 % 4", 3),
        ("2 + 3 * 4 - -1", 15),
        ("0x10 + 1", 17),
        ("0xFFFFFFFF", -1),
        ("not (1 > 2) and 3 != 4 or False", True),
        ("True xor True", False),
        ("1 == 1.0", True),
        ("[1, 2, 3] + [10, 20, 30]", [11, 22, 33]),
        ("[10, 20, 30] % [3, 7, 11]", [1, 6, 8]),
        ("10 / [10, 20]", [1.0, 0.5]),
        ("-3 * [1, 2] + [1, 1]", [-2, -5]),
        ("-[1, 2]", [-1, -2]),
        ("[[1,2],[3,4],[5,6]] * [[10,20,30],[40,50,60]]", None),
        ("[[1,2],[3,4],[5,6]] * [10, 20]", [50, 110, 170]),
        ("5 * [[1,2],[3,4]]", [[5, 10], [15, 20]]),
        ("[[1,2],[3,4]][1, 0]", 3),
        ("[[1,2],[3,4]][1][0]", 3),
        ("p[1,2,3,4,5,6][2]", 3.0),
        ("p[1,2,3,4,5,6]", UrPose((1.0, 2.0, 3.0, 4.0, 5.0, 6.0))),
        ('"abc"[1]', "b"),
        ("struct(a=1, b=[2, 3]).b[1]", 3),
        ("sin(d2r(90))", 1.0),
        ("r2d(atan2(1, 1))", 45.0),
        ("ceil(1.2) + floor(-1.2)", 0),
        ("sqrt(pow(3, 2) + pow(4, 2))", 5.0),
        ("log(2, 8)", 3.0),
        ("norm([3, 4])", 5.0),
        ("normalize([0, 2])", [0.0, 1.0]),
        ("length([1, 2, 3]) + get_list_length([])", 3),
        ("size([[1, 2, 3], [4, 5, 6]])", [2, 3]),
        ("transpose([[1, 2], [3, 4]])", [[1, 3], [2, 4]]),
        ("inv([[2, 0], [0, 4]]) * [[2, 0], [0, 4]]", [[1.0, 0.0], [0.0, 1.0]]),
        ("binary_list_to_integer([True, False, True])", 5),
        ("integer_to_binary_list(-1)", [True] * 32),
        ('str_cat("a=", [1, 2.5, True])', "a=[1, 2.5, True]"),
        ("to_str(p[1,2,3,4,5,6])", "p[1, 2, 3, 4, 5, 6]"),
        ("to_str(2.123456123456)", "2.12346"),
        ('str_at("Hello", 1)', "e"),
        ('str_find("Hello World!", "o", 5)', 7),
        ('str_find("Hello", "x")', -1),
        ('str_len("") + str_len("abc")', 3),
        ('str_sub("0123456789abcdefghij", 5, 3)', "567"),
        ('str_sub("0123456789", 5)', "56789"),
        ('str_empty("")', True),
        ('to_num("12") + to_num("0.5")', 12.5),
        ("get_steptime()", 0.002),
        ("time().sec", 0),
        ("(\n  1 +\n  2)", 3),
    ],
)
def test_expressions(expression, value):
    found = computed(expression)
    if value is None:
        assert found == [[90, 120, 150], [190, 260, 330], [290, 400, 510]]
    elif isinstance(value, float):
        assert found == pytest.approx(value)
    else:
        assert found == value
        assert type(found) is type(value)


def test_lists_are_values():
    before = """
a = [1, 2, 3]
b = a
b[0] = 10
m = [[1, 2], [3, 4]]
n = m
n[1, 0] = 30
n[0][1] = 20
s = struct(x=1, y=[1, 2])
t = s
t.y[1] = 7
q = p[1, 2, 3, 4, 5, 6]
q[0] = 9
def changed(l):
  l[0] = 5
  return l
end
c = changed(a)"""
    assert computed("to_str([a[0], b[0], c[0]])", before) == "[1, 10, 5]"
    assert computed("m", before) == [[1, 2], [3, 4]]
    assert computed("n", before) == [[1, 20], [30, 4]]
    assert computed("s.y", before) == [1, 2]
    assert computed("t.y", before) == [1, 7]
    assert computed("q[0]", before) == 9.0


def test_scopes():
    """Examples of the script manual, with their results."""
    before = """
a = 0
def mine():
  local a = 1
  def inner():
    a = 2
  end
  inner()
  return a
end
b = mine()
def free():
  c = 3
  global d = 4
  return c
end
e = free()"""
    assert computed("[a, b, d, e]", before) == [2, 1, 4, 3]
    assert "c has no value" in failure(before + "\nx = c")


def test_functions_have_defaults_names_and_recursion():
    before = """
def power(base, exponent=2):
  if exponent == 0:
    return 1
  end
  return base * power(base, exponent - 1)
end"""
    assert computed("[power(3), power(2, 10), power(exponent=3, base=4)]", before) == [9, 1024, 64]


def test_switch_and_loops():
    body = """
n = 0
while True:
  n = n + 1
  switch n:
    case 1:
      textmsg("one")
    case 2:
      textmsg("two")
    default:
      textmsg("many")
  end
  if n == 2:
    continue
  elif n == 4:
    break
  end
  sync()
end
textmsg("end ", n)"""
    assert said(body) == ["one", "two", "many", "many", "end 4"]


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("x = nothing()", "line 2: compile_error_name_not_found:nothing:"),
        ('x = "a" + 1', "'a' is not a number"),
        ("x = [1, 2] + [1]", "lists of 2 and 1"),
        ("x = [[[1]]]", "a matrix has two dimensions"),
        ("x = [[1, 2]] * [1]", "sizes of the matrices"),
        ('x = p[1, 2, 3, 4, 5, "a"]', "a in a pose is not a number"),
        ("x = [1][True]", "a list of 1 has no element True"),
        ("x = sqrt(-1)", "sqrt()"),
        ("x = normalize([0, 0])", "normalize(): v has no direction"),
        ("x = log(1, 2)", "log()"),
        ('x = to_num("x")', "'x' is not a number"),
        ("x = struct(a=1)\ny = x.b", "there is no member b"),
        ("def f():\n  sync()\nend\nx = f()", "f() returns no value"),
        ("def f(a):\n  return a\nend\nx = f()", "f(): a is missing"),
        ("movej([0,0,0,0,0,0], a=1, a=2)", "line 2: movej(): a is given twice"),
        ("movej([0,0,0,0,0,0], q=[0,0,0,0,0,0])", "line 2: movej(): q is given twice"),
        ("def f(a):\n  return a\nend\nx = f(a=1, a=1)", "f(): a is given twice"),
        ('x = 1\nkill "a"', "line 3: kill: 'a' is not a thread"),
        ("join [1]", "join: '[1]' is not a thread"),
        ("kill True", "kill: 'True' is not a thread"),
        ("def f(a):\n  return f(a)\nend\nx = f(1)", "functions call each other"),
        ("thread t():\n  sync()\nend\nt()", "t is a thread"),
        ('set_digital_out(0, "on")', "neither True nor False"),
        ("set_standard_digital_out(8, True)", "n is 8, which is not 0 to 7"),
        ('rtde_set_watchdog("actual_q", 10)', "RTDE has no input actual_q"),
        ('socket_open("127.0.0.1", 0)', "port is 0"),
    ],
)
def test_what_cannot_be_done_is_an_exception(body, words):
    assert words in failure(body)


# -- time and threads ------------------------------------------------------------------------------


def test_threads_run_beside_the_program_and_are_waited_for():
    body = """
count = 0
thread counts(most):
  while count < most:
    enter_critical
    count = count + 1
    exit_critical
    sync()
  end
end
handle = run counts(5)
join handle
textmsg("counted ", count)
join 0
other = run counts(1000)
sleep(0.01)
kill other
kill other
seen = count
sleep(0.01)
textmsg(seen == count and count > 5)"""
    assert said(body, 30) == ["counted 5", "True"]


def test_sync_and_sleep_take_the_controllers_time():
    world = World(lines("sleep(0.02)\ntextmsg(1)\nsync()\ntextmsg(2)"), 10)
    assert world.said == []
    assert world.run(1).said == ["1"]
    assert world.run(1).said == ["1", "2"]
    assert not world.controller.has_program


def test_two_threads_that_move_the_arm():
    body = """
thread moves():
  speedj([0.1, 0, 0, 0, 0, 0], 1.0, 0.1)
end
handle = run moves()
sync()
speedj([0.1, 0, 0, 0, 0, 0], 1.0, 0.1)"""
    assert TWO_THREADS in failure(body)
    after = body.replace("sync()", "sync()\nkill handle")
    assert World(lines(after), 30).controller.runtime is RuntimeState.PLAYING


@pytest.mark.parametrize(
    "body",
    [
        "while True:\nend",
        "while True:\n  x = 1\nend",
        "def f():\n  return True\nend\nwhile f():\nend",
        "thread t():\n  while True:\n    x = 1\n  end\nend\nh = run t()\nsync()",
        'while True:\n  x = to_str("a")\nend',
        "while True:\n  x = [0, 0] + [1, 1]\nend",
        "while True:\n  x = get_inverse_kin(get_actual_tcp_pose())\nend",
        f"m = [{', '.join(['[1, 2, 3]'] * 3_000)}]\nwhile True:\n  m[0, 0] = 1\nend",
    ],
)
def test_a_thread_that_never_lets_time_pass(body):
    before = time.process_time()
    assert TOO_MUCH_TIME in failure(body, 400)
    assert time.process_time() - before < 1.0


def test_a_long_program_is_compiled_in_portions_and_begins_then():
    """Later uploads wait, and the running program continues."""
    world = World(lines("n = 0\nwhile True:\n  n = n + 1\n  sync()\nend"), 5)
    long = lines('textmsg("long")\n' + "x = [1, -2 * (3 + 4)]\n" * 1_000 + "sync()")
    world.controller.upload(long)
    world.controller.upload('sec beside():\n  textmsg("sec")\nend\n')
    before = world.controller._program
    world.run(20)
    assert world.controller._program is before
    assert world.said == []
    assert world.controller.has_program
    world.run(1_000)
    assert world.said == ["sec", "long"]
    assert not world.controller.has_program


def test_a_stop_is_also_for_what_is_being_compiled():
    world = World("", 0)
    for _ in range(3):
        world.controller.upload(lines("x = [1, -2 * (3 + 4)]\n" * 1_000 + 'textmsg("long")'))
    assert world.controller.stop_program()
    assert not world.controller.has_program
    assert world.run(1_000).said == []


def test_a_chain_of_xor_takes_no_longer_than_any_other():
    assert computed(" xor ".join(["True"] * 99)) is True


def test_what_costs_more_counts_as_more():
    def steps(expression, before="pass"):
        controller = UrController(UrControllerOptions(running=True))
        program = parse(
            lines(f"{before}\np1 = get_actual_tcp_pose()\nsync()\nx = {expression}\nsync()")
        )
        machine = Machine(0.002)
        whole(machine.load(program, controller.functions))
        for _ in range(2):
            machine.step(lambda action: None)
        return MOST_STEPS - machine.steps[0]

    plain = steps("sin(1)")
    assert plain < 100
    assert plain + 150 < steps("pose_inv(p1)") < steps("get_inverse_kin(p1)") - 350
    zeros = "z = [" + ", ".join(["[0, 0]"] * 200) + "]"
    assert steps("z + z", zeros) < steps("z * [[0, 1], [2, 3]]", zeros) < 10_000


def test_too_many_threads_and_too_many_values():
    assert "100 threads already" in failure(
        "thread t():\n  sleep(100)\nend\nwhile True:\n  h = run t()\n  sync()\nend", 150
    )
    long = "x" * 1000
    zeros = ", ".join(["0"] * 10_000)
    body = f"""
l = [{zeros}]
n = 0
while n < 10000:
  l[n] = str_cat("{long}", n)
  n = n + 1
  if n % 20 == 0:
    sync()
  end
end"""
    assert "keeps too many values" in failure(body, 600)


def test_halt_ends_all_threads():
    body = """
thread halts():
  sync()
  halt
end
h = run halts()
while True:
  sync()
end"""
    assert "its end" in World(lines(body), 10).events


def test_single_commands_and_secondary_programs():
    world = World("set_digital_out(2, True)\n", 3)
    assert world.controller.io.digital_outputs == 4
    assert not world.controller.has_program
    world = World(lines("while True:\n  sync()\nend"), 3)
    world.controller.upload("sec beside():\n  set_tool_digital_out(0, True)\nend\n")
    assert world.controller.io.digital_outputs == 1 << 16
    world.run(3)
    assert world.controller.program_name == "test"
    assert world.controller.runtime is RuntimeState.PLAYING
    for body in ("sleep(0.1)", "speedj([0, 0, 0, 0, 0, 0], 1, 1)"):
        world.controller.upload(f"sec beside():\n  {body}\nend\n")
        assert TOO_MUCH_BEHIND in world.events
    assert world.run(3).controller.runtime is RuntimeState.PLAYING


# -- inputs, outputs, messages ---------------------------------------------------------------------


def test_registers_and_io():
    controller = World("").controller
    controller.registers.input_bit[70] = True
    world = World(
        lines(
            """
write_output_boolean_register(64, True)
write_output_float_register(3, 0.5)
write_output_integer_register(4, 7)
set_standard_analog_out(1, 0.25)
set_tool_voltage(24)
set_flag(3, True)
textmsg(read_output_boolean_register(64))
textmsg(read_output_float_register(3) + read_output_integer_register(4))
textmsg([get_flag(3), get_standard_analog_out(1), get_digital_in(8), get_digital_out(0)])
textmsg(read_input_boolean_register(70))"""
        ),
        3,
    )
    assert world.said == ["True", "7.5", "[True, 0.25, False, False]", "False"]
    assert world.controller.registers.output_bit[64]
    assert world.controller.io.tool_voltage == 24


def test_a_popup_that_blocks_waits_until_it_is_closed():
    world = World(lines('popup("look", blocking=True)\ntextmsg("went on")'), 10)
    assert world.controller.popups.shown.text == "look"
    assert world.said == []
    world.controller.popups.close()
    assert world.run(1).said == ["went on"]


def test_a_program_that_stops_the_robot():
    world = World(lines('sync()\nprotective_stop()\ntextmsg("no")'), 10)
    assert world.controller.safety is SafetyMode.PROTECTIVE_STOP
    assert world.said == []
    world = World(lines("powerdown()"), 10)
    assert world.controller.mode is RobotMode.POWER_OFF
    assert not world.controller.has_program


@pytest.mark.parametrize(
    ("action", "state"),
    [
        ("ignore", RuntimeState.PLAYING),
        ("pause", RuntimeState.PAUSED),
        ("stop", RuntimeState.STOPPED),
    ],
)
def test_the_watchdog_of_rtde(action, state):
    body = f'rtde_set_watchdog("input_int_register_0", 50, "{action}")\nwhile True:\n  sync()\nend'
    world = World(lines(body), 3)
    for _ in range(20):
        world.controller.watchdogs.fed(["input_int_register_0"], world.controller.time_s)
        world.run(5)
    assert world.controller.runtime is RuntimeState.PLAYING
    assert "watchdog" not in world.events
    world.run(20)
    assert world.controller.runtime is state
    assert f"input_int_register_0 was not written in time: {action}" in world.events


# -- sockets ---------------------------------------------------------------------------------------

OPEN = 'textmsg(socket_open("127.0.0.1", 50001, "s"))\n'


def connected(body, **options):
    world = World(lines(OPEN + body), 3, **options)
    (opening,) = world.controller.sockets.openings()
    assert opening[1:] == ("127.0.0.1", 50001)
    world.controller.sockets.opened(opening.number)
    world.run(1)
    assert world.said.pop(0) == "True"
    return world, opening.number


def sent(world):
    return b"".join(data for _, data in world.controller.sockets.outgoing())


def test_what_is_sent():
    world, number = connected(
        """
socket_send_string("ab", "s")
socket_send_line(12, "s")
socket_send_int(-2, "s")
socket_send_byte(255, "s")
textmsg(socket_set_var("x", 3, "s"))
textmsg(socket_send_string("lost", "nobody"))
socket_close("s")"""
    )
    world.run(1)
    assert sent(world) == b"ab12\n\xff\xff\xff\xfe\xffSET x 3\n"
    assert world.controller.sockets.closings() == [number]
    assert world.said == ["True", "False"]


@pytest.mark.parametrize(
    ("call", "data", "value"),
    [
        ('socket_read_binary_integer(2, "s")', b"\0\0\0\1\xff\xff\xff\xff", "[2, 1, -1]"),
        ('socket_read_byte_list(3, "s")', b"\1\2\xff", "[3, 1, 2, 255]"),
        ('socket_read_ascii_float(2, "s")', b"(1.5, -2)", "[2, 1.5, -2]"),
        ('socket_read_string("s")', b"hello", "hello"),
        ('socket_read_string("s", prefix=">", suffix="<")', b"x>in<", "in"),
        ('socket_read_string("s", "", "\\n", True)', b"a\n", "a"),
        ('socket_read_line("s")', b"line\nmore", "line"),
        ('socket_get_var("x", "s")', b"x 17\n", "17"),
    ],
)
def test_what_is_read_waits_for_all_of_it(call, data, value):
    world, number = connected(f"textmsg({call})")
    world.run(5)
    sent(world)
    assert world.said == []
    cut = 1 if call != 'socket_read_string("s")' else 0
    world.controller.sockets.data(number, data[:cut])
    world.run(5)
    assert world.said == []
    world.controller.sockets.data(number, data[cut:])
    world.run(1)
    assert world.said == [value]


@pytest.mark.parametrize(
    ("call", "value"),
    [
        ('socket_read_binary_integer(2, "s", 0.1)', "[0, -1, -1]"),
        ('socket_read_ascii_float(1, "s", 0.1)', "[0, nan]"),
        ('socket_read_line("s", 0.1)', ""),
    ],
)
def test_a_read_that_has_no_answer(call, value):
    world, _ = connected(f"textmsg({call})")
    world.run(48)
    assert world.said == []
    world.run(4)
    assert world.said == [value]


def test_a_socket_that_the_other_end_closes_lets_time_pass():
    world, number = connected(
        """
n = 0
while True:
  found = socket_read_byte_list(1, "s", 0)
  n = n + 1
  write_output_integer_register(0, n)
end"""
    )
    world.run(20)
    assert world.controller.registers.output_int[0] == 0
    world.controller.sockets.lost(number, "closed")
    world.run(10)
    assert 8 <= world.controller.registers.output_int[0] <= 10


def test_hosts_that_no_option_names_are_refused():
    open_far = 'textmsg(socket_open("192.0.2.7", 50001, "s"))'
    world = World(lines(open_far), 3)
    assert world.said == ["False"]
    assert "needs --allow-connect 192.0.2.7" in world.events
    world = World(lines(open_far), 3, allow_connect="192.0.2.8, 192.0.2.7")
    assert [each.host for each in world.controller.sockets.openings()] == ["192.0.2.7"]


def test_nobody_answers_for_two_seconds():
    world = World(lines(OPEN), 900)
    assert world.said == []
    world.run(200)
    assert world.said == ["False"]


def test_a_programs_end_closes_its_sockets():
    world, number = connected("halt")
    assert world.controller.sockets.closings() == [number]


# -- bounds ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "body",
    [
        "x = " + "(" * 40 + "1" + ")" * 40,
        "x = " + "+".join(["(" + "+".join(["1"] * 90) + ")"] * 90),
        "while True:\n" * 45 + "sync()\n" + "end\n" * 45,
        "x = a" + "[0]" * 95,
        "x = 1\n" * (LARGEST // 8),
    ],
)
def test_programs_as_large_as_they_may_be(body):
    before = time.process_time()
    World(lines(body), 3)
    assert time.process_time() - before < 5.0


def test_nan_does_not_get_into_the_arm():
    world, number = connected(
        'x = socket_read_ascii_float(1, "s", 0.01)\nspeedj([x[1], 0, 0, 0, 0, 0], 1, 1)'
    )
    world.run(20)
    assert "exception" in world.events
    assert all(map(math.isfinite, world.controller.motion.target_q))
    assert number


# -- programs as their users' clients upload them --------------------------------------------------

FOLLOWS = """
def follows():
  UNSET = -1
  IDLE = 0
  RUNNING = 1
  SCALE = 1000000
  global goal = get_target_joint_positions()
  global state = UNSET
  global mode = 0
  global idle_count = 0
  mover = 0
  def within_limits(from_q, to_q, time):
    local at = 0
    while at < 6:
      local speed = norm(to_q[at] - from_q[at]) / time
      if speed > 20.0:
        return False
      end
      at = at + 1
    end
    return True
  end
  def put(q):
    state = RUNNING
    if within_limits(goal, q, get_steptime()):
      goal = q
    end
  end
  thread servos():
    now = IDLE
    while mode == 1:
      enter_critical
      q = goal
      idle = False
      if (state == IDLE):
        idle = True
      end
      now = state
      if state > UNSET:
        state = IDLE
      end
      if idle:
        idle_count = idle_count + 1
        q = goal + 0.0 * goal
        servoj(q, t=get_steptime(), lookahead_time=0.03, gain=2000)
      elif now == RUNNING:
        servoj(q, t=get_steptime(), lookahead_time=0.03, gain=2000)
      else:
        sync()
      end
      exit_critical
    end
    stopj(4.0)
  end
  while not socket_open("127.0.0.1", 50002, "reverse"):
    sleep(0.2)
  end
  timeout = 0.0
  while mode > -2:
    enter_critical
    got = socket_read_binary_integer(8, "reverse", timeout)
    if got[0] > 0:
      timeout = got[1] / 1000.0
      if mode != got[8]:
        mode = got[8]
        join mover
        if mode == 1:
          goal = get_target_joint_positions()
          mover = run servos()
        end
      end
      if mode == 1:
        put([got[2] / SCALE, got[3] / SCALE, got[4] / SCALE, got[5] / SCALE, got[6] / SCALE,
          got[7] / SCALE])
      end
    else:
      textmsg("no command came")
      mode = -2
      kill mover
      stopj(4.0)
      halt
    end
    exit_critical
  end
  textmsg("ended")
end
"""


def follower():
    world = World(FOLLOWS, 1)
    (opening,) = world.controller.sockets.openings()
    world.controller.sockets.opened(opening.number)
    world.run(1)
    return world, opening.number


def command(world, number, mode, joints, timeout_ms=100):
    values = [timeout_ms, *(round(q * 1e6) for q in joints), mode]
    data = b"".join(value.to_bytes(4, "big", signed=True) for value in values)
    world.controller.sockets.data(number, data)


def test_a_program_that_follows_its_socket_in_a_thread_of_its_own():
    world, number = follower()
    start = list(world.controller.motion.target_q)
    for step in range(250):
        joints = [start[0] + 0.001 * step, *start[1:]]
        command(world, number, 1, joints)
        world.run(1)
    assert world.controller.motion.target_qd[0] == pytest.approx(0.5, rel=0.05)
    command(world, number, -2, start)
    world.run(300)
    assert world.said == ["ended"]
    assert not world.controller.motion.moving


def test_it_stops_when_its_socket_falls_silent():
    world, number = follower()
    start = list(world.controller.motion.target_q)
    command(world, number, 1, start)
    world.run(48)
    assert world.said == []
    world.run(20)
    assert world.said == ["no command came"]
    assert not world.controller.has_program


def test_a_frame_of_it_costs_a_small_part_of_the_frame():
    world, number = follower()
    start = list(world.controller.motion.target_q)
    frames = []
    for step in range(500):
        command(world, number, 1, [start[0] + 0.001 * step, *start[1:]])
        before = time.thread_time()
        world.run(1)
        frames.append(time.thread_time() - before)
    assert sorted(frames)[len(frames) // 2] < 0.5 * world.controller.period_s


def test_a_socket_that_is_really_opened():
    listener = socket.create_server(("127.0.0.1", 0))
    closed = socket.create_server(("127.0.0.1", 0))
    ports = [each.getsockname()[1] for each in (listener, closed)]
    closed.close()
    peer = UrControllerPeer(
        UrControllerOptions(
            running=True, program_start_s=0.0, rtde_port=0, primary_port=0, dashboard_port=0
        )
    )
    with listener, contextlib.closing(peer):
        peer.open()
        peer.controller.upload(
            lines(
                f"""
write_output_boolean_register(0, socket_open("127.0.0.1", {ports[1]}, "no"))
if socket_open("127.0.0.1", {ports[0]}, "yes"):
  socket_send_line("hello", "yes")
  found = socket_read_binary_integer(1, "yes")
  write_output_integer_register(0, found[1])
  socket_send_string("bye", "yes")
  socket_close("yes")
end
write_output_integer_register(1, 1)"""
            )
        )
        listener.settimeout(5.0)
        peer.step(time.monotonic() + 0.1)
        client, _ = listener.accept()
        with client:
            client.settimeout(5.0)
            peer.step(time.monotonic() + 0.05)
            assert client.recv(100) == b"hello\n"
            client.sendall(b"\0\0\0\7")
            until_s = time.monotonic() + 5.0
            while not peer.controller.registers.output_int[1] and time.monotonic() < until_s:
                peer.step(time.monotonic() + 0.02)
            peer.step(time.monotonic() + 0.02)
            assert peer.controller.registers.output_int[:2] == [7, 1]
            assert not peer.controller.registers.output_bit[0]
            assert client.recv(100) == b"bye"
            assert client.recv(100) == b""
