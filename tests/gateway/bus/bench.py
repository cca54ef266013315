"""An arm's server on a network without Zenoh, with its worker in the test's own thread."""

from __future__ import annotations

import itertools
from collections import deque

from cardan.bus.node import Received
from cardan.bus.options import BusOptions
from cardan.errors import CardanError
from cardan.gateway.arm.requests import MotionNote, PacketError
from cardan.gateway.arm.verb_results import Motion, Outcome
from cardan.gateway.bus.arm_server import ArmServer
from cardan.gateway.bus.arm_topics import ArmNames
from cardan.gateway.bus.commands import ACTIONS, SERVICES, TOPICS, stat_command
from cardan.gateway.bus.compatibility import ServoScales, other_names
from cardan.gateway.bus.trajectories import follow_joint_trajectory
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import completed
from cardan.protocols.ros2.zenoh import DEFAULT_QOS, PUBLISHER, Attachment, Entity, data_key
from cardan.types import NEVER_S
from tests.gateway.arm.arms import World
from tests.gateway.bus.fakes import Stamp

NODE = "/arm"
SERVO_SCALES = ServoScales()
RESULT = "cardan_msgs/msg/CommandResult"
GID = bytes(range(16))


class FakePublisher:
    """Keeps published messages, decoded."""

    def __init__(self, type_name, qos):
        self.type_name, self.qos, self.messages = type_name, qos, []

    def put(self, data, _now_ns):
        message = codec_of(self.type_name).decode(bytes(data))
        assert isinstance(message, dict), message
        self.messages.append(message)


class Asked:
    """A request to a service, and its replies."""

    def __init__(self, type_name, data, gid=None):
        self.type_name, self.data = type_name, data
        self.attachment = None if gid is None else Attachment(1, 1, gid)
        self.answers = []

    def reply(self, data, _now_ns):
        message = codec_of(f"{self.type_name}_Response").decode(data)
        assert isinstance(message, dict), message
        self.answers.append(message)

    @property
    def answer(self):
        """The only reply."""
        assert len(self.answers) == 1, self.answers
        return self.answers[0]


class Ring:
    def __init__(self, depth):
        self.waiting = deque(maxlen=depth)

    def poll(self):
        return self.waiting.popleft() if self.waiting else None


class FakeNode:
    """A fake node with the members that an arm's server needs."""

    full_name = NODE
    namespace, name = "/", NODE[1:]
    zid = "ours"
    options = BusOptions()

    def __init__(self):
        self.publishers, self.rings, self.types = {}, {}, {}
        self.tokens = Ring(64)

    def key_of(self, name, type_name):
        return data_key(0, name, type_name)

    def publisher(self, name, type_name, qos=DEFAULT_QOS):
        publisher = self.publishers[self._full(name)] = FakePublisher(type_name, qos)
        return publisher

    def subscription(self, name, type_name, depth, qos=DEFAULT_QOS):
        return self._ring(name, type_name, depth)

    def watch_tokens(self, _key=""):
        return self.tokens

    def declare_key_token(self, key):
        pass

    def service(self, name, type_name, qos=DEFAULT_QOS):
        return self._ring(name, type_name, 32)

    def _ring(self, name, type_name, depth):
        self.types[self._full(name)] = type_name
        ring = self.rings[self._full(name)] = Ring(depth)
        return ring

    @staticmethod
    def _full(name):
        return name.replace("~", NODE) if name[0] in "~/" else f"/{name}"


class Bench:
    """A simulated arm in virtual time, behind a server on a fake node."""

    def __init__(self, names=(), scales=SERVO_SCALES, full=lambda: False, **more):
        """`names`: naming schemes of other programs under which the arm is offered; `full`: true if
        the worker's queue is full."""
        self.world = World(**more)
        self.node = FakeNode()
        self.requests = []
        """All requests that reached the arm."""
        self.malformed = 0
        self.motions = {}
        self._ids = itertools.count(1)
        self._sequences = itertools.count(1)
        joints = self.world.model.joint_names
        follow = follow_joint_trajectory("controller", joints)
        self.names = ArmNames(joints)
        self.others = other_names(names, self.names, "servo_node", scales)
        # test_liveliness.py and test_liveness.py test the supervision of clients.
        self.server = ArmServer(
            self.node,
            self.offer,
            topics=(*TOPICS, *(each for other in self.others for each in other.topics)),
            services=(
                *SERVICES,
                stat_command(self.names.base),
                *(each for other in self.others for each in other.services),
            ),
            actions=(*ACTIONS, follow),
            endless_without_watch=True,
            full=full,
            owner=lambda: self.world.verbs.controller.authority.owner,
        )
        # Clients that publish and call here without a node have no token, and the server knows
        # that.
        for gid in (GID, b"b" * 16):
            self.server.unnamed.until_s((gid, ""), NEVER_S)
        self.now_s = 0.0
        self._endpoints = itertools.count(1)

    # -- the worker's part -----------------------------------------------------------------------

    def offer(self, client, packet, _now_s):
        """Carry out a client's request at once."""
        try:
            request = client.decode(packet)
        except PacketError as error:
            self.malformed += 1
            cause = error.__cause__
            client.refused(error.request, cause if isinstance(cause, CardanError) else error)
            return
        if request is None:
            return
        self.requests.append(request)
        try:
            result = self._perform(request)
        except CardanError as error:
            self._tell_ended()
            client.refused(request.id, error)
            return
        self._tell_ended()
        if isinstance(result, Motion):
            number = next(self._ids)
            note = self._note(number, result)
            client.done(request, note)
            if not result.over:
                self.motions[number] = result, client
        else:
            client.done(request, result)

    def _wait(self, timeout_s):
        verbs = self.world.verbs
        motion, end_s = verbs.waited_for, verbs.stamp_s + min(timeout_s, 60.0)
        if motion is None or not motion.ends:
            return True
        while not motion.over and verbs.stamp_s < end_s:
            self.world.tick()
        if not motion.over:
            verbs.stop()
        return motion.outcome is Outcome.DONE

    def _perform(self, request):
        verbs, source = self.world.verbs, request.source
        verb, value = request.verb, request.value
        if verb in ("pose", "jog", "twist", "wrench", "joints"):
            return verbs.stream(
                verb,
                value,
                owner=source,
                sequence=request.sequence,
                stamp_s=request.stamp_s,
                begins=request.begins,
            )
        if verb in ("stat", "get_parameters", "stop", "acknowledge"):
            return getattr(verbs, verb)()
        if verb == "release":
            return verbs.release(source)
        if verb == "wait":
            return self._wait(value or 60.0)
        arguments = () if value is None else (value,)
        if verb == "inv":
            return verbs.inv(*arguments)
        result = getattr(verbs, verb)(*arguments, source=source)
        if isinstance(result, Motion):
            while result.outcome is Outcome.WAITING:
                self.world.tick()
                verbs.start_pending()
            if result.error is not None:
                raise result.error
        return result

    @staticmethod
    def _note(number, motion):
        return MotionNote(
            number, motion.verb, motion.source, motion.ends, motion.outcome, motion.reason,
            motion.note, motion.duration_s,
        )  # fmt: skip

    def _tell_ended(self):
        for number, (motion, client) in tuple(self.motions.items()):
            if motion.over:
                del self.motions[number]
                client.ended(self._note(number, motion))

    # -- the network side ------------------------------------------------------------------------

    def poll(self, after_s=1.0):
        """Run one cycle of the loop's part, `after_s` after the previous one."""
        self.now_s += after_s
        self.server.poll(self.now_s)

    def appear(self, node, kind=PUBLISHER, zid="b0", number="0"):
        """Announce an endpoint of a node by its liveliness token."""
        namespace, _, name = node.rpartition("/")
        entity = Entity(
            zid, number, str(next(self._endpoints)), kind, namespace or "/", name, "/x",
            "std_msgs/msg/Empty", "RIHS01_0",
        )  # fmt: skip
        token = entity.token(0)
        self.node.tokens.waiting.append((token, True))
        return token

    def vanish(self, token):
        """Withdraw a token, as if the endpoint left or its process was killed."""
        self.node.tokens.waiting.append((token, False))

    def publish(
        self, topic, given=None, *, data=None, type_name="", sequence=None, gid=GID, source_ns=1,
        zid="",
    ):  # fmt: skip
        """Publish a message, or any bytes, on a topic of the arm; on any topic if it begins with
        //."""
        topic = topic[1:] if topic.startswith("//") else f"{NODE}{topic}"
        type_name = type_name or self.node.types[topic]
        if data is None:
            data = codec_of(type_name).encode(completed(type_name, given or {}))
        sequence = next(self._sequences) if sequence is None else sequence
        attachment = Attachment(sequence, source_ns, gid)
        self.node.rings[topic].waiting.append(
            Received(data, data_key(0, topic, type_name), attachment, Stamp(zid) if zid else None)
        )
        return sequence

    def command(self, topic, given=None, *, after_s=1.0, **more):
        """Publish, and let the server read it; return the message's sequence number."""
        number = self.publish(topic, given, **more)
        self.poll(after_s)
        return number

    def call(self, service, given=None, *, data=None, gid=None):
        """Call a service and poll once; return the request, which has its reply."""
        service = service if service.startswith("//") else f"/{NODE}{service}"
        service = service[1:]
        type_name = self.node.types[service]
        if data is None:
            name = f"{type_name}_Request"
            data = codec_of(name).encode(completed(name, given or {}))
        asked = Asked(type_name, data, gid)
        self.node.rings[service].waiting.append(asked)
        self.poll()
        return asked

    def heard(self, topic):
        """All messages published on a topic of the arm."""
        name = topic if topic[0] == "/" and topic in self.node.publishers else f"{NODE}{topic}"
        return self.node.publishers[name].messages

    def results(self):
        """(command, sequence number, outcome, reason) of all results."""
        return [
            (each["command"], each["sequence"], each["outcome"], each["reason"])
            for each in self.heard("/result")
        ]

    def finish(self):
        """Run until all motions have ended and are reported."""
        while self.motions:
            self.world.tick()
            self._tell_ended()
        self.world.rest()


def ros_pose(six):
    """A geometry_msgs/Pose from six numbers."""
    from cardan.spatial import from_rotation_vector
    from cardan.types import Vector3

    x, y, z, *rotation = map(float, six)
    q = from_rotation_vector(Vector3(*rotation))
    return {
        "position": {"x": x, "y": y, "z": z},
        "orientation": {"x": q.x, "y": q.y, "z": q.z, "w": q.w},
    }
