"""Messages of a simulated Leap service that tracks one hand.

It prints:

    1 {"serviceVersion":"2.3.1+33747","version":6}
    1 {"event":{"state":{"attached":true,"id":"LP00000000001","str
    1 {"currentFrameRate":0.0,"devices":[],"gestures":[],"hands":[
    1 {"currentFrameRate":100.0,"devices":[],"gestures":[],"hands"
    1 {"currentFrameRate":100.0,"devices":[],"gestures":[],"hands"
    1 {"currentFrameRate":100.0,"devices":[],"gestures":[],"hands"
"""

from cardan_leap.peer import SimulatedLeapService

service = SimulatedLeapService(rate_hz=100.0, jitter=0.0)
service.connect(1, version=6)
service.receive(1, '{"background":true}', now_s=0.0)
service.enter("right").palm_mm = (0.0, 200.0, -50.0)
service.advance(0.03)
for client, text in service.outgoing():
    print(client, text[:60])
