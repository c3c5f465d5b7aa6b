#!/usr/bin/env python3
"""MQTT against Debian's Mosquitto and the client paho-mqtt: everything arrives and equals the CSV; a broker that restarts, is
stopped for a while, refuses, or is none at all; TLS.

    check_mqtt.py MIEN
"""
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time

import session
from check_network import FRAMES, RUN, free_port

MOSQUITTO = next((path for path in ("/usr/sbin/mosquitto", "/usr/local/sbin/mosquitto", "/usr/bin/mosquitto") if os.path.exists(path)), None)


class Broker:
    def __init__(self, port, password=None, certificate=None):
        self.port = port
        self.folder = tempfile.mkdtemp(prefix="mien-mqtt-")
        lines = [f"listener {port} 127.0.0.1", "persistence false"]
        if certificate:
            # As itself it may not read what lies in this run's folder.
            lines += [f"certfile {certificate}.pem", f"keyfile {certificate}.key", "user root"]
        if password:
            path = os.path.join(self.folder, "passwords")
            open(path, "w").close()
            os.chmod(path, 0o700)
            subprocess.run(["mosquitto_passwd", "-b", path, "box", password], check=True, capture_output=True)
            lines += ["allow_anonymous false", f"password_file {path}", "user root"]
        else:
            lines += ["allow_anonymous true"]
        with open(os.path.join(self.folder, "conf"), "w") as file:
            file.write("\n".join(lines) + "\n")
        self.process = None
        self.start()

    def start(self):
        with open(os.path.join(self.folder, "log"), "a") as log:
            self.process = subprocess.Popen([MOSQUITTO, "-c", os.path.join(self.folder, "conf")], stdout=log, stderr=log)
        for _ in range(100):
            try:
                socket.create_connection(("127.0.0.1", self.port), timeout=1).close()
                return
            except OSError:
                time.sleep(0.05)
        raise AssertionError(open(os.path.join(self.folder, "log")).read())

    def stop(self):
        self.process.terminate()
        self.process.wait(10)


class Listener:
    """Everything published, in order; comes back by itself."""

    def __init__(self, port, user=None, authority=None):
        import paho.mqtt.client as paho
        self.messages = []
        self.client = paho.Client(paho.CallbackAPIVersion.VERSION2, protocol=paho.MQTTv5)
        if user:
            self.client.username_pw_set(*user)
        if authority:
            self.client.tls_set(authority)
        self.client.on_connect = lambda client, *_: client.subscribe("#", 1)
        self.client.on_message = lambda _, __, message: self.messages.append((message.topic, message.payload.decode(), message.retain))
        self.client.reconnect_delay_set(1, 1)
        self.client.connect("localhost", port)
        self.client.loop_start()

    def of(self, topic):
        return [payload for name, payload, _ in list(self.messages) if name == topic]

    def wait(self, topic, payload, seconds=20):
        end = time.time() + seconds
        while time.time() < end:
            if any(payload(one) if callable(payload) else one == payload for one in self.of(topic)):
                return
            time.sleep(0.05)
        raise AssertionError(f"no {payload} on {topic} in {seconds} s: {self.of(topic)[-3:]}")

    def close(self):
        self.client.loop_stop()
        self.client.disconnect()


def config(port, more=""):
    return (f'[mqtt]\nenabled = true\nbroker = "127.0.0.1:{port}"\nrate_hz = 30.0\nhealth_s = 1.0\n{more}'
            '[network]\nname = "hall"\n[osc]\nenabled = false\n')


def equal_weights(listener, rows, units):
    """How many of the weights told are in the CSV, where all must be."""
    by_time = {row.ms: row for row in reversed(rows)}
    compared = 0
    for text in listener.of("mien/hall/0/weights"):
        weights = json.loads(text)
        row = by_time[weights["time_us"] // 1000]
        if row.present and row is not rows[-1]:
            for unit in units:
                assert abs(weights[unit] - row.shown[unit]) <= 0.5e-4 + 1e-6, (unit, row.frame)
                compared += 1
    assert compared > FRAMES // 2 * len(units), compared
    return compared


def everything(mien):
    port = free_port(socket.SOCK_STREAM)
    broker = Broker(port, password="secret")
    listener = Listener(port, ("box", "secret"))
    secret = os.path.join(broker.folder, "password")
    with open(secret, "w") as file:
        file.write("secret\n")
    more = f'user = "box"\npassword_file = {json.dumps(secret)}\ncommands = true\nhome_assistant = true\n'
    log = []

    def commands(_):
        listener.wait("mien/hall/0/state", lambda text: json.loads(text)["present"])
        time.sleep(1)
        listener.client.publish("mien/hall/cmd/neutral", "0", 1)
        listener.client.publish("mien/hall/cmd/forget", "9", 1)
        listener.client.publish("mien/hall/cmd/freeze", "0 maybe", 1)
        listener.client.publish("mien/hall/cmd/fly", "0", 1)
    path, log, status = session.run(mien, config(port, more), RUN, commands)
    time.sleep(1)
    listener.close()
    broker.stop()
    rows, units = session.read(path)
    assert listener.of("mien/hall/presence") == ["online", "offline"], listener.of("mien/hall/presence")
    # What was true on connecting is told once more.
    states = list({state["changes"]: state for state in map(json.loads, listener.of("mien/hall/0/state"))}.values())
    told = [state["state"] for state in states]
    wanted = [row.state for i, row in enumerate(rows) if row.state != "absent" and (i == 0 or row.state != rows[i - 1].state)]
    assert told == [*wanted, "absent"], (told, wanted)
    assert [state["changes"] for state in states] == list(range(1, len(states) + 1)), states
    compared = equal_weights(listener, rows, units)
    health = [json.loads(text) for text in listener.of("mien/hall/health")]
    assert len(health) >= 6 and any(one["sensor"] for one in health[1:]), health
    # Each rate is that of the frames since the report before: together they took as long as passed, however slow the machine.
    told = [(new["frames"] - old["frames"], new["rate_hz"]) for old, new in zip(health, health[1:])]
    took_s = sum(frames / rate for frames, rate in told if rate)
    passed_s = health[-1]["uptime_s"] - health[0]["uptime_s"]
    assert abs(took_s - passed_s) < 0.3, (took_s, passed_s, health)
    discovery = [(topic, json.loads(text)) for topic, text, _ in listener.messages if topic.startswith("homeassistant/")]
    assert len({one["unique_id"] for _, one in discovery}) == 6
    for topic, one in discovery:
        assert one["availability_topic"] == "mien/hall/presence" and one["device"]["identifiers"] == ["mien_hall"], one
        assert one.get("state_topic", "mien/hall/").startswith("mien/hall/"), one
    wire = next(one for one in status["outputs"] if one["name"] == "mqtt")
    assert (wire["commands"], wire["commands_refused"]) == (1, 3), wire
    assert "asked to set the neutral face of person 1" in log, log
    print(f"mosquitto, MQTT 3.1.1: presence, {len(states)} states, {len(health)} reports of health, "
          f"{compared} weights equal to the CSV's, {len(discovery)} entities for Home Assistant, 1 command taken and 3 refused")


def certificates(folder):
    """An authority, and a broker's certificate for localhost that it signed; another authority that did not."""
    def openssl(*words):
        subprocess.run(["openssl", *words], check=True, capture_output=True, cwd=folder)
    new = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes"]
    for name in ("authority", "stranger"):
        openssl("req", "-x509", *new, "-keyout", f"{name}.key", "-out", f"{name}.pem", "-days", "2", "-subj", f"/CN=mien test {name}",
                "-addext", "basicConstraints=critical,CA:TRUE")
    openssl("req", *new, "-keyout", "broker.key", "-out", "broker.csr", "-subj", "/CN=localhost")
    with open(os.path.join(folder, "names"), "w") as file:
        file.write("subjectAltName=DNS:localhost\nbasicConstraints=CA:FALSE\n")
    openssl("x509", "-req", "-in", "broker.csr", "-CA", "authority.pem", "-CAkey", "authority.key", "-CAcreateserial", "-days", "2",
            "-extfile", "names", "-out", "broker.pem")


def sealed(mien):
    """With TLS: the same values; a broker whose certificate a stranger signed, or that has another name, is told nothing."""
    port = free_port(socket.SOCK_STREAM)
    folder = tempfile.mkdtemp(prefix="mien-tls-")
    certificates(folder)
    path_of = lambda name: os.path.join(folder, name)
    broker = Broker(port, certificate=path_of("broker"))
    listener = Listener(port, authority=path_of("authority.pem"))

    def setting(host, authority):
        return config(port, f"tls = true\nca_file = {json.dumps(path_of(authority))}\n").replace("127.0.0.1:", f"{host}:")
    path, _, status = session.run(mien, setting("localhost", "authority.pem"), RUN)
    time.sleep(1)
    rows, units = session.read(path)
    compared = equal_weights(listener, rows, units)
    assert listener.of("mien/hall/presence") == ["online", "offline"], listener.of("mien/hall/presence")
    listener.messages.clear()
    for host, authority, reason in (("localhost", "stranger.pem", "UnknownIssuer"), ("127.0.0.1", "authority.pem", "not valid for name")):
        _, log, status = session.run(mien, setting(host, authority), RUN)
        assert reason in log, log
        assert next(one for one in status["outputs"] if one["name"] == "mqtt")["sent"] == 0, status
    # Somebody without TLS where it should be: no word of ours in the clear.
    broker.stop()
    heard = b""
    with socket.create_server(("127.0.0.1", port)) as server:
        server.settimeout(20)

        def listen(_):
            nonlocal heard
            one, _ = server.accept()
            one.settimeout(2)
            heard = one.recv(10000)
            one.sendall(b"\x20\x02\x00\x00")
            one.close()
        _, log, _ = session.run(mien, setting("localhost", "authority.pem"), RUN, listen)
    assert heard[:1] == b"\x16" and b"hall" not in heard, heard
    assert not listener.messages, listener.messages
    listener.close()
    print(f"mosquitto, TLS: {compared} weights equal to the CSV's; a stranger's certificate, another name and a server without TLS are told nothing")


def trouble(mien):
    """Nobody there; then nonsense; then one that refuses; then a broker, restarted, then stopped for a while; then killed boxes."""
    port = free_port(socket.SOCK_STREAM)
    rounds = []

    def troubled(process):
        # Somebody else's server: says what is no MQTT.
        with socket.create_server(("127.0.0.1", port)) as server:
            server.settimeout(20)
            one, _ = server.accept()
            one.sendall(os.urandom(3000))
            time.sleep(0.3)
            one.close()
            one, _ = server.accept()
            one.recv(1000)
            one.sendall(b"\x20\x02\x00\x05")
            one.close()
        broker = Broker(port)
        listener = Listener(port)
        listener.wait("mien/hall/presence", "online", 40)
        broker.stop()
        time.sleep(2)
        listener.messages.clear()
        broker.start()
        listener.wait("mien/hall/presence", "online", 40)
        listener.wait("mien/hall/0/state", lambda text: True)
        # A broker that takes nothing for a while.
        broker.process.send_signal(signal.SIGSTOP)
        time.sleep(3)
        broker.process.send_signal(signal.SIGCONT)
        listener.messages.clear()
        listener.wait("mien/hall/0/weights", lambda text: True)
        rounds.append((broker, listener))
        process.send_signal(signal.SIGINT)
    _, log, status = session.run(mien, config(port), ["--source", "simulated"], troubled)
    wire = next(one for one in status["outputs"] if one["name"] == "mqtt")
    assert wire["commands_refused"] == 2, wire
    late = status["latency_ms"]
    broker, listener = rounds[0]
    time.sleep(0.5)
    assert listener.of("mien/hall/presence")[-1] == "offline"
    # Killed without a word: the broker says it.
    listener.messages.clear()

    def kill(process):
        listener.wait("mien/hall/presence", "online")
        process.kill()
    try:
        session.run(mien, config(port), ["--source", "simulated"], kill)
    except (AssertionError, FileNotFoundError):
        pass
    listener.wait("mien/hall/presence", "offline")
    listener.close()
    broker.stop()
    assert log.count("retrying every") <= 4, log
    print(f"mosquitto: nonsense and a refusal counted, found again after a restart and a stop, the last will told; latency {late}")


def main():
    if MOSQUITTO is None:
        print("!! skipped: mosquitto is not installed")
        return
    everything(sys.argv[1])
    sealed(sys.argv[1])
    trouble(sys.argv[1])


if __name__ == "__main__":
    main()
