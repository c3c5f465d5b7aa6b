"""neighbours.py MIEN [SECONDS]: hostile neighbours, one after the other, each for SECONDS (20) beside a run of its own.

A broker that refuses the subscription over and over, publishes without end, drips a byte a second, announces a length that
never comes, or hangs up at once; a host that answers every mDNS probe by claiming the name (where multicast works).

What is held, per neighbour: at most 20 kB of log, 24 frames a second or nine tenths of the calm run's, at most 20 names.
MIEN needs --features wires.
"""
import contextlib
import os
import re
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time

MIEN, SECONDS = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 20
CONNACK = bytes([0x20, 2, 0, 0])
NOISE = bytes([0x30, 9, 0, 5]) + b"a/b/c" + b"no"
ATTACKS = {
    "refuses over and over": lambda: CONNACK + bytes([0x90, 3, 0, 1, 0x80]) * 4000,
    "publishes without end": lambda: CONNACK + NOISE * 4000,
    "drips": None,
    "a length that never comes": lambda: CONNACK + bytes([0x30, 0xFF, 0xFF, 0xFF, 0x7F]) + b"x" * 60000,
    "hangs up": lambda: None,
}


def broker(listener, bytes_of, stop):
    while not stop.is_set():
        with contextlib.suppress(OSError):
            talk = listener.accept()[0]
            talk.settimeout(2)
            with talk:
                talk.recv(2000)
                if bytes_of is None:
                    for byte in CONNACK + NOISE:
                        talk.send(bytes([byte]))
                        time.sleep(1)
                while bytes_of and not stop.is_set() and (some := bytes_of()):
                    talk.sendall(some)


def name_thief(stop):
    """Answers every probe with records of the same name that are somebody else's."""
    ear = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    ear.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    ear.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
    ear.bind(("", 5353))
    group = socket.inet_aton("224.0.0.251")
    ear.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group + socket.inet_aton("127.0.0.1"))
    ear.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
    ear.settimeout(0.2)
    while not stop.is_set():
        with contextlib.suppress(TimeoutError):
            probe = ear.recv(2000)
            if probe[2] & 0x80 or b"mien-" not in probe:
                continue
            at = probe.index(b"mien-") - 1
            host = probe[at:at + 1 + probe[at]] + b"\5local\0"
            answer = host + struct.pack(">HHIH", 1, 0x8001, 120, 4) + bytes([127, 9, 9, 9])
            ear.sendto(struct.pack(">6H", 0, 0x8400, 0, 1, 0, 0) + answer, ("224.0.0.251", 5353))


def run(name, config, attack=None):
    """Frames a second, bytes of log and the log of a run."""
    stop = threading.Event()
    thread = attack and threading.Thread(target=attack, args=(stop,), daemon=True)
    if thread:
        thread.start()
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "mien.toml")
        with open(path, "w") as file:
            file.write(config + '[osc]\ntarget = "127.0.0.1:9"\n[status]\npath = ""\n')
        table, log = os.path.join(folder, "run.csv"), os.path.join(folder, "log")
        with open(log, "w") as errors:
            one = subprocess.Popen([MIEN, "run", "--source", "simulated", "--config", path, "--csv", table], stderr=errors)
            time.sleep(SECONDS)
            one.terminate()
            gone = one.wait(20)
        frames = sum(1 for _ in open(table)) - 1
        text = open(log).read()
    stop.set()
    if thread:
        thread.join(5)
    print(f"{name:28} {frames / SECONDS:5.1f} frames/s, {len(text):6} bytes of log, ended with {gone}")
    return frames / SECONDS, text


calm, _ = run("nobody", "")
failed = []
for name, bytes_of in ATTACKS.items():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(0.5)
        config = f'[mqtt]\nenabled = true\ncommands = true\nbroker = "127.0.0.1:{listener.getsockname()[1]}"\n'
        rate, log = run(f"a broker that {name}" if name != "a length that never comes" else name, config,
                        lambda stop: broker(listener, bytes_of, stop))
    if len(log) > 20_000 or rate < min(24, 0.9 * calm):
        failed.append(name)
try:
    rate, log = run("a thief of names", '[network]\nname = "hall"\n[discovery]\nenabled = true\n', name_thief)
    names = set(re.findall(r'trying "([^"]+)"', log))
    print(f"{len(names)} names tried: {', '.join(sorted(names)[:4])} ...")
    if len(log) > 20_000 or len(names) > 20:
        failed.append("a thief of names")
except OSError as problem:
    print(f"skipped: mDNS ({problem})")
sys.exit(f"FAILED: {', '.join(failed)}" if failed else 0)
