"""Node without a network: tests put messages in and read published ones."""

from collections import deque

from cardan.bus.node import Received, gid_of_token
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.zenoh import Attachment, Entity, data_key

OWN = "a0"


class FakeQueue:
    def __init__(self):
        self.waiting = deque()

    def poll(self):
        return self.waiting.popleft() if self.waiting else None


class FakePublisher:
    heard = False
    """True if the topic has a subscriber."""

    def __init__(self, type_name):
        self.codec = codec_of(type_name)
        self.messages = []

    def put(self, data, _now_ns):
        self.messages.append(self.codec.decode(bytes(data)))


class FakeRequest:
    """A request to a service, which keeps its reply."""

    def __init__(self, data, attachment):
        self.data, self.attachment, self.answer = data, attachment, None

    def reply(self, data, _now_ns):
        self.answer = data


class FakeNode:
    """Replaces BusNode as far as servers use it."""

    zid = OWN
    full_name = "/server"

    def __init__(self):
        self.publishers, self.queues, self.requests, self.tokens = {}, {}, {}, FakeQueue()

    def publisher(self, name, type_name, *_qos):
        return self.publishers.setdefault(name, FakePublisher(type_name))

    def subscription(self, name, *_type):
        return self.queues.setdefault(name, FakeQueue())

    def service(self, name, *_type):
        return self.requests.setdefault(name, FakeQueue())

    def watch_tokens(self):
        return self.tokens

    def key_of(self, name, type_name):
        return data_key(0, f"/server/{name}", type_name)


class FakeUser:
    """An endpoint of another process on the network of a FakeNode, until `leave`."""

    def __init__(self, node, kind, name, type_name, zid="b0", user="user", appears=True):
        self.node, self.name, self.type_name = node, name, type_name
        entity = Entity(
            zid, "0", "1", kind, "/", user, f"/server/{name[2:]}", type_name, "RIHS01_0"
        )
        self.token = entity.token(0)
        self.sent = 0
        if appears:
            self.appear()

    def appear(self):
        self.node.tokens.waiting.append((self.token, True))

    @property
    def attachment(self):
        self.sent += 1
        return Attachment(self.sent, 0, gid_of_token(self.token))

    def leave(self):
        self.node.tokens.waiting.append((self.token, False))

    def publish(self, message, attached=True, stamp=None):
        data = codec_of(self.type_name).encode(message)
        key = self.node.key_of(self.name[2:], self.type_name)
        received = Received(data, key, self.attachment if attached else None, stamp)
        self.node.queues[self.name].waiting.append(received)

    def ask(self, message):
        request = FakeRequest(
            codec_of(f"{self.type_name}_Request").encode(message), self.attachment
        )
        self.node.requests[self.name].waiting.append(request)
        return request


class Stamp:
    """Zenoh timestamp of a sample."""

    def __init__(self, zid):
        self.zid = zid

    def get_id(self):
        return self.zid
