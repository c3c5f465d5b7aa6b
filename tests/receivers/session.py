"""A run of mien, its CSV, and what each wire should show of it: the wires' rules written a second time, from their
descriptions, so that a mistake in one of the two shows."""
import csv
import json
import math
import os
import subprocess
import tempfile

UNIT_FACEOSC_M = 0.0036
HOLD_S, DECAY_S = 0.2, 0.4
STATES = {"absent": 0, "warming": 1, "tracking": 2, "held": 3, "lost": 4, "posed": 5}
FACE = ("warming", "tracking", "held")
PRESENT = (*FACE, "posed")


class Row:
    """One frame of the CSV."""

    def __init__(self, cells, units):
        self.frame = int(cells["frame"])
        self.ms = int(cells["time_us"]) // 1000
        self.seconds = int(cells["time_us"]) * 1e-6
        self.state = cells["state"]
        self.present = self.state in PRESENT
        self.face = self.state in FACE
        self.confidence = float(cells["confidence"])
        number = lambda name: float(cells[name]) if cells.get(name) else 0.0
        self.raw = {unit: number("w_" + unit) for unit in units}
        self.pose = [number(name) for name in ("tx_m", "ty_m", "tz_m", "qx", "qy", "qz", "qw")]
        self.measure = lambda name: number("m_" + name)
        self.pixels = [(number(f"x{i}"), number(f"y{i}")) for i in range(68)]
        self.shown = {}


def other_side(unit, units):
    other = {"AU61": "AU62", "AU62": "AU61"}.get(unit) or {"L": unit[:-1] + "R", "R": unit[:-1] + "L"}.get(unit[-1])
    return other if other in units else unit


def read(path, mirror=False, gains=None):
    """The rows of a CSV with the weights as a wire shows them, and the names of the units."""
    gains = gains or {}
    with open(path) as file:
        table = csv.DictReader(file)
        units = [name[2:] for name in table.fieldnames if name.startswith("w_")]
        rows = [Row(cells, units) for cells in table]
    last, seen = dict.fromkeys(units, 0.0), None
    for row in rows:
        if row.face:
            for unit in units:
                source = other_side(unit, units) if mirror else unit
                last[unit] = min(max(row.raw[source] * gains.get(unit, 1.0), 0.0), 1.0)
            seen = row.seconds
        since = math.inf if seen is None else row.seconds - seen - HOLD_S
        share = 1.0 if since <= 0 else max(0.0, 1 - since / DECAY_S)
        row.shown = {unit: weight * share for unit, weight in last.items()}
        if mirror:
            x, y, z, a, b, c, d = row.pose
            row.pose = [-x, y, z, a, -b, -c, d]
    return rows, units


def run(mien, configuration, arguments, while_running=None):
    """Runs mien with a configuration; the path of its CSV, its log and its last status."""
    folder = tempfile.mkdtemp(prefix="mien-receivers-")
    path = lambda name: os.path.join(folder, name)
    status = f"[status]\npath = {json.dumps(path('status.json'))}\n"
    with open(path("mien.toml"), "w") as file:
        file.write(configuration + status)
    command = [mien, "run", "--config", path("mien.toml"), "--csv", path("run.csv"), *arguments]
    with open(path("log"), "w") as log:
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=log)
        process.log, process.status = path("log"), path("status.json")
        try:
            if while_running:
                while_running(process)
            code = process.wait()
        finally:
            process.kill()
    log = open(path("log")).read()
    assert code == 0, f"mien ended with {code}: {log}"
    with open(path("status.json")) as file:
        return path("run.csv"), log, json.load(file)
