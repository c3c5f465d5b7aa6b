"""Serial output of a real run: an emulated Arduino Uno that must tell good frames from damaged ones and drive the right
value, and ports that are plugged, unplugged, stuck and joined late, as a pseudo-terminal and behind a socket.

check_serial.py MIEN [BOARD RECEIVER UNIT SERVOS]      BOARD runs a firmware; UNIT is the weight that RECEIVER prints
"""
import json
import os
import pathlib
import pty
import random
import re
import select
import socket
import subprocess
import sys
import tempfile
import termios
import threading
import time
import tty

import session

FULL = 100
# How long a program may take to start, or to find a port again, on a machine that is busy.
PATIENCE_S = 300


def crc16(data):
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x8408 if crc & 1 else 0)
    return crc


def cobs_payload(frame):
    """The payload of a frame without its final zero; None if it does not check."""
    payload, at = bytearray(), 0
    while at < len(frame):
        code = frame[at]
        payload += frame[at + 1 : at + code]
        at += code
        if code < 255 and at < len(frame):
            payload.append(0)
    whole = at == len(frame) and len(payload) > 3 and crc16(payload[:-2]) == int.from_bytes(payload[-2:], "little")
    return bytes(payload[:-2]) if whole else None


def sentence(line):
    """What is between $ and *; None if it does not check."""
    text = line.decode("ascii", "replace")
    if not (text.startswith("$") and text.endswith("\r\n") and text[-5] == "*"):
        return None
    checksum = 0
    for character in text[1:-5]:
        checksum ^= ord(character)
    return text[1:-5] if text[-4:-2] == f"{checksum:02X}" else None


def weights(style, frame):
    """Milliseconds of a frame of weights; None if it is something else or does not check."""
    if style == "cobs":
        payload = cobs_payload(frame[:-1])
        return payload[2] | payload[3] << 8 if payload and payload[0] == 1 else None
    words = (sentence(frame) or "").split(",")
    return int(words[2]) & 0xFFFF if words[0] == "AU" else None


class Terminal:
    """A port as a pseudo-terminal behind a name that comes and goes."""

    def __init__(self):
        self.path = os.path.join(tempfile.mkdtemp(prefix="mien-port-"), "usb-board")
        self.ours = None

    def plug(self):
        self.ours, self.theirs = pty.openpty()
        tty.setraw(self.theirs)
        os.symlink(os.ttyname(self.theirs), self.path)

    def unplug(self):
        os.remove(self.path)
        os.close(self.ours)
        os.close(self.theirs)
        self.ours = None

    def read(self, wait):
        return os.read(self.ours, 65536) if select.select([self.ours], [], [], wait)[0] else b""

    def stop(self, stopped):
        """The line is stopped, as by a device that holds its hand up."""
        termios.tcflow(self.theirs, termios.TCOOFF if stopped else termios.TCOON)

    def discard(self):
        """What the machine at the other end never saw."""
        termios.tcflush(self.ours, termios.TCIFLUSH)


class Socket:
    """A port of a serial server."""

    def __init__(self):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.address = probe.getsockname()
        self.path = f"tcp:127.0.0.1:{self.address[1]}"
        self.server = self.client = None

    def plug(self):
        self.server = socket.socket()
        self.server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        # A server that keeps little: so that it is full soon when nobody reads.
        self.server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        self.server.bind(self.address)
        self.server.listen()

    def stop(self, stopped):
        """Nobody reads; the system keeps what comes, as far as it goes."""

    def unplug(self):
        for one in (self.client, self.server):
            if one:
                one.close()
        self.client = self.server = None

    def read(self, wait):
        ready = select.select([self.server, *([self.client] if self.client else [])], [], [], wait)[0]
        if self.server in ready:
            if self.client:
                self.client.close()
            self.client = self.server.accept()[0]
            ready = select.select([self.client], [], [], wait)[0]
        if self.client not in ready:
            return b""
        heard = self.client.recv(65536)
        if not heard:
            self.client.close()
            self.client = None
        return heard


def configuration(style, port, **more):
    lines = ["[osc]", "enabled = false", "[serial]", f"port = {json.dumps(port)}", f'style = "{style}"', f"full = {FULL}"]
    return "\n".join([*lines, *(f"{key} = {value}" for key, value in more.items())]) + "\n"


def check_uno(mien, board, firmware, style, unit):
    """Frames through an emulated Uno: damaged ones rejected, the others' value as in the CSV."""
    port, dice = Terminal(), random.Random(11)
    port.plug()
    uno = subprocess.Popen([board, firmware, "115200"], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    end = b"\0" if style == "cobs" else b"\n"
    good, damaged = [], []

    def hurt(frame):
        frame, at = bytearray(frame), dice.randrange(4, len(frame) - 6)
        how = dice.randrange(3)
        if how == 0:
            # Another value that the stuffing and the digits let pass: only the checksum tells.
            frame[at] ^= 1 if frame[at] != 1 else 2
        elif how == 1:
            del frame[at]
        else:
            frame.insert(at, frame[at])
            if style == "text":
                frame[at] ^= 1
        return bytes(frame)

    def between(process):
        heard, count = b"", 0
        while process.poll() is None or select.select([port.ours], [], [], 0)[0]:
            heard += port.read(0.1)
            while end in heard:
                frame, heard = heard.split(end, 1)
                frame += end
                count += 1
                if count == 1:
                    # The board joins in the middle of the first one.
                    frame = frame[len(frame) // 2 :]
                elif weights(style, frame) is not None and count < 290 and dice.random() < 0.12:
                    # Not the last ones: the board tells of what it rejected with the next whole one.
                    damaged.append(frame)
                    frame = hurt(frame)
                elif weights(style, frame) is not None:
                    good.append(weights(style, frame))
                uno.stdin.write(frame)
                uno.stdin.flush()

    # The board is there before the port is opened.
    time.sleep(0.3)
    path, log, _ = session.run(
        mien, configuration(style, port.path), ["--source", "simulated", "--frames", "300"], between
    )
    printed = uno.communicate()[0].decode()
    rows, units = session.read(path)
    lines = [[int(word) for word in line.split()] for line in printed.splitlines() if line[:1].isdigit()]
    assert len(lines) == len(good), f"{style}: {len(lines)} frames taken, {len(good)} were whole"
    assert len(damaged) > 10 and len(good) > 150, (len(damaged), len(good))
    assert lines[-1][3] == len(damaged), f"{style}: {lines[-1][3]} rejected, {len(damaged)} were damaged"
    by_ms = {row.ms & 0xFFFF: row for row in rows}
    worst = 0.0
    for (number, state, value, _), ms in zip(lines[:-1], good[:-1]):
        row = by_ms[ms]
        assert state == session.STATES[row.state], (state, row.state)
        worst = max(worst, abs(value - 255 * row.shown[units[unit]]))
    assert worst <= 1.0, f"{style}: off by {worst}/255"
    # The last one is the neutral one at the end.
    assert lines[-1][1:3] == [0, 0], lines[-1]
    span = max(line[2] for line in lines)
    print(f"   uno, {style}: {len(good)} whole frames taken, {len(damaged)} damaged ones rejected, ", end="")
    print(f"{units[unit]} 0 to {span}, off by at most {worst:.2f}/255")
    assert span > 30, "the unit did not move"


def check_servos(mien, board, firmware):
    """The README's configuration moves each servo of the README's sketch, and they rest when it ends."""
    readme = pathlib.Path(__file__).parents[2] / "README.md"
    config = re.search(r"printf '(\[serial\].*?)' >>? maker.toml", readme.read_text())[1].replace("\\n", "\n")
    port = Terminal()
    port.plug()
    uno = subprocess.Popen([board, firmware, "115200"], stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def between(process):
        while process.poll() is None or select.select([port.ours], [], [], 0)[0]:
            uno.stdin.write(port.read(0.1))
            uno.stdin.flush()

    time.sleep(0.3)
    config = "[osc]\nenabled = false\n" + re.sub('port = ".*?"', f"port = {json.dumps(port.path)}", config)
    session.run(mien, config, ["--source", "simulated:acted", "--frames", "1200"], between)
    told = [line.split() for line in uno.communicate()[0].decode().splitlines()]
    angles = {}
    for pin, angle in (words for words in told if len(words) == 2):
        angles.setdefault(int(pin), []).append(int(angle))
    spans = {pin: max(told) - min(told) for pin, told in angles.items()}
    print(f"   uno, servos on the README's configuration: degrees by pin {spans}")
    assert sorted(spans) == [3, 5, 6, 9, 10, 11] and min(spans.values()) >= 10, spans
    assert all(told[0] == told[-1] for told in angles.values()), "not at rest in the end"


def check_port(mien, style, port):
    """Plugged in late, joined in the middle, not read for seconds, unplugged, plugged in again."""
    phases = []

    def listen(name, seconds, pieces=1):
        heard, patience = b"", time.time() + PATIENCE_S
        while not heard and time.time() < patience:
            heard = port.read(0.05)
        end = b"\0" if style == "cobs" else b"\n"
        until = time.time() + seconds
        while time.time() < until or heard.count(end) < 4 and time.time() < patience:
            heard += port.read(0.05)
        frames = [frame + end for frame in heard.split(end)[:-1]]
        whole = [cobs_payload(frame[:-1]) if style == "cobs" else sentence(frame) for frame in frames]
        # A delimiter by itself ends what was cut off before.
        broken = [i for i, frame in enumerate(whole) if frame is None and frames[i] not in (b"\0", b"\r\n")]
        assert len(frames) > 3, f"{name}: {len(frames)} frames in {seconds} s"
        assert len(broken) < 1 + pieces and all(i <= 1 or pieces > 1 for i in broken), f"{name}: broken {broken} of {len(frames)}"
        phases.append(f"{name} {len(frames)} ({len(broken)} broken)")

    def happenings(process):
        # Looked for and not found, then plugged in.
        patience = time.time() + PATIENCE_S
        while "cannot be opened" not in open(process.log).read() and time.time() < patience:
            time.sleep(0.05)
        port.plug()
        listen("plugged in", 3.0)
        if isinstance(port, Terminal):
            time.sleep(0.2)
            port.discard()
            listen("joined late", 2.0)
        port.stop(True)
        time.sleep(5.0)
        port.stop(False)
        # What was kept for the reader, then the port opened anew: a seam at each.
        listen("stuck, then read", 7.0, pieces=3)
        port.unplug()
        time.sleep(1.5)
        port.plug()
        listen("plugged in again", 8.0)
        process.terminate()
        while process.poll() is None:
            port.read(0.05)

    _, log, status = session.run(mien, configuration(style, port.path, pose="true"), ["--source", "simulated"], happenings)
    latency = status["latency_ms"]
    print(f"   {type(port).__name__.lower()}, {style}: {', '.join(phases)}; latency {latency['median']:.1f} ms, 99 % {latency['p99']:.1f} ms")
    stuck = 1 if isinstance(port, Terminal) else 0
    for part, times in (("cannot be opened", 1), ("is open", 2 + stuck), ("is lost", 1 + stuck)):
        assert log.count(part) >= times, f"less than {times} times in the log: {part}\n{log}"
    return latency["median"]


def main():
    mien, *rest = sys.argv[1:]
    if rest:
        board, firmware, unit, servos = rest
        check_servos(mien, board, servos)
        for style in ("cobs", "text"):
            check_uno(mien, board, firmware, style, int(unit))
    problems = []

    def guarded(check, *arguments):
        try:
            medians.append(check(*arguments))
        except BaseException as problem:
            problems.append(problem)
            raise

    # Two ports at once, which mostly wait, and beside them a run without any: the machine may be busy with other things.
    for style in ("text", "cobs"):
        medians = []
        ports = [threading.Thread(target=guarded, args=(check_port, mien, style, kind())) for kind in (Terminal, Socket)]
        for port in ports:
            port.start()

        def until_done(process):
            for port in ports:
                port.join()
            patience = time.time() + PATIENCE_S
            while not os.path.exists(process.status) and time.time() < patience:
                time.sleep(0.05)
            process.terminate()

        _, _, status = session.run(mien, "[osc]\nenabled = false\n", ["--source", "simulated"], until_done)
        without = status["latency_ms"]
        print(f"   without a port at the same time: latency {without['median']:.1f} ms, 99 % {without['p99']:.1f} ms")
        slow = [median for median in medians if median > 3 * without["median"] + 5]
        assert not slow, f"frames take {slow} ms with a port, {without['median']} ms without"
    sys.exit(bool(problems))


if __name__ == "__main__":
    main()
