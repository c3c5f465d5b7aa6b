#!/usr/bin/env python3
"""A real Home Assistant, without its pages: it finds the box over Mosquitto, and an automation switches a lamp with each smile.

    check_home_assistant.py MIEN        needs Mosquitto, and homeassistant and paho-mqtt from PyPI; not in CI: a minute of installing
"""
import asyncio
import csv
import json
import logging
import socket
import sys
import tempfile

from check_mqtt import MOSQUITTO, Broker, config
from check_network import free_port
import session

try:
    from homeassistant import bootstrap, config_entries, loader
    from homeassistant.components import mqtt
    from homeassistant.components.device_automation import DeviceAutomationType, async_get_device_automations
    from homeassistant.components.mqtt import binary_sensor, button, device_trigger, sensor
    from homeassistant.core import HomeAssistant
    from homeassistant.core_config import async_process_ha_core_config
    from homeassistant.helpers import device_registry, entity_registry
    from homeassistant.setup import async_setup_component
except ImportError as error:
    sys.exit(print(f"SKIPPED: {error} (python3 -m pip install homeassistant paho-mqtt)"))
SCHEMAS = {
    "binary_sensor": binary_sensor.DISCOVERY_SCHEMA,
    "button": button.DISCOVERY_SCHEMA,
    "device_automation": device_trigger.TRIGGER_DISCOVERY_SCHEMA,
    "sensor": sensor.DISCOVERY_SCHEMA,
}
KNOWN = {"device_automation": {"availability_topic", "unique_id"}}
# On as soon as the face is tracked.
AWAKE = '[[gesture]]\nname = "awake"\nof = "AU26 - AU43L"\non = 0.02\noff = 0.01\nhold_s = 0.0\nspeaking = true\n'
GESTURES = '[[gesture]]\nname = "smile"\n[[gesture]]\nname = "brows"\n'
LAMP = "input_boolean.lamp"


async def start(port):
    """Home Assistant with a lamp and with the broker, entered as in its settings."""
    folder = tempfile.mkdtemp(prefix="mien-home-assistant-")
    open(f"{folder}/configuration.yaml", "w").close()
    settings = {"input_boolean": {"lamp": None}, "http": {"server_host": ["127.0.0.1"], "server_port": free_port(socket.SOCK_STREAM)}}
    home = HomeAssistant(folder)
    loader.async_setup(home)
    home.config.skip_pip = True
    home.config_entries = config_entries.ConfigEntries(home, settings)
    await loader.async_get_custom_components(home)
    await bootstrap.async_load_base_functionality(home)
    await async_process_ha_core_config(home, {})
    for component in ("homeassistant", "persistent_notification", "input_boolean"):
        assert await async_setup_component(home, component, settings), component
    form = await home.config_entries.flow.async_init("mqtt", context={"source": "user"})
    entered = await home.config_entries.flow.async_configure(form["flow_id"], {"broker": "127.0.0.1", "port": port})
    assert entered["type"] == "create_entry", entered
    await home.async_start()
    await home.async_block_till_done()
    return home


async def until(what, seconds=60):
    for _ in range(20 * seconds):
        if found := what():
            return found
        await asyncio.sleep(0.05)
    raise AssertionError("not in time")


async def found_box(home, gestures):
    """The box among the devices, as soon as so many gestures can start automations; and those triggers by name."""
    box = await until(lambda: device_registry.async_get(home).async_get_device(identifiers={("mqtt", "mien_hall")}))

    async def triggers():
        all_of_it = (await async_get_device_automations(home, DeviceAutomationType.TRIGGER, [box.id])).get(box.id, [])
        return {one["subtype"]: one for one in all_of_it if one["domain"] == "mqtt"}
    while len(found := await triggers()) < gestures:
        await asyncio.sleep(0.1)
    return box, found


async def lamp(home, trigger):
    """An automation: the trigger toggles the lamp."""
    toggle = {"action": "input_boolean.toggle", "target": {"entity_id": LAMP}}
    automation = {"alias": "lamp", "triggers": trigger, "actions": toggle}
    assert await async_setup_component(home, "automation", {"automation": [automation]})


def heard(home):
    """States that change from now on."""
    changes = []
    home.bus.async_listen("state_changed", lambda event: changes.append((event.data["entity_id"], event.data["new_state"])))
    return changes


async def smiles(mien, port):
    home = await start(port)
    published, changes = {}, heard(home)
    await mqtt.async_subscribe(home, "homeassistant/+/+/+/config", lambda message: published.update({message.topic: json.loads(message.payload)}))
    configuration = config(port, "commands = true\nhome_assistant = true\n") + GESTURES
    run = home.async_add_executor_job(session.run, mien, configuration, ["--source", "simulated:acted", "--frames", "700"])
    box, triggers = await asyncio.wait_for(found_box(home, 2), 60)
    await lamp(home, triggers["smile"])
    path, _, _ = await run
    await asyncio.sleep(1)
    await home.async_block_till_done()
    for topic, entity in published.items():
        component = topic.split("/")[1]
        # What it does not know it drops in silence; a trigger is no entity, so that it has no name and no absence of its own.
        dropped = set(entity) - set(SCHEMAS[component](entity)) - KNOWN.get(component, set())
        assert not dropped, f"{topic}: Home Assistant drops {sorted(dropped)}"
    entities = entity_registry.async_entries_for_device(entity_registry.async_get(home), box.id)
    assert len(entities) == 8, entities
    with open(path) as file:
        rows = list(csv.DictReader(file))
    counts = {}
    for gesture in ("smile", "brows"):
        states = [row[f"g_{gesture}"] for row in rows]
        begun = sum(pair == ("0", "1") for pair in zip(states, states[1:]))
        name = f"binary_sensor.mien_hall_{gesture}"
        told = sum(entity == name and state.state == "on" for entity, state in changes)
        assert told == begun > 0, (gesture, told, begun)
        counts[gesture] = told
    toggled = sum(entity == LAMP for entity, _ in changes)
    assert toggled == counts["smile"], (toggled, counts)
    left = {one.entity_id: home.states.get(one.entity_id).state for one in entities}
    assert left["binary_sensor.mien_hall_smile"] == "unavailable", left
    await home.async_stop()
    print(f"Home Assistant: {len(entities)} entities and {len(triggers)} triggers of {box.name}; {counts}; the lamp toggled {toggled} times")


async def killed(mien, port):
    """A box that is killed in mid-gesture: the lamp stays as it is when Home Assistant connects to the broker again."""
    home = await start(port)
    with tempfile.NamedTemporaryFile("w", suffix=".toml") as file:
        file.write(config(port, "home_assistant = true\n") + AWAKE)
        file.flush()
        box = await asyncio.create_subprocess_exec(
            mien, "run", "-q", "--config", file.name, "--source", "simulated:acted", stdout=asyncio.subprocess.DEVNULL
        )
        try:
            _, triggers = await asyncio.wait_for(found_box(home, 1), 60)
            await lamp(home, triggers["awake"])
            await until(lambda: home.states.get("binary_sensor.mien_hall_awake").state == "on")
        finally:
            box.kill()
            await box.wait()
    await until(lambda: home.states.get("binary_sensor.mien_hall_awake").state == "unavailable")
    before, changes = home.states.get(LAMP).state, heard(home)
    await home.config_entries.async_reload(home.config_entries.async_entries("mqtt")[0].entry_id)
    await asyncio.sleep(2)
    toggled = [state for entity, state in changes if entity == LAMP]
    assert before == "on" and not toggled, (before, toggled)
    await home.async_stop()
    print("Home Assistant: connected again after the box was killed in mid-gesture, it leaves the lamp as it was")


def main():
    if not MOSQUITTO:
        sys.exit(print("SKIPPED: mosquitto is not installed"))
    logging.basicConfig(level=logging.ERROR)
    for check in (smiles, killed):
        port = free_port(socket.SOCK_STREAM)
        broker = Broker(port)
        try:
            asyncio.run(check(sys.argv[1], port))
        finally:
            broker.stop()


main()
