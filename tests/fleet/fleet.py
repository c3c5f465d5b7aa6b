"""The fleet of tests/fleet/run. Two boxes follow simulated faces; the others play a recording of an empty room, five frames a
second, so that thirty fit on a small machine: what is tested here is what boxes say, not what they see."""
import collections
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request

from check_mqtt import Broker, Listener
from check_network import free_port
import socket

FACES = 2
SCRAPE_S = 2
EMPTY_S = 0.2
# A recording is played no slower.
SLOW_S = 0.5


def empty_room(folder, seconds, each):
    """A recording of nobody: one picture under many names."""
    os.makedirs(folder)
    picture = os.path.join(folder, "picture")
    with open(picture, "wb") as file:
        file.write(b"P5 640 480 65535\n" + b"\xff\x07" * (640 * 480))
    names = []
    for i in range(int(seconds / each)):
        name = f"d-{1000 + i * each:.6f}-{int(i * each * 60e6) % 2**32}.pgm"
        os.link(picture, os.path.join(folder, name))
        names.append(name)
    os.remove(picture)
    with open(os.path.join(folder, "INDEX.txt"), "w") as file:
        file.write("\n".join(names) + "\n")


class Box:
    def __init__(self, mien, number, folder, broker, recording):
        self.name = f"box-{number:02}"
        self.folder = os.path.join(folder, self.name)
        os.makedirs(self.folder)
        self.source = "simulated" if number < FACES else recording
        self.mien, self.port = mien, free_port(socket.SOCK_STREAM)
        self.config = os.path.join(self.folder, "mien.toml")
        with open(self.config, "w") as file:
            file.write(f'[network]\nname = "{self.name}"\n[mqtt]\nenabled = true\nbroker = "127.0.0.1:{broker}"\nhealth_s = 2.0\n'
                       f'[osc]\nenabled = false\n[status]\npath = "{self.folder}/prom/status.json"\n'
                       f'[state]\npersist = false\n')
        os.makedirs(os.path.join(self.folder, "prom"))
        self.exporter = subprocess.Popen(
            ["prometheus-node-exporter", f"--web.listen-address=127.0.0.1:{self.port}", "--collector.disable-defaults",
             "--collector.textfile", f"--collector.textfile.directory={self.folder}/prom", "--collector.filesystem",
             "--collector.filesystem.mount-points-exclude=^/(dev|proc|sys|run)($|/)",
             "--collector.filesystem.fs-types-exclude=^(ext[234]|xfs|btrfs|overlay|squashfs|proc|sysfs|cgroup2?|devtmpfs|devpts|mqueue|9p|vfat)$"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self.process = None
        self.start()

    def start(self, source=None):
        with open(os.path.join(self.folder, "log"), "a") as log:
            self.process = subprocess.Popen([self.mien, "run", "--config", self.config, "--source", source or self.source],
                                            stdout=subprocess.DEVNULL, stderr=log)

    def kill(self):
        self.process.kill()
        self.process.wait()

    def cpu_s(self):
        with open(f"/proc/{self.process.pid}/stat") as file:
            fields = file.read().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class Prometheus:
    def __init__(self, folder, boxes):
        self.port = free_port(socket.SOCK_STREAM)
        rules = os.path.join(folder, "alerts.yml")
        with open("config/fleet/alerts.yml") as given, open(rules, "w") as file:
            # The empty rooms come at five frames a second, the slow one at two.
            file.write(given.read().replace("[30s]) < 20", "[30s]) < 3"))
        targets = [f"127.0.0.1:{box.port}" for box in boxes]
        relabel = [{"source_labels": ["__address__"], "regex": f"127.0.0.1:{box.port}", "target_label": "instance",
                    "replacement": box.name} for box in boxes]
        config = {"global": {"scrape_interval": f"{SCRAPE_S}s", "evaluation_interval": f"{SCRAPE_S}s"}, "rule_files": [rules],
                  "scrape_configs": [{"job_name": "mien", "static_configs": [{"targets": targets}], "relabel_configs": relabel}]}
        path = os.path.join(folder, "prometheus.yml")
        with open(path, "w") as file:
            json.dump(config, file)
        self.log = os.path.join(folder, "prometheus.log")
        self.process = subprocess.Popen(["prometheus", f"--config.file={path}", f"--storage.tsdb.path={folder}/tsdb",
                                         f"--web.listen-address=127.0.0.1:{self.port}"],
                                        stdout=subprocess.DEVNULL, stderr=open(self.log, "w"))

    def alerts(self):
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{self.port}/api/v1/alerts", timeout=5) as answer:
                alerts = json.load(answer)["data"]["alerts"]
        except OSError:
            return None
        return {(one["labels"]["alertname"], one["labels"]["instance"]) for one in alerts if one["state"] == "firing"}

    def answering(self):
        """How many boxes' exporters have answered."""
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{self.port}/api/v1/query?query=sum(up)", timeout=5) as answer:
                result = json.load(answer)["data"]["result"]
                return int(result[0]["value"][1]) if result else 0
        except OSError:
            return 0

    def wait(self, wanted, seconds=120):
        """Until exactly these fire."""
        end, seen = time.time() + seconds, None
        while time.time() < end:
            seen = self.alerts()
            if seen == wanted:
                return
            time.sleep(0.5)
        raise AssertionError(f"expected the alerts {sorted(wanted)}, found {seen} after {seconds} s")


def main():
    mien, minutes, count = os.path.abspath(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3])
    folder = tempfile.mkdtemp(prefix="mien-fleet-")
    random.seed(1)
    recording = os.path.join(folder, "empty")
    empty_room(recording, 60 * minutes + 900, EMPTY_S)
    port = free_port(socket.SOCK_STREAM)
    broker, listener, boxes, prometheus, mount = Broker(port), None, [], None, None
    try:
        listener = Listener(port)
        boxes = [Box(mien, number, folder, port, recording) for number in range(count)]
        prometheus = Prometheus(folder, boxes)
        presence = lambda box: listener.of(f"mien/{box.name}/presence")
        for box in boxes:
            listener.wait(f"mien/{box.name}/presence", "online", 120)
        wait_for(lambda: prometheus.answering() == count, "every exporter answers")
        prometheus.wait(set())
        print(f"{count} boxes are online, no alert")

        start, messages = time.time(), len(listener.messages)
        size = sum(len(topic) + len(payload) for topic, payload, _ in listener.messages)
        cpu = [box.cpu_s() for box in boxes]
        time.sleep(20)
        passed = time.time() - start
        new = listener.messages[messages:]
        print(f"steady: {len(new) / passed:.1f} messages a second, {sum(len(t) + len(p) for t, p, _ in new) / passed:.0f} bytes a second; "
              f"CPU of a box with an empty room {100 * (boxes[-1].cpu_s() - cpu[-1]) / passed:.1f} %, with a face "
              f"{100 * (boxes[0].cpu_s() - cpu[0]) / passed:.1f} %")

        # Kills: each is one offline and one online, no more, no less.
        expected = collections.Counter({box.name: len(presence(box)) for box in boxes})
        end, kills = start + 60 * minutes, 0
        while time.time() < end or kills < 20:
            box = random.choice(boxes)
            box.kill()
            kills += 1
            expected[box.name] += 1
            wanted = expected[box.name]
            wait_for(lambda: len(presence(box)) >= wanted and presence(box)[-1] == "offline", f"{box.name} offline")
            if kills == 1:
                prometheus.wait({("MienStopped", box.name)})
                print("alert: a box that stopped")
            box.start()
            expected[box.name] += 1
            wait_for(lambda: presence(box)[-1] == "online", f"{box.name} online")
            assert len(presence(box)) == expected[box.name], (box.name, presence(box))
            if kills == 1:
                prometheus.wait(set())
            time.sleep(max(0, min(60 * minutes / 20 - 8, 30)) if time.time() < end else 0)
        for box in boxes:
            assert presence(box) == (["online", "offline"] * 100)[:expected[box.name]], (box.name, presence(box))
        print(f"{kills} kills: every presence change arrived, once")

        # The broker dies; what changed meanwhile is there afterwards.
        broker.process.kill()
        broker.process.wait()
        boxes[3].kill()
        time.sleep(3)
        listener.messages.clear()
        broker.start()
        for box in boxes:
            if box is not boxes[3]:
                listener.wait(f"mien/{box.name}/presence", "online", 90)
        assert not presence(boxes[3])
        boxes[3].start()
        listener.wait("mien/box-03/presence", "online", 60)
        for box in boxes[:FACES]:
            listener.wait(f"mien/{box.name}/0/state", lambda text: True, 60)
        print("the broker was killed: everybody is back, the states too")

        # A sensor that is away, a rate too low, a host that is gone, a full disk.
        boxes[4].kill()
        boxes[4].start("kinect:NOT-THERE")
        slow = os.path.join(folder, "slow")
        empty_room(slow, 600, SLOW_S)
        boxes[5].kill()
        boxes[5].start(slow)
        boxes[6].exporter.kill()
        boxes[6].exporter.wait()
        wanted = {("MienSensorGone", "box-04"), ("MienRateLow", "box-05"), ("MienBoxGone", "box-06")}
        prometheus.wait(wanted)
        print("alerts: sensor gone, rate low, box gone")
        if os.getuid() == 0:
            mount = os.path.join(folder, "disk")
            os.makedirs(mount)
            if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", mount]).returncode == 0:
                with open(os.path.join(mount, "full"), "wb") as file:
                    file.write(bytes(1020 * 1024))
                # Every exporter of this machine sees the same disk.
                wait_for(lambda: len({i for a, i in prometheus.alerts() or () if a == "MienDiskFull"}) == count - 1, "disk full", 120)
                os.remove(os.path.join(mount, "full"))
                prometheus.wait(wanted)
                print("alert: disk full, and it clears")
        boxes[6].exporter = subprocess.Popen(boxes[6].exporter.args, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        for box in boxes[4:6]:
            box.kill()
            box.start()
        prometheus.wait(set(), 180)
        print("all alerts have cleared")
    finally:
        for box in boxes:
            for process in (box.process, box.exporter):
                process.kill()
                process.wait()
        for process in (prometheus and prometheus.process, broker.process):
            if process:
                process.kill()
                process.wait()
        if listener:
            listener.close()
        if mount:
            subprocess.run(["umount", mount])
        shutil.rmtree(folder, ignore_errors=True)


def wait_for(condition, what, seconds=60):
    end = time.time() + seconds
    while not condition():
        assert time.time() < end, f"not in {seconds} s: {what}"
        time.sleep(0.05)


if __name__ == "__main__":
    main()
