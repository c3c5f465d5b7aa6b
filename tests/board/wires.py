"""What comes out of the board: datagrams on a UDP port and lines on the socket of its serial adapter, counted until it ends.

usage: wires.py PORT SERIAL_SOCKET REPORT
"""

import os
import socket
import sys
import time

port, serial_path, report = int(sys.argv[1]), sys.argv[2], sys.argv[3]
udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
udp.bind(("127.0.0.1", port))
udp.settimeout(0.2)
serial = None
datagrams = weights = 0
received = b""


def checked(line):
    """Whether the checksum of a line `$...*HH` is right: the exclusive or of what is between."""
    if not line.startswith(b"$") or line[-3:-2] != b"*":
        return False
    check = 0
    for byte in line[1:-3]:
        check ^= byte
    return line[-2:] == b"%02X" % check


written = 0.0
while True:
    if serial is None and os.path.exists(serial_path):
        serial = socket.socket(socket.AF_UNIX)
        try:
            serial.connect(serial_path)
            serial.setblocking(False)
        except OSError:
            serial = None
    try:
        datagram = udp.recv(65536)
        datagrams += 1
        weights += b"AU" in datagram or b"/units" in datagram or b"/au" in datagram.lower()
    except TimeoutError:
        pass
    if serial is not None:
        try:
            received += serial.recv(65536)
        except BlockingIOError:
            pass
    if time.monotonic() - written > 1.0:
        written = time.monotonic()
        lines = [line for line in received.splitlines() if line]
        whole = sum(checked(line) for line in lines)
        last = next((line for line in reversed(lines) if line.startswith(b"$AU,")), b"")
        with open(report + ".new", "w") as out:
            out.write(f"UDP {datagrams} datagrams, {weights} with weights\n")
            out.write(f"serial {len(lines)} lines, {whole} whole, the last: {last.decode(errors='replace')[:100]}\n")
        os.replace(report + ".new", report)
