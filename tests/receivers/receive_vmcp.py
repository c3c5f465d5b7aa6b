"""Prints every event that vmcp understands, one JSON line each, as the message it came from. Argument: a port."""
import json
import sys
import time

from vmcp import events
from vmcp.facades import on_receive
from vmcp.osc import OSC
from vmcp.osc.backend.osc4py3 import as_eventloop as backend


def place(event):
    p, q = event.position, event.rotation
    return [p.x, p.y, p.z, q.x, q.y, q.z, q.w]


def heard(event):
    kind = type(event).__name__
    arguments = {
        "RootTransformEvent": lambda: [event.joint, *place(event)],
        "BoneTransformEvent": lambda: [event.joint.value, *place(event)],
        "DeviceTransformEvent": lambda: [event.joint, *place(event)],
        "BlendShapeEvent": lambda: [event.key, event.value],
        "BlendShapeApplyEvent": lambda: [],
        "StateEvent": lambda: [
            event.model_state.value,
            event.calibration_state.value,
            event.calibration_mode.value,
            event.tracking_state.value,
        ],
        "RelativeTimeEvent": lambda: [event.delta],
    }[kind]()
    print(json.dumps([port, event.address, arguments]), flush=True)


port = int(sys.argv[1])
osc = OSC(backend)
with osc.open():
    receiver = osc.create_receiver("127.0.0.1", port, "mien").open()
    for name in dir(events):
        event = getattr(events, name)
        if name.endswith("Event") and isinstance(getattr(event, "ADDRESS_PATTERN", None), str):
            on_receive(receiver, event, heard)
    print("ready", flush=True)
    while True:
        osc.run()
        time.sleep(0.001)
