"""roslibpy 2.1 as the judge of a sweep: `python -m tests.sweep.roslibpy_judge PORT < PLAN`."""

import json
import queue
import sys
import threading
import time

import roslibpy

from tests.sweep.plan import RESULT, command

TIMEOUT_S = 120.0


def plain(value):
    """Convert a status or message to a value that json accepts."""
    return getattr(value, "value", None) or dict(value)


def main(port):
    plan = json.load(sys.stdin)
    ros = roslibpy.Ros("127.0.0.1", int(port))
    ros.run(TIMEOUT_S)
    reported = {"commands": {}, "services": {}, "actions": {}, "heard": {}}
    results = queue.SimpleQueue()

    def hear(name, type_name):
        def take(_message):
            reported["heard"][name] = True

        roslibpy.Topic(ros, name, type_name).subscribe(take)

    for name, type_name in plan["hear"]:
        hear(name, type_name)
    listening = roslibpy.Topic(ros, RESULT, "cardan_msgs/msg/CommandResult")
    listening.subscribe(results.put)

    def new():
        return [results.get() for _ in range(results.qsize())]

    for each in plan["commands"]:
        topic, type_name, message, _verb, _tag = each
        publisher = roslibpy.Topic(ros, topic, type_name)
        reported["commands"][topic] = command(
            each,
            lambda publisher=publisher, message=message: publisher.publish(message),
            new,
            time.monotonic() + TIMEOUT_S,
        )
    for name, type_name, request in plan["services"]:
        service = roslibpy.Service(ros, name, type_name)
        try:
            reported["services"][name] = dict(service.call(request, timeout=TIMEOUT_S))
        except Exception as error:
            reported["services"][name] = None
            print(name, error, file=sys.stderr)
    for name, type_name, goal in plan["actions"]:
        ended, found = threading.Event(), []

        def end(result, ended=ended, found=found):
            found.append(result)
            ended.set()

        action = roslibpy.ActionClient(ros, name, type_name)
        action.send_goal(roslibpy.Goal(goal), end, lambda _feedback: None, end)
        ended.wait(TIMEOUT_S)
        reported["actions"][name] = found[0] if found else None
    print("HEARING", flush=True)
    until_s = time.monotonic() + TIMEOUT_S
    while time.monotonic() < until_s and len(reported["heard"]) < len(plan["hear"]):
        time.sleep(0.01)
    print(json.dumps(reported, default=plain), flush=True)
    ros.terminate()


if __name__ == "__main__":
    main(*sys.argv[1:])
