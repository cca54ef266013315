"""roslibpy 2.1 as a client of the rosbridge server: `python -m tests.sweep.roslibpy_node PORT`."""

import sys
import threading
import time

import roslibpy

from tests.sweep.line_protocol import obey, tell

TIMEOUT_S = 120.0


def plain(message):
    """Replace a message's enumerated values by numbers."""
    return {key: getattr(value, "value", value) for key, value in message.items()}


class Judge:
    def __init__(self, ros):
        self.ros = ros
        self.publishers, self.subscriptions = {}, {}

    def subscribe(self, topic, kind, latched=False):
        """Subscribe to a topic. Latched messages arrive without a request."""
        del latched
        self.subscriptions[topic] = roslibpy.Topic(self.ros, topic, kind)
        self.subscriptions[topic].subscribe(
            lambda message: tell("sample", topic=topic, message=dict(message))
        )

    def unsubscribe(self, topic):
        self.subscriptions.pop(topic).unsubscribe()

    def advertise(self, topic, kind):
        self.publishers[topic] = roslibpy.Topic(self.ros, topic, kind)
        self.publishers[topic].advertise()
        tell("matched", topic=topic)

    def publish(self, topic, message, period_s=None):
        """Publish once, or periodically."""
        publisher = self.publishers[topic]
        publisher.publish(message)
        if period_s is not None:
            repeating = threading.Thread(target=self._repeat, args=(publisher, message, period_s))
            repeating.start()

    def _repeat(self, publisher, message, period_s):
        while True:
            time.sleep(period_s)
            publisher.publish(message)

    def call(self, service, kind, request, wait_s):
        answer = roslibpy.Service(self.ros, service, kind).call(request, timeout=wait_s)
        tell("answer", service=service, message=dict(answer))

    def act(self, action, kind, goal):
        def reported(event):
            return lambda each: tell(event, action=action, message=plain(each))

        client = roslibpy.ActionClient(self.ros, action, kind)
        client.send_goal(
            roslibpy.Goal(goal), reported("result"), reported("feedback"), reported("failure")
        )


def main(port):
    ros = roslibpy.Ros("127.0.0.1", int(port))
    ros.run(TIMEOUT_S)
    tell("ready", middleware="rosbridge")
    obey(Judge(ros))
    ros.terminate()


if __name__ == "__main__":
    main(*sys.argv[1:])
