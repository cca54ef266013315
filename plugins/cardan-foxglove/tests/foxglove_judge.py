"""Client written from the text of Foxglove's protocol, as the judge of a sweep: `python -m
foxglove_judge PORT cdr|json < PLAN`. Commands are published in that encoding; the protocol has no
actions.
"""

import json
import sys
import time
from types import SimpleNamespace

from cardan.protocols.ros2.cdr import MalformedCdr, codec_of
from cardan.protocols.ros2.messages import completed
from foxglove_pair import foxglove_client
from tests.sweep.plan import RESULT, command

TIMEOUT_S = 20.0
RESULT_TYPE = "cardan_msgs/msg/CommandResult"


def encoded(type_name, given):
    """Return the message in CDR."""
    return codec_of(type_name).encode(completed(type_name, given))


class Ears:
    """Subscribes to each topic once, and collects all results."""

    def __init__(self, client, hear):
        self.client, self.heard, self.new = client, {}, []
        self.types = {**dict(hear), RESULT: RESULT_TYPE}
        self.missing = set(dict(hear))
        # A client subscribes to a channel only once.
        self.names = {client.subscribe(name): name for name in self.types}

    def listen(self, timeout_s=0.0):
        for said in self.client.drained(timeout_s):
            if said["op"] == "message" and said["subscription"] in self.names:
                self._take(said["subscription"], said["data"])

    def _take(self, number, data):
        name = self.names[number]
        channel, type_name = self.client.channel(name), self.types[name]
        assert (channel["encoding"], channel["schemaName"]) == ("cdr", type_name), channel
        found = codec_of(type_name).decode(data)
        assert not isinstance(found, MalformedCdr), (name, found.reason)
        self.heard[name] = True
        self.missing.discard(name)
        if name == RESULT:
            self.new.append(found)
        else:
            del self.names[number]
            self.client.unsubscribe(number)

    def take_results(self):
        """Return the messages received since the last call."""
        self.listen()
        found, self.new = self.new, []
        return found


def main(port, encoding):
    plan = json.load(sys.stdin)
    reported = {"commands": {}, "services": {}, "actions": {}}
    with foxglove_client(SimpleNamespace(port=port)) as client:
        ears = Ears(client, plan["hear"])
        for each in plan["commands"]:
            topic, type_name, message, _verb, _tag = each
            data = json.dumps(message).encode()
            if encoding == "cdr":
                data = encoded(type_name, message)
            channel = client.advertise(topic, type_name, encoding)
            reported["commands"][topic] = command(
                each,
                lambda channel=channel, data=data: client.publish(channel, data),
                ears.take_results,
                time.monotonic() + TIMEOUT_S,
            )
        for name, type_name, request in plan["services"]:
            said = client.call(name, encoded(f"{type_name}_Request", request))
            reported["services"][name] = None
            if said["op"] == "response":
                answer = codec_of(f"{type_name}_Response").decode(said["data"])
                assert not isinstance(answer, MalformedCdr), (name, answer.reason)
                reported["services"][name] = answer
            else:
                print(name, said, file=sys.stderr)
        print("HEARING", flush=True)
        until_s = time.monotonic() + TIMEOUT_S
        while ears.missing and (left_s := until_s - time.monotonic()) > 0.0:
            ears.listen(left_s)
        print(json.dumps({**reported, "heard": ears.heard}, default=str), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
