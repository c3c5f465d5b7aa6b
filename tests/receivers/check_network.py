#!/usr/bin/env python3
"""Wires that are features of the build, and an example that hands OSC on, against programs and libraries that others wrote.

    check_network.py MIEN WHAT...      WHAT: lights live-link websocket

What is received is compared with the CSV of the same run, by the rules the wires' descriptions state, written here anew.
"""
import os
import socket
import subprocess
import sys
import threading
import time

import session

FRAMES = 240
RUN = ["--source", "simulated", "--frames", str(FRAMES)]


def free_port(kind=socket.SOCK_DGRAM):
    with socket.socket(socket.AF_INET, kind) as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


LIGHTS = ("AU26", "AU12L", "AU12R")


def check_lights(mien):
    """The example lights.py hands units on as sACN, which the library's receiver hears; it tells of changes only."""
    import sacn
    got, port = [], free_port()
    receiver = sacn.sACNreceiver(bind_address="127.0.0.1")
    receiver.register_listener("universe", lambda packet: got.append(packet.dmxData[:len(LIGHTS)]), universe=1)
    receiver.start()
    script = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../docs/examples/lights.py")
    lights = subprocess.Popen([sys.executable, script, "127.0.0.1", str(port)], stdout=subprocess.PIPE)
    try:
        assert lights.stdout.readline(), "lights.py does not start"
        path, _, _ = session.run(mien, f'[osc]\ntarget = "127.0.0.1:{port}"\n', RUN)
        time.sleep(2)
    finally:
        lights.kill()
        receiver.stop()
    rows, _ = session.read(path)
    # At the end mien tells of nobody.
    wanted = [[255 * row.shown[unit] for unit in LIGHTS] for row in rows] + [[0.0] * len(LIGHTS)]
    at = 0
    for values in got:
        # Six digits do not tell on which side of a border between two steps a weight was.
        near = lambda row: all(abs(value - one) <= 0.5 + 1e-3 for value, one in zip(values, row))
        at = next((i for i in range(at, len(wanted)) if near(wanted[i])), None)
        assert at is not None, f"{values} is not in the CSV, or not in its order"
    steps = [[round(one) for one in row] for row in wanted]
    changes = sum(a != b for a, b in zip(steps, steps[1:]))
    assert changes > 20 and len(got) > 0.9 * changes, f"{len(got)} of {changes} changes"
    assert not any(got[-1]), "the end is nobody"
    print(f"sacn (PyPI): {len(got)} states of {len(LIGHTS)} channels heard, {changes} changes in the CSV, each within a step")


LIVE_LINK = {"JawOpen": ("AU26", "AU27"), "MouthSmileLeft": ("AU12L", "AU12"), "MouthSmileRight": ("AU12R", "AU12"),
             "BrowOuterUpLeft": ("AU2L", "AU2"), "JawForward": ("AU29",), "EyeBlinkRight": ("AU43R", "AU43")}


def check_live_link(mien):
    from pylivelinkface import FaceBlendShape, PyLiveLinkFace
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    receiver.bind(("127.0.0.1", 0))
    receiver.settimeout(0.5)
    got, done = [], threading.Event()

    def listen():
        while not done.is_set():
            try:
                got.append(receiver.recv(2000))
            except TimeoutError:
                pass
    thread = threading.Thread(target=listen)
    thread.start()
    config = f'[live_link]\nenabled = true\nsubject = "hall"\ntarget = "127.0.0.1:{receiver.getsockname()[1]}"\n' \
             '[osc]\nenabled = false\n'
    path, _, _ = session.run(mien, config, RUN)
    done.set()
    thread.join()
    rows, units = session.read(path)
    assert len(got) == len(rows) + 2, f"{len(got)} datagrams for {len(rows)} frames"
    compared = 0
    for datagram, row in zip(got, rows):
        success, face = PyLiveLinkFace.decode(datagram)
        neutral = not any(row.shown.values())
        if not success:
            assert neutral, "no values, though there is a face"
            continue
        assert face.name == "hall", face.name
        for shape, names in LIVE_LINK.items():
            value = face.get_blendshape(FaceBlendShape[shape])
            wanted = max(row.shown.get(name, 0.0) for name in names)
            assert abs(value - wanted) < 2e-6 + 1e-6, f"{shape} {value}, {wanted} in the CSV"
            compared += 1
    assert compared > FRAMES, compared
    print(f"PyLiveLinkFace: {len(rows)} frames, {compared} values equal to the CSV's")


def check_websocket(mien):
    """Two pages of the library websockets: one reads all, one never reads; and a flood of connections that say nothing."""
    import asyncio
    import json
    import websockets
    port = free_port(socket.SOCK_STREAM)
    got = []

    async def page():
        for _ in range(100):
            try:
                async with websockets.connect(f"ws://127.0.0.1:{port}/", compression=None) as one:
                    await one.ping()
                    async for message in one:
                        got.append(json.loads(message))
                    return
            except (ConnectionRefusedError, OSError):
                await asyncio.sleep(0.05)

    def lazy():
        with connection(port) as one:
            one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            one.sendall(b"GET / HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                        b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n")
            time.sleep(5)

    threads = [threading.Thread(target=lambda: asyncio.run(page())), threading.Thread(target=lazy),
               threading.Thread(target=flood, args=(port, 1000))]
    for thread in threads:
        thread.start()
    config = f'[websocket]\nenabled = true\nlisten = "127.0.0.1:{port}"\n[osc]\nenabled = false\n'
    path, _, status = session.run(mien, config, RUN)
    for thread in threads:
        thread.join()
    rows, units = session.read(path)
    # The goodbye has the last frame's time, and may take its place.
    by_time = {message["time_us"] // 1000: message for message in reversed(got)
               if message["user"] is not None and message["state"] != "absent"}
    started = min(message["frame"] for message in got)
    compared = 0
    for row in rows:
        if not row.present or row.ms not in by_time:
            assert row.frame < started or not row.present or row is rows[-1], f"frame {row.frame} is missing"
            continue
        message = by_time[row.ms]
        assert message["state"] == row.state and abs(message["confidence"] - row.confidence) < 1e-3
        assert list(message["weights"]) == units
        for unit in units:
            assert abs(message["weights"][unit] - row.shown[unit]) <= 0.5e-4 + 1e-6, (unit, row.frame)
            compared += 1
    assert compared > FRAMES // 2 * len(units), compared
    end = got[-1]
    assert end["user"] is None or (end["state"] == "absent" and not any(end["weights"].values())), end
    wire = next(one for one in status["outputs"] if one["name"] == "websocket")
    assert wire["commands_refused"] > 500, wire
    print(f"websockets (PyPI): {len(got)} messages, {compared} weights equal to the CSV's; 1000 connections turned away or "
          f"answered ({wire['commands_refused']} counted)")


def connection(port):
    """A connection to what begins to listen some time."""
    for _ in range(600):
        try:
            return socket.create_connection(("127.0.0.1", port))
        except OSError:
            time.sleep(0.05)
    raise AssertionError(f"nobody listens on {port}")


def flood(port, connections):
    """Connections that send nonsense, or nothing, and stay; after the pages'."""
    held = [connection(port)]
    time.sleep(1)
    for i in range(connections):
        try:
            one = socket.create_connection(("127.0.0.1", port), timeout=1)
            if i % 2:
                one.sendall(os.urandom(100))
            held.append(one)
        except OSError:
            pass
        if len(held) > 200:
            held.pop(0).close()


def main():
    mien, *wanted = sys.argv[1:]
    checks = {"lights": check_lights, "live-link": check_live_link, "websocket": check_websocket}
    for name in wanted:
        checks[name](mien)


if __name__ == "__main__":
    main()
