"""Prints every OSC message that python-osc dispatches, one JSON line each. Arguments: ports."""
import json
import sys
import threading

from pythonosc.dispatcher import Dispatcher
from pythonosc.osc_server import BlockingOSCUDPServer

lock = threading.Lock()


def listen(port):
    def heard(address, *arguments):
        with lock:
            print(json.dumps([port, address, list(arguments)]), flush=True)

    dispatcher = Dispatcher()
    dispatcher.set_default_handler(heard)
    server = BlockingOSCUDPServer(("127.0.0.1", port), dispatcher)
    server.max_packet_size = 65536
    threading.Thread(target=server.serve_forever, daemon=True).start()


for word in sys.argv[1:]:
    listen(int(word))
print("ready", flush=True)
threading.Event().wait()
