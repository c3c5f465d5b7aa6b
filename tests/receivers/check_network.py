#!/usr/bin/env python3
"""Wires that are features of the build, against programs and libraries that others wrote.

    check_network.py MIEN WHAT...      WHAT: sacn ola live-link websocket

What is received is compared with the CSV of the same run, by the rules the wires' descriptions state, written here anew.
"""
import math
import os
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time

import session

FRAMES = 240
RUN = ["--source", "simulated", "--frames", str(FRAMES)]


def free_port(kind=socket.SOCK_DGRAM):
    with socket.socket(socket.AF_INET, kind) as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def rounded(share, full):
    """Both neighbours of a value that stands on the border of two steps: the CSV has six digits."""
    return {math.floor(share * full + 0.5 - 1e-3), math.floor(share * full + 0.5 + 1e-3)}


# The table, and what becomes of a weight in each row of it, from the documentation.
CHANNELS = [
    ("AU26 1 1", 1, 1, 255, lambda w: w["AU26"]),
    ("AU25 1 2 16", 1, 2, 65535, lambda w: w["AU25"]),
    ("AU12L 1 4 8 square", 1, 4, 255, lambda w: w["AU12L"] ** 2),
    ("AU12R 1 5 8 linear 100 20", 1, 5, 255, lambda w: 1 - 0.8 * w["AU12R"]),
    ("AU2L 1 6 16 smooth 10 90", 1, 6, 65535, lambda w: 0.1 + 0.8 * (w["AU2L"] ** 2) * (3 - 2 * w["AU2L"])),
    ("AU26 2 512 8 root", 2, 512, 255, lambda w: math.sqrt(w["AU26"])),
    ("present 2 1", 2, 1, 255, None),
]
LIGHTS = "[lights]\nchannels = [" + ", ".join(f'"{row[0]}"' for row in CHANNELS) + "]\n"


def expected(row, universe):
    """For one row of the CSV: each channel's allowed values."""
    table = []
    for _, number, channel, full, rule in CHANNELS:
        if number == universe:
            share = float(row.present) if rule is None else rule(row.shown)
            table.append((channel, full > 255, rounded(share, full)))
    return table


def fits(values, table):
    for channel, wide, allowed in table:
        value = values[channel - 1]
        if wide:
            value = value * 256 + values[channel]
        if value not in allowed and not (wide and any(abs(value - one) <= 1 for one in allowed)):
            return False
    return True


def compare(name, received, rows, universe):
    """Every row of the CSV was received, in its order: receivers tell of changes, so rows alike have one message."""
    distinct = [one for i, one in enumerate(received) if i == 0 or one != received[i - 1]]
    at, missing = 0, []
    for i, row in enumerate(rows):
        table = expected(row, universe)
        step = next((step for step in range(3) if at + step < len(distinct) and fits(distinct[at + step], table)), None)
        if step is None:
            missing.append(i)
        else:
            at += step
    assert not missing and len(distinct) > 20, f"{name}: rows {missing} of {len(rows)} not among {len(distinct)}"
    print(f"{name}: all {len(rows)} frames of universe {universe} received, {len(distinct)} of them changes, within a step of the CSV")


def check_sacn(mien):
    import sacn
    port = 5568
    receiver = sacn.sACNreceiver(bind_address="127.0.0.1", bind_port=port)
    got = {1: [], 2: []}
    raw = {1: 0, 2: 0}
    for universe in got:
        receiver.register_listener("universe", lambda packet, u=universe: got[u].append(packet), universe=universe)
    receiver.start()
    config = LIGHTS + f'[sacn]\nenabled = true\ntarget = "127.0.0.1:{port}"\npriority = 120\n[osc]\nenabled = false\n'
    path, _, status = session.run(mien, config, RUN)
    time.sleep(1)
    receiver.stop()
    rows, _ = session.read(path)
    wire = next(one for one in status["outputs"] if one["name"] == "sacn")
    assert wire["dropped"] == 0 and wire["sent"] >= 2 * (FRAMES - 40), wire
    for universe, packets in got.items():
        assert all(packet.priority == 120 and packet.sourceName.startswith("mien ") for packet in packets)
        live = [packet for packet in packets if not packet.option_StreamTerminated]
        compare("sacn (PyPI)", [packet.dmxData for packet in live], rows, universe)
        assert universe == 1 or live[-1].dmxData[0] == 0, "the end is nobody"


def check_ola(mien):
    """OLA receives both protocols and records what it gets. It refuses to run as root."""
    # Not in TMPDIR, which may be root's alone: olad runs as nobody.
    folder = tempfile.mkdtemp(prefix="mien-ola-", dir="/tmp")
    os.chmod(folder, 0o755)
    user = [] if os.getuid() else ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups"]
    configuration = {
        "ola-artnet.conf": "enabled = true\nip = 127.0.0.1\nuse_loopback = true\noutput_ports = 0\n",
        "ola-e131.conf": "enabled = true\nip = 127.0.0.1\ninput_ports = 4\noutput_ports = 0\n",
    }
    plugins = ("dummy espnet kinet milinst opendmx openpixelcontrol osc pathport renard sandnet shownet spi stageprofi "
               "uartdmx usbserial usbdmx karate gpio nanoleaf ftdidmx").split()
    for plugin in plugins:
        configuration[f"ola-{plugin}.conf"] = "enabled = false\n"
    for name, text in configuration.items():
        with open(os.path.join(folder, name), "w") as file:
            file.write(text)
    if user:
        subprocess.run(["chown", "-R", "65534:65534", folder], check=True)
    log = open(os.path.join(tempfile.gettempdir(), "olad.log"), "w")
    olad = subprocess.Popen([*user, "olad", "--no-http", "-c", folder, "-l", "3"], stdout=log, stderr=log,
                            env={**os.environ, "HOME": folder})
    try:
        devices = ""
        for _ in range(100):
            time.sleep(0.2)
            devices = subprocess.run(["ola_dev_info"], capture_output=True, text=True).stdout
            if "ArtNet" in devices and "E1.31" in devices:
                break
        number = {}
        for line in devices.splitlines():
            for name in ("ArtNet", "E1.31"):
                if line.startswith("Device ") and name in line:
                    number[name] = line.split()[1].rstrip(":")
        assert len(number) == 2, f"olad has {devices!r}"
        # Universe 1 of OLA hears E1.31's 1; universe 2 hears Art-Net's Port-Address 2.
        for name, universe in (("E1.31", "1"), ("ArtNet", "2")):
            subprocess.run(["ola_patch", "-d", number[name], "-p", "0", "-i", "-u", universe], check=True)
        recording = os.path.join(folder, "recording")
        recorder = subprocess.Popen([*user, "ola_recorder", "--record", recording, "--universes", "1,2"],
                                    stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(1)
        config = LIGHTS + ('[sacn]\nenabled = true\n[artnet]\nenabled = true\n'
                           'target = "127.0.0.1:6454"\n[osc]\nenabled = false\n')
        config = config.replace("[sacn]\nenabled = true\n", '[sacn]\nenabled = true\ntarget = "127.0.0.1:5568"\n')
        path, _, _ = session.run(mien, config, RUN)
        time.sleep(1)
        recorder.send_signal(signal.SIGINT)
        recorder.wait(10)
        got = {1: [], 2: []}
        for line in open(recording):
            universe, _, values = line.strip().partition(" ")
            if values and "," in values:
                got[int(universe)].append([int(value) for value in values.split(",")])
        rows, _ = session.read(path)
        for universe, name in ((1, "olad as a receiver of sACN"), (2, "olad as a receiver of Art-Net")):
            values = got[universe]
            print(f"{name}: {len(values)} frames recorded of {FRAMES}")
            compare(name, [one for one in values if len(one) == 512][:FRAMES - 5], rows, universe)
    finally:
        olad.terminate()
        olad.wait(10)
        shutil.rmtree(folder, ignore_errors=True)


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
        time.sleep(1)
        with socket.create_connection(("127.0.0.1", port)) as one:
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


def flood(port, connections):
    """Connections that send nonsense, or nothing, and stay."""
    held = []
    time.sleep(2)
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
    checks = {"sacn": check_sacn, "ola": check_ola, "live-link": check_live_link, "websocket": check_websocket}
    for name in wanted:
        checks[name](mien)


if __name__ == "__main__":
    main()
