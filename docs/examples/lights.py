"""Lamps follow a face: units of user 0 of mien's OSC on the first channels of a universe of sACN; a weight of 1 is 255.

    pip install python-osc==1.10.2 sacn==1.11.0 && python lights.py [HOST [OSC_PORT]]

then run `mien run` with `target = "127.0.0.1:9140"` in its section [osc]. HOST receives the sACN; without one, the
universe's multicast group does.
"""
import sys
import sacn
from pythonosc.dispatcher import Dispatcher
from pythonosc.osc_server import BlockingOSCUDPServer

UNIVERSE, CHANNELS = 1, ["AU26", "AU12L", "AU12R"]
host = sys.argv[1] if len(sys.argv) > 1 else None
port = int(sys.argv[2]) if len(sys.argv) > 2 else 9140
names = []
# From any port, so that receivers may be on this machine; 60 looks a second see each of 30 frames.
lamps = sacn.sACNsender(source_name="mien", bind_port=0, fps=60, universeDiscovery=False)
lamps.activate_output(UNIVERSE)
lamps[UNIVERSE].multicast, lamps[UNIVERSE].destination = not host, host


def schema(_, version, *units):
    names[:] = units


def show(_, *weights):
    shown = dict(zip(names, weights))
    lamps[UNIVERSE].dmx_data = tuple(round(255 * shown.get(unit, 0)) for unit in CHANNELS)


osc = Dispatcher()
osc.map("/face/schema", schema)
osc.map("/face/0/au", show)
server = BlockingOSCUDPServer(("127.0.0.1", port), osc)
print(f"OSC at 127.0.0.1:{port}, sACN in universe {UNIVERSE}", flush=True)
lamps.start()
try:
    server.serve_forever()
finally:
    lamps.stop()
