"""neighbours.py MIEN [SECONDS [together | WORD]]: hostile neighbours, each for SECONDS (20) against a run of its own, beside one
that is left alone; `together` throws a broker and one of the others at the same run, in half the time; WORD picks those whose
names have it. MIEN needs --features wires.

  * an MQTT broker that refuses the subscription over and over, publishes without end, drips a byte a second, announces a
    length that never comes, or hangs up at once;
  * 300 WebSocket clients, 300 readers of the page and its events: they come again and again, finish no request (a letter at a
    time), or ask and read nothing.

What is held: at most 20 kB of log; the calm run's frames, within 3 %; memory within 1 MiB after the first minute, or half of
a shorter run; for a frame at most twice the calm run's processor time, of all threads. Where the calm run has no 27 frames
a second the machine has other work: frames are told, not judged, and the end is 2 where nothing else is wrong.
"""
import contextlib
import os
import re
import socket
import subprocess
import sys
import tempfile
import threading
import time

MIEN = sys.argv[1]
SECONDS, WORD = int(sys.argv[2]) if len(sys.argv) > 2 else 20, sys.argv[3] if len(sys.argv) > 3 else ""
LOG, FLAT, RATIO, FRAMES = 20_000, 1.0, 2.0, 0.97
# Frames a second of a calm run on a machine of its own.
OWN = 27
CLIENTS = 300
CONNACK = bytes([0x20, 2, 0, 0])
NOISE = bytes([0x30, 9, 0, 5]) + b"a/b/c" + b"no"


def broker(config, bytes_of):
    """Says CONNACK and then what `bytes_of` gives, over and over; a byte a second without it."""
    listener = socket.create_server(("127.0.0.1", 0))
    listener.settimeout(0.5)
    config.append(f'[mqtt]\nenabled = true\ncommands = true\nbroker = "127.0.0.1:{listener.getsockname()[1]}"\n')

    def attack(stop):
        while not stop.is_set():
            with contextlib.suppress(OSError):
                talk = listener.accept()[0]
                talk.settimeout(2)
                with talk:
                    talk.recv(2000)
                    if bytes_of is None:
                        for byte in CONNACK + NOISE * 100:
                            talk.send(bytes([byte]))
                            if stop.wait(1):
                                break
                    elif some := bytes_of():
                        talk.sendall(CONNACK)
                        while not stop.is_set():
                            talk.sendall(some)

    return attack


def crowd(config, section, asks):
    """Clients that read nothing and come back: each sends one of `asks`, every other one a letter at a time."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    config.append(f'[{section}]\nenabled = true\nlisten = "127.0.0.1:{port}"\n')
    host = f"HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n"

    def attack(stop):
        held, came = [], 0
        while not stop.wait(0.05):
            with contextlib.suppress(OSError):
                one = socket.socket()
                one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
                one.settimeout(1)
                one.connect(("127.0.0.1", port))
                one.setblocking(False)
                words = (asks[came // 2 % len(asks)].replace("HTTP/1.1\r\n", host)).encode()
                came += 1
                if came % 2:
                    one.send(words)
                    words = b""
                held.append([one, words])
            for slow in held:
                with contextlib.suppress(OSError):
                    if slow[1] and came % 20 == 0:
                        slow[0].send(slow[1][:1])
                        slow[1] = slow[1][1:]
            if len(held) > CLIENTS:
                held.pop(0)[0].close()

    return attack


UPGRADE = "GET / HTTP/1.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
ASK = "GET {} HTTP/1.1\r\n\r\n".format
BROKERS = {
    "a broker that refuses over and over": lambda config: broker(config, lambda: bytes([0x90, 3, 0, 1, 0x80]) * 4000),
    "a broker that publishes without end": lambda config: broker(config, lambda: NOISE * 4000),
    "a broker that drips": lambda config: broker(config, None),
    "a length that never comes": lambda config: broker(config, lambda: bytes([0x30, 0xFF, 0xFF, 0xFF, 0x7F]) + b"x" * 60000),
    "a broker that hangs up": lambda config: broker(config, lambda: None),
}
OTHERS = {
    "WebSocket clients that never read": lambda config: crowd(config, "websocket", [UPGRADE]),
    "pages that never finish": lambda config: crowd(config, "page", [ASK("/"), ASK("/events"), "POST /neutral/0 HTTP/1.1\r\n\r\n"]),
}


class Run:
    """A run of mien under `attacks`, what it writes and what it takes."""

    def __init__(self, folder, attacks):
        self.attacks, self.stop, self.memory, self.name = [], threading.Event(), [], " + ".join(name for name, _ in attacks) or "nobody"
        config = ['[osc]\ntarget = "127.0.0.1:9"\n[status]\npath = ""\n']
        for name, prepare in attacks:
            try:
                self.attacks.append(prepare(config))
            except OSError as problem:
                print(f"left out: {name} ({problem})")
        path, self.table, self.log = (f"{folder}/{len(attacks)}.{kind}" for kind in ("toml", "csv", "log"))
        with open(path, "w") as file:
            file.write("".join(config))
        with open(self.log, "w") as errors:
            words = [MIEN, "run", "--source", "simulated", "--config", path, "--csv", self.table]
            self.process = subprocess.Popen(words, stderr=errors)
        self.threads = [threading.Thread(target=self.throw, args=[one], daemon=True) for one in self.attacks]
        for one in self.threads:
            one.start()

    def throw(self, attack):
        # Whoever attacks in earnest has a machine of their own.
        os.nice(10)
        attack(self.stop)

    def look(self):
        if self.process.poll() is None:
            with open(f"/proc/{self.process.pid}/status") as file:
                self.memory.append(int(re.search(r"VmRSS:\s+(\d+)", file.read())[1]) / 1024)
            with open(f"/proc/{self.process.pid}/stat") as file:
                self.spent = sum(map(int, file.read().rsplit(")", 1)[1].split()[11:13])) / os.sysconf("SC_CLK_TCK")

    def end(self):
        with open(self.table) as file:
            frames = max(1, sum(1 for _ in file) - 1)
        self.rate, self.each_ms = frames / SECONDS, self.spent / frames * 1e3
        self.stop.set()
        for one in self.threads:
            one.join(5)
        self.process.terminate()
        self.code = self.process.wait(20)
        self.bytes = os.path.getsize(self.log)
        settled = self.memory[len(self.memory) * min(60, SECONDS // 2) // SECONDS:]
        self.grew = max(settled) - min(settled)

    def misses(self, calm):
        """Tells the figures; what is not held."""
        print(f"{self.rate:8.2f}{self.bytes:8}{self.grew:9.2f}{self.each_ms:9.2f}  {self.name}", flush=True)
        return [f"{self.name}: {what}" for is_missed, what in [
            (self.code != 0, f"ended with {self.code}"),
            (self.bytes > LOG, "the log is too long"),
            (calm.rate >= OWN and self.rate < FRAMES * calm.rate, "frames are missing"),
            (self.grew > FLAT, "memory is not flat"),
            (self.each_ms > RATIO * calm.each_ms, "too much processor time"),
        ] if is_missed]


def main():
    print("frames/s   log, B  MiB more  ms/frame")
    missed, shared, others = [], False, list(OTHERS.items())
    pairs = [[one, *others[k:k + 1]] for k, one in enumerate(BROKERS.items())]
    alone = [[one] for one in [*BROKERS.items(), *others] if WORD in one[0]]
    for attacks in pairs if WORD == "together" else alone:
        with tempfile.TemporaryDirectory() as folder:
            both = calm, _ = Run(folder, []), Run(folder, attacks)
            end = time.monotonic() + SECONDS
            while time.monotonic() < end:
                time.sleep(min(1, SECONDS / 20))
                for one in both:
                    one.look()
            for one in both:
                one.end()
            for one in both:
                missed += one.misses(calm)
            shared |= calm.rate < OWN
    if shared:
        print(f"!! a run left alone had less than {OWN} frames a second: this machine has other work, and those frames are not judged")
    for one in missed:
        print(f"!! {one}")
    sys.exit(1 if missed else 2 if shared else 0)


main()
