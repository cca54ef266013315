"""dora-rs 1.1 over Zenoh: `python -m tests.sweep.dora_node CONFIG`.

Source: Ros2Context. AMENT_PREFIX_PATH names the folder of the interfaces.
"""

import sys
import threading
import time
import warnings

warnings.filterwarnings("ignore", message="dora-rs ROS2 Bridge")

import dora  # noqa: E402

from tests.sweep.dora_judge import array, short  # noqa: E402
from tests.sweep.line_protocol import obey, tell  # noqa: E402

TIMEOUT_S = 120.0
PERIOD_S = 0.002
QOS = dora.Ros2QosPolicies(reliable=True, keep_last=10)
LATCHED = dora.Ros2QosPolicies(
    durability=dora.Ros2Durability.TransientLocal, reliable=True, keep_last=1
)
PARAMETERS = dora.Ros2QosPolicies(reliable=True, keep_last=1000)


class Judge:
    """Judge that calls dora-rs from one thread, as dora-rs requires; commands arrive in another
    thread."""

    def __init__(self, node):
        self.node = node
        self.publishers, self.subscriptions, self.streams = {}, {}, []
        self.lock = threading.Lock()

    def subscribe(self, topic, kind, latched=False):
        quality = LATCHED if latched else QOS
        with self.lock:
            made = self.node.create_topic(topic, short(kind), quality)
            self.subscriptions[topic] = self.node.create_subscription(made, quality)

    def unsubscribe(self, topic):
        with self.lock:
            del self.subscriptions[topic]

    def advertise(self, topic, kind):
        with self.lock:
            made = self.node.create_topic(topic, short(kind), QOS)
            self.publishers[topic] = self.node.create_publisher(made, QOS), kind
        tell("matched", topic=topic)

    def publish(self, topic, message, period_s=None):
        """Publish once, or periodically."""
        publisher, kind = self.publishers[topic]
        sent = array(kind, message)
        with self.lock:
            publisher.publish(sent)
            if period_s is not None:
                self.streams.append([publisher, sent, period_s, time.monotonic() + period_s])

    def call(self, service, kind, request, wait_s):
        depth = PARAMETERS if "parameter" in service else QOS
        client = self.node.create_service_client(service, short(kind), depth)
        answer = client.call(array(f"{kind}_Request", request), wait_s).to_pylist()[0]
        tell("answer", service=service, message=answer)

    def act(self, action, kind, goal):
        client = self.node.create_action_client(action, short(kind), QOS)
        handle = client.send_goal(array(f"{kind}_Goal", goal), TIMEOUT_S)
        feedback = client.take_feedback(handle, TIMEOUT_S)
        tell("feedback", action=action, message=feedback.to_pylist()[0])
        _status, result = client.take_result(handle, TIMEOUT_S)
        tell("result", action=action, message=result.to_pylist()[0])

    def step(self):
        with self.lock:
            for topic, subscription in self.subscriptions.items():
                for each in iter(subscription.next, None):
                    tell("sample", topic=topic, message=each.to_pylist()[0])
            for stream in self.streams:
                publisher, sent, period_s, due_s = stream
                if time.monotonic() >= due_s:
                    publisher.publish(sent)
                    stream[3] = due_s + period_s


def main(config):
    transport = dora.Ros2Transport.zenoh("rep2016", config)
    context = dora.Ros2Context(transport=transport, domain_id=0)
    judge = Judge(context.new_node("judge", "/", dora.Ros2NodeOptions(rosout=False)))
    over = threading.Event()

    def step():
        while not over.wait(PERIOD_S):
            judge.step()

    stepping = threading.Thread(target=step)
    stepping.start()
    tell("ready", middleware="zenoh")
    try:
        obey(judge)
    finally:
        over.set()
        stepping.join()


if __name__ == "__main__":
    main(*sys.argv[1:])
