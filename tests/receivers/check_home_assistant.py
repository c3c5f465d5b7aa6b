#!/usr/bin/env python3
"""What `mqtt.home_assistant` publishes, checked by Home Assistant's own schemas of discovery, as it checks what it finds itself.

    check_home_assistant.py MIEN        needs Mosquitto, and homeassistant and paho-mqtt from PyPI; not in CI: a minute of installing
"""
import json
import socket
import sys

from check_mqtt import MOSQUITTO, Broker, Listener, config
from check_network import free_port
import session

try:
    from homeassistant.components.mqtt import binary_sensor, button, sensor
except ImportError:
    sys.exit(print("SKIPPED: homeassistant is not installed (python3 -m pip install homeassistant)"))
SCHEMAS = {"binary_sensor": binary_sensor.DISCOVERY_SCHEMA, "button": button.DISCOVERY_SCHEMA, "sensor": sensor.DISCOVERY_SCHEMA}


def main():
    if not MOSQUITTO:
        sys.exit(print("SKIPPED: mosquitto is not installed"))
    port = free_port(socket.SOCK_STREAM)
    broker, listener = Broker(port), None
    try:
        listener = Listener(port)
        run = ["--source", "simulated", "--frames", "60"]
        session.run(sys.argv[1], config(port, "commands = true\nhome_assistant = true\n"), run)
        listener.wait("mien/hall/presence", "offline")
        found = {topic: json.loads(payload) for topic, payload, _ in listener.messages if topic.startswith("homeassistant/")}
        assert len(found) == 6, sorted(found)
        for topic, entity in found.items():
            # homeassistant/<component>/<node>/<object>/config
            _, component, _, _, last = topic.split("/")
            assert last == "config", topic
            taken = SCHEMAS[component](entity)
            # What it does not know it drops in silence.
            dropped = set(entity) - set(taken)
            assert not dropped, f"{topic}: Home Assistant drops {sorted(dropped)}"
        print(f"Home Assistant: {len(found)} entities taken, nothing dropped: {', '.join(one['name'] for one in found.values())}")
    finally:
        if listener:
            listener.close()
        broker.stop()


main()
