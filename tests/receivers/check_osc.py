"""Runs mien with all OSC presets to every receiver at once and compares what each received with the CSV of the same run.

check_osc.py MIEN oscdump=PATH python-osc=PYTHON vmcp=PYTHON node-osc=NODE   (those that are installed)
"""
import json
import math
import os
import re
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time

import session

HERE = os.path.dirname(os.path.abspath(__file__))
PRESETS = ("osc", "vmc", "vrchat", "faceosc")
# CSV and oscdump have six decimals, the wires single precision.
CLOSE = 2.1e-6

# What the presets are in terms of units (largest of several), for the units that are measured.
ARKIT = {
    "browOuterUpLeft": "AU2L", "browOuterUpRight": "AU2R", "browDownLeft": "AU4L", "browDownRight": "AU4R",
    "eyeWideLeft": "AU5L", "eyeWideRight": "AU5R", "noseSneerLeft": "AU9L", "noseSneerRight": "AU9R",
    "mouthPucker": "AU18", "mouthStretchLeft": "AU20", "mouthStretchRight": "AU20", "mouthFunnel": "AU22",
    "jawOpen": "AU26", "mouthRollLower": "AU28", "mouthRollUpper": "AU28", "jawForward": "AU29",
    "jawLeft": "AU30L", "jawRight": "AU30R", "eyeBlinkLeft": "AU43L", "eyeBlinkRight": "AU43R",
    "mouthUpperUpLeft": "AU10L", "mouthUpperUpRight": "AU10R", "mouthSmileLeft": "AU12L", "mouthSmileRight": "AU12R",
    "mouthShrugLower": "AU17", "mouthDimpleLeft": "AU14L", "mouthDimpleRight": "AU14R",
    "cheekSquintLeft": "AU6L", "cheekSquintRight": "AU6R",
    "mouthFrownLeft": "AU15L", "mouthFrownRight": "AU15R", "eyeLookOutLeft": "AU61", "eyeLookInRight": "AU61",
    "eyeLookInLeft": "AU62", "eyeLookOutRight": "AU62", "eyeLookUpLeft": "AU63", "eyeLookUpRight": "AU63",
    "eyeLookDownLeft": "AU64", "eyeLookDownRight": "AU64",
}
ARKIT = {name: (lambda w, unit=unit: w[unit]) for name, unit in ARKIT.items()}
ARKIT["browInnerUp"] = lambda w: max(w["AU1L"], w["AU1R"])
ARKIT["cheekPuff"] = lambda w: max(w["AU34L"], w["AU34R"])
# What is not measured, from what it goes with.
for side in "LR":
    name = {"L": "Left", "R": "Right"}[side]
    ARKIT |= {
        "eyeSquint" + name: lambda w, s=side: 0.3 * w["AU12" + s] + 0.4 * w["AU9" + s] + 0.3 * w["AU4" + s],
        "mouth" + name: lambda w, s=side: 0.4 * w["AU30" + s],
        "mouthLowerDown" + name: lambda w, s=side: 0.5 * w["AU25"] - 0.5 * w["AU26"] + 0.3 * w["AU9" + s],
        "mouthPress" + name: lambda w: 0.5 * w["AU17"] + 0.3 * w["AU28"],
    }
ARKIT |= {"mouthClose": lambda w: w["AU26"] - w["AU25"], "mouthShrugUpper": lambda w: 0.5 * w["AU17"], "tongueOut": lambda w: 0.0}
VRM1 = {
    "aa": lambda w: w["AU26"] - w["AU18"] - 0.5 * w["AU20"], "ih": lambda w: w["AU20"] - w["AU26"],
    "ou": lambda w: w["AU18"] - 0.5 * w["AU26"], "ee": lambda w: 0.5 * w["AU20"] + 0.5 * w["AU25"] - w["AU18"],
    "oh": lambda w: w["AU22"], "happy": lambda w: max(w["AU12L"], w["AU12R"]), "angry": lambda w: max(w["AU4L"], w["AU4R"]),
    "surprised": lambda w: 0.5 * max(w["AU2L"], w["AU2R"]) + 0.5 * max(w["AU5L"], w["AU5R"]),
    "blinkLeft": lambda w: w["AU43L"], "blinkRight": lambda w: w["AU43R"], "sad": lambda w: max(w["AU15L"], w["AU15R"]),
    "lookLeft": lambda w: w["AU61"], "lookRight": lambda w: w["AU62"], "lookUp": lambda w: w["AU63"], "lookDown": lambda w: w["AU64"],
}
UNIFIED = {
    "EyeLidLeft": lambda w: 0.75 - 0.75 * w["AU43L"] + 0.25 * w["AU5L"],
    "EyeLidRight": lambda w: 0.75 - 0.75 * w["AU43R"] + 0.25 * w["AU5R"],
    "BrowExpressionLeft": lambda w: max(w["AU1L"], w["AU2L"]) - w["AU4L"],
    "BrowExpressionRight": lambda w: max(w["AU1R"], w["AU2R"]) - w["AU4R"],
    **{f"Eye{side}X": lambda w: w["AU62"] - w["AU61"] for side in ("", "Left", "Right")},
    **{f"Eye{side}Y": lambda w: w["AU63"] - w["AU64"] for side in ("", "Left", "Right")},
    "MouthDimple": lambda w: (w["AU14L"] + w["AU14R"]) / 2, "MouthClosed": lambda w: max(w["AU26"] - w["AU25"], 0.0),
    "SmileFrownLeft": lambda w: w["AU12L"] - w["AU15L"], "SmileFrownRight": lambda w: w["AU12R"] - w["AU15R"],
    "MouthUpperUp": lambda w: max(w["AU10L"], w["AU10R"]), "MouthRaiserLower": lambda w: w["AU17"],
    "CheekPuffSuckLeft": lambda w: w["AU34L"], "CheekPuffSuckRight": lambda w: w["AU34R"], "CheekPuffLeft": lambda w: w["AU34L"],
    "JawOpen": lambda w: w["AU26"], "JawX": lambda w: w["AU30R"] - w["AU30L"], "JawForward": lambda w: w["AU29"],
    "MouthStretchLeft": lambda w: w["AU20"], "MouthStretchRight": lambda w: w["AU20"],
    "LipPucker": lambda w: w["AU18"], "LipFunnel": lambda w: w["AU22"],
    "LipSuckUpper": lambda w: w["AU28"], "LipSuckLower": lambda w: w["AU28"],
    "NoseSneer": lambda w: max(w["AU9L"], w["AU9R"]),
}
SIGNED = ("BrowExpressionLeft", "BrowExpressionRight", "JawX", "SmileFrownLeft",
          "SmileFrownRight", "EyeX", "EyeY", "EyeLeftX", "EyeRightX", "EyeLeftY", "EyeRightY")


def more():
    """What waits for room in a datagram: of both sides the mean, unless said otherwise."""
    both = {"MouthDimple": "AU14", "CheekPuff": "AU34", "EyeClosed": "AU43", "EyeWide": "AU5", "BrowInnerUp": "AU1",
            "BrowOuterUp": "AU2", "BrowDown": "AU4", "BrowLowerer": "AU4", "BrowPinch": "AU4", "CheekSquint": "AU6",
            "NoseSneer": "AU9", "MouthCornerPull": "AU12", "MouthSmile": "AU12", "MouthFrown": "AU15", "MouthUpperUp": "AU10"}
    mean = lambda unit: lambda w: (w[unit + "L"] + w[unit + "R"]) / 2
    alone = lambda unit: lambda w: w[unit]
    found = {}
    for name, unit in both.items():
        found |= {name + "Left": alone(unit + "L"), name + "Right": alone(unit + "R")}
        if name in ("EyeClosed", "BrowInnerUp", "BrowOuterUp", "BrowDown", "CheekSquint"):
            found[name] = mean(unit)
    lips = {"LipPucker": ("AU18", ["Left", "Right"]), "LipFunnel": ("AU22", []), "LipSuck": ("AU28", [""])}
    corners = [half + side for half in ("Upper", "Lower") for side in ("", "Left", "Right")]
    for name, (unit, further) in lips.items():
        found |= {name + corner: alone(unit) for corner in corners + further}
    found |= {"LipSuckFunnel" + corner: lambda w: w["AU28"] - w["AU22"] for corner in corners}
    for side in ("Left", "Right"):
        s = side[0]
        found |= {
            "EyeOpen" + side: lambda w, s=s: 1 - w["AU43" + s], "Jaw" + side: alone("AU30" + s),
            "BrowUp" + side: lambda w, s=s: 0.6 * w["AU2" + s] + 0.4 * w["AU1" + s],
            "MouthSad" + side: lambda w, s=s: max(w["AU15" + s], w["AU20"]),
            "SmileSad" + side: lambda w, s=s: w["AU12" + s] - max(w["AU15" + s], w["AU20"]),
        }
    for name in ("EyeOpen", "BrowUp", "SmileSad"):
        found[name] = lambda w, l=found[name + "Left"], r=found[name + "Right"]: (l(w) + r(w)) / 2
    for name in ("EyeLid", "BrowExpression", "SmileFrown"):
        found[name] = lambda w, l=UNIFIED[name + "Left"], r=UNIFIED[name + "Right"]: (l(w) + r(w)) / 2
    found |= {
        "JawZ": alone("AU29"), "MouthOpen": alone("AU25"), "MouthStretch": alone("AU20"), "CheekPuffSuck": mean("AU34"),
        "EyeWide": lambda w: max(w["AU5L"], w["AU5R"]),
    }
    return {name: value for name, value in found.items() if name not in UNIFIED}


MORE = more()
SWITCHES = ("EyeTrackingActive", "ExpressionTrackingActive", "LipTrackingActive")


def free_ports(count):
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    for one in sockets:
        one.bind(("127.0.0.1", 0))
    ports = [one.getsockname()[1] for one in sockets]
    for one in sockets:
        one.close()
    return ports


class Receiver:
    """A receiver of some presets, each at a port of its own."""

    def __init__(self, name, program, presets):
        self.name, self.ports = name, dict(zip(presets, free_ports(len(presets))))
        self.files, self.processes = [], []
        ports = [str(port) for port in self.ports.values()]
        script = os.path.join(HERE, "receive_" + name.replace("-", "_"))
        if name == "oscdump":
            for preset, port in self.ports.items():
                self.start([program, "-L", str(port)], preset)
            time.sleep(0.5)
        else:
            self.start([program, script + (".cjs" if name == "node-osc" else ".py"), *ports], None)
            deadline = time.time() + 20
            while "ready" not in open(self.files[0][0]).read():
                assert time.time() < deadline and self.processes[0].poll() is None, f"{name} does not start"
                time.sleep(0.05)

    def start(self, command, preset):
        path = tempfile.mktemp(prefix="mien-received-")
        self.files.append((path, preset))
        self.processes.append(subprocess.Popen(command, stdout=open(path, "w")))

    def stop(self):
        for process in self.processes:
            process.send_signal(signal.SIGTERM)
            process.wait()

    def messages(self):
        """Messages by preset, in order: (address, arguments)."""
        by_port = {port: preset for preset, port in self.ports.items()}
        heard = {preset: [] for preset in self.ports}
        for path, preset in self.files:
            for line in open(path):
                if preset is not None:
                    heard[preset].append(oscdump_message(line))
                elif line.startswith("["):
                    port, address, arguments = json.loads(line)
                    heard[by_port[port]].append((address, arguments))
        return heard


def oscdump_message(line):
    _, address, *rest = [quoted or bare for quoted, bare in re.findall(r'"([^"]*)"|(\S+)', line)]
    tags, words = (rest[0], rest[1:]) if rest else ("", [])
    read = {"i": int, "f": float, "s": str, "T": lambda _: True, "F": lambda _: False}
    return address, [read[tag](word) for tag, word in zip(tags, words)]


def close(found, expected, tolerance=CLOSE):
    return len(found) == len(expected) and all(
        abs(a - b) <= tolerance if isinstance(b, float) else a == b for a, b in zip(found, expected)
    )


def same(what, found, expected, tolerance=CLOSE):
    assert len(found) == len(expected), f"{what}: {len(found)} messages, expected {len(expected)}"
    for i, (one, other) in enumerate(zip(found, expected)):
        assert close(one, other, tolerance), f"{what}, message {i}: {one}, expected {other}"
    return len(found)


def check_osc(messages, rows, units, options):
    """Every message of the native schema; the number of values compared."""
    prefix, names = "/face", [options["names"].get(unit, unit) for unit in units]
    of = lambda address: [arguments for at, arguments in messages if at == prefix + address]
    frames = of("/0/frame")
    code = lambda row: session.STATES[row.state]
    confidence = lambda row: row.confidence if row.present else 0.0
    expected = [[i, row.ms, code(row), confidence(row)] for i, row in enumerate(rows)]
    expected.append([len(rows), rows[-1].ms, 0, 0.0])
    # Confidence has four decimals in the CSV.
    checked = same("frame", [frame[:4] for frame in frames], expected, 5.1e-5)
    assert all(len(frame) == 5 and 0 <= frame[4] < 60_000 for frame in frames), "latency"
    first = next(i for i, row in enumerate(rows) if row.state != "absent")
    neutral = [[0.0] * len(units)]
    shown = [[row.shown[unit] for unit in units] for row in rows[first:]] + neutral
    if options["style"] != "scalar":
        checked += same("au", of("/0/au"), shown)
    else:
        assert not of("/0/au")
    for i, name in enumerate(names):
        found = of("/0/au/" + name)
        checked += same("au/" + name, found, [[row[i]] for row in shown] if options["style"] != "vector" else [])
    checked += same("pose", of("/0/pose"), [row.pose for row in rows if row.present])
    schema = of("/schema")
    assert schema and all(words == [1, *names] for words in schema), schema
    assert len(schema) == 1 + int(rows[-1].seconds / 5.0)
    alive = [words[0] for words in of("/alive")]
    assert alive == list(range(len(alive))) and abs(len(alive) - rows[-1].seconds) <= 2, alive
    assert of("/0/present")[-1] == [0] and [1] in of("/0/present")
    if options["ranges"]:
        for name in names:
            ranges = of("/0/range/" + name)
            assert ranges and all(low <= rest <= high and 0 <= ready <= 1 for low, rest, high, ready in ranges), (name, ranges)
    return checked


def check_vmc(messages, rows, units, options):
    of = lambda address: [arguments for at, arguments in messages if at == "/VMC/Ext" + address]
    frames = len(rows) + 1
    assert len(of("/Blend/Apply")) == frames, f"{len(of('/Blend/Apply'))} Apply, expected {frames}"
    shapes = {"arkit": ARKIT, "vrm1": VRM1}[options["vmc_names"]]
    values = {}
    for name, value in of("/Blend/Val"):
        values.setdefault(name, []).append([value])
    assert set(values) == set(shapes), set(values) ^ set(shapes)
    limit = lambda value: [min(max(value, 0.0), 1.0)]
    checked = sum(
        same(name, values[name], [limit(shape(row.shown)) for row in rows] + [[0.0]]) for name, shape in shapes.items()
    )
    # Our axes, all mirrored, are Unity's: rotations keep their numbers, places change their sign.
    poses = [row.pose for row in rows if row.present]
    if options["role"] == "performer":
        checked += same("OK", of("/OK"), [[1, 3, 0, int(row.present)] for row in rows] + [[1, 3, 0, 0]])
        checked += same("T", of("/T"), [[row.seconds] for row in [*rows, rows[-1]]], 1e-5)
        bones = of("/Bone/Pos")
        heads = [bone for bone in bones if bone[0] == "Head"]
        checked += same("Bone", heads, [["Head", 0.0, 0.0, 0.0, *pose[3:]] for pose in poses])
        # Yaw, then pitch, half of 30 degrees at most: to the subject's left and up.
        halves = [[-(row.shown[a] - row.shown[b]) * math.pi / 12 for a, b in (("AU61", "AU62"), ("AU63", "AU64"))] for row in rows]
        turns = [
            [math.cos(yaw) * math.sin(pitch), math.sin(yaw) * math.cos(pitch), -math.sin(yaw) * math.sin(pitch),
             math.cos(yaw) * math.cos(pitch)] for yaw, pitch in [*halves, (0.0, 0.0)]
        ]
        for eye in ("LeftEye", "RightEye"):
            turned = [bone for bone in bones if bone[0] == eye]
            checked += same(eye, turned, [[eye, 0.0, 0.0, 0.0, *turn] for turn in turns], 1e-5)
        checked += same("Root", of("/Root/Pos"), [["root", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]] * frames)
    else:
        expected = [["Head", *(-x for x in pose[:3]), *pose[3:]] for pose in poses]
        checked += same("Tracker", of("/Tra/Pos"), expected)
    return checked


def check_vrchat(messages, rows, units, options):
    values = {}
    for address, arguments in messages:
        values.setdefault(address.removeprefix("/avatar/parameters/FT/v2/"), []).append(arguments[0])
    checked = 0
    for name in SWITCHES:
        heard = values.pop(name)
        assert heard[-1] is False and True in heard, name
    neutral = {unit: 0.0 for unit in units}
    limit = lambda value: min(max(value, -1.0), 1.0)
    for name, parameter in UNIFIED.items():
        series = [limit(parameter(row.shown)) for row in rows] + [limit(parameter(neutral))]
        if options["values"] == "float":
            checked += follow(name, values.pop(name), series)
        else:
            checked += bits(name, values, series, rows)
    for name, parameter in MORE.items():
        if options["values"] == "float":
            series = [limit(parameter(row.shown)) for row in rows] + [limit(parameter(neutral))]
            checked += follow(name, values.pop(name), series, in_time=False)
        else:
            # How long switches wait is not told by the table; at the end they are those of a neutral face.
            code = int(abs(parameter(neutral)) * 15 + 1e-4)
            for bit in range(4):
                assert values.pop(f"{name}{1 << bit}")[-1] is bool(code >> bit & 1), name
            values.pop(f"{name}Negative", None)
    assert not values, f"not expected: {list(values)}"
    return checked


def follow(name, heard, series, in_time=True):
    """Every value heard is one of the run, in order, and, if it goes out in time, nothing that changed was kept back."""
    at, last = 0, math.inf
    for value in heard:
        while abs(series[at] - value) > CLOSE:
            assert not in_time or abs(series[at] - last) < 1 / 512 + CLOSE, f"{name}: {series[at]} at {at} was not sent"
            at += 1
            assert at < len(series), f"{name}: {value} is not in the run"
        last = value
    assert abs(series[-1] - heard[-1]) <= CLOSE, f"{name} ends at {heard[-1]}, expected {series[-1]}"
    return len(heard)


def bits(name, values, series, rows, count=4):
    """The switches of a parameter: on change, and all once a second and at the end."""
    most = 2**count - 1
    signed = name in SIGNED
    wholes = [min(abs(value) if signed else max(value, 0.0), 1.0) * most for value in series]
    # Six decimals do not tell on which side of a step a value was.
    doubtful = any(whole > 0.5 and abs(whole - round(whole)) < 1e-4 and whole < most for whole in wholes)
    codes = [int(whole + 1e-4) | (value < 0 and int(whole + 1e-4) > 0) << count for whole, value in zip(wholes, series)]
    names = [f"{name}{1 << bit}" for bit in range(count)] + ([f"{name}Negative"] if signed else [])
    checked = 0
    for bit, switch in enumerate(names):
        heard = values.pop(switch)
        expected, last, refreshed = [], None, None
        for code, row in zip(codes, [*rows, None]):
            on = bool(code >> bit & 1)
            refresh = row is None or refreshed is None or row.seconds - refreshed >= 1.0 - 1e-9
            if refresh and row is not None:
                refreshed = row.seconds
            if refresh or on != last:
                expected.append(on)
            last = on
        if not doubtful:
            assert heard == expected, f"{switch}: {len(heard)} heard, {len(expected)} expected"
            checked += len(heard)
        assert heard[-1] is expected[-1]
    return checked


def check_faceosc(messages, rows, units, options):
    of = lambda address: [arguments for at, arguments in messages if at == address]
    # A lost face is held for a moment, with the numbers it had.
    shown, last = [], None
    for row in rows:
        if row.present:
            last = row
        elif last and row.seconds - last.seconds > session.HOLD_S + 1e-9:
            last = None
        if last:
            shown.append(last)
    mirrored = lambda x: 639 - x if options["mirror"] else x
    mean = lambda axis, row: sum(pixel[axis] for pixel in row.pixels) / 68
    position = [[mirrored(mean(0, row)), mean(1, row)] for row in shown]
    checked = same("position", of("/pose/position"), position, 2e-3)
    width = [[row.measure("mouth_width") * row.measure("eye_distance") / session.UNIT_FACEOSC_M] for row in shown]
    checked += same("mouth/width", of("/gesture/mouth/width"), width, 1e-3)
    checked += same("orientation", of("/pose/orientation"), [angles(row.pose) for row in shown], 1e-5)
    for gesture in ("mouth/height", "eyebrow/left", "eyebrow/right", "eye/left", "eye/right", "jaw", "nostrils"):
        numbers = of("/gesture/" + gesture)
        assert len(numbers) == len(shown) and all(0 < number < 60 for (number,) in numbers), gesture
        checked += len(numbers)
    found = of("/found")
    assert found[-1] == [0] and [1] in found
    return checked


def angles(pose):
    """Pitch, yaw, roll of Ry(yaw) Rx(pitch) Rz(roll)."""
    x, y, z, w = pose[3:]
    yaw = math.atan2(2 * (x * z + w * y), 1 - 2 * (x * x + y * y))
    pitch = math.asin(max(-1, min(1, -2 * (y * z - w * x))))
    return [pitch, yaw, math.atan2(2 * (x * y + w * z), 1 - 2 * (x * x + z * z))]


CHECKS = {"osc": check_osc, "vmc": check_vmc, "vrchat": check_vrchat, "faceosc": check_faceosc}

RUNS = [
    (
        "all presets as they come",
        ["--source", "simulated", "--frames", "200"],
        {"style": "both", "mirror": False, "ranges": True, "role": "performer", "vmc_names": "arkit", "values": "float",
         "names": {}, "gains": {}},
    ),
    (
        "mirrored, with names, gains, switches, VRM 1, and a face that leaves",
        ["--source", "simulated:leaving", "--frames", "400", "--fast"],
        {"style": "scalar", "mirror": True, "ranges": False, "role": "assistant", "vmc_names": "vrm1", "values": "binary",
         "names": {"AU26": "jaw"}, "gains": {"AU26": 1.5, "AU2L": 0.5}},
    ),
]


def configuration(options, targets):
    words = lambda value: json.dumps(value).lower() if isinstance(value, bool) else json.dumps(value)
    lines = ["[learning]", 'scale = "frame"', "[units]"]
    for unit in {**options["names"], **options["gains"]}:
        name, gain = options["names"].get(unit, unit), options["gains"].get(unit, 1.0)
        lines.append(f"{unit} = {{ name = {words(name)}, gain = {gain} }}")
    for preset in PRESETS:
        lines += [f"[{preset}]", f"enabled = {words(bool(targets[preset]))}", f"mirror = {words(options['mirror'])}"]
        if targets[preset]:
            lines.append(f"target = {words(targets[preset])}")
        lines += {
            "osc": [f"style = {words(options['style'])}", f"ranges = {words(options['ranges'])}"],
            "vmc": [f"role = {words(options['role'])}", f"names = {words(options['vmc_names'])}"],
            "vrchat": [f"values = {words(options['values'])}"],
            "faceosc": [],
        }[preset]
    return "\n".join(lines) + "\n"


def main():
    mien, programs = sys.argv[1], dict(word.split("=", 1) for word in sys.argv[2:])
    for title, arguments, options in RUNS:
        print(f"-- {title}")
        receivers = [
            Receiver(name, program, ["vmc"] if name == "vmcp" else PRESETS) for name, program in programs.items()
        ]
        # Among the targets is one where nobody is, and one whose name is not found.
        targets = {
            preset: ["240.0.0.1:9", "nobody.invalid:9"]
            + [f"127.0.0.1:{receiver.ports[preset]}" for receiver in receivers if preset in receiver.ports]
            for preset in PRESETS
        }
        try:
            path, log, status = session.run(mien, configuration(options, targets), arguments)
            time.sleep(1.0)
        finally:
            for receiver in receivers:
                receiver.stop()
        rows, units = session.read(path, options["mirror"], options["gains"])
        present = sum(row.present for row in rows)
        latency = status["latency_ms"]
        print(f"   {len(rows)} frames, {present} with a face; latency {latency['median']} ms, 99 % {latency['p99']} ms")
        assert present > len(rows) / 3 and 0 < latency["median"] <= latency["p99"]
        for receiver in receivers:
            for preset, messages in receiver.messages().items():
                checked = CHECKS[preset](messages, rows, units, options)
                print(f"   {receiver.name}: {preset}, {len(messages)} messages, {checked} compared")
    check_commands(mien)


def osc_message(address, *numbers):
    """A message of whole numbers, by the letter of OSC 1.0."""
    pad = lambda text: text.encode() + b"\0" * (4 - len(text) % 4)
    return pad(address) + pad("," + "i" * len(numbers)) + b"".join(struct.pack(">i", number) for number in numbers)


def check_commands(mien):
    """A run that is asked, by commands good and bad, to forget the face, stop learning and tell the schema."""
    (port,) = free_ports(1)
    ears = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    ears.bind(("127.0.0.1", 0))
    ears.settimeout(60)
    frames, schemas, asked_at = [], [], []

    def between(process):
        # Until nobody is there any more; nobody is before the first pose is found, either.
        while not asked_at or frames[-1][2] != 0:
            datagram = ears.recv(2048)
            if b"/face/schema" in datagram:
                schemas.append(len(frames))
            at = datagram.find(b"/face/0/frame")
            if at < 0:
                continue
            frames.append(struct.unpack(">iii", datagram[at + 24 : at + 36]))
            if frames[-1][2] == session.STATES["tracking"] and not asked_at:
                asked_at.append(len(frames))
                for bad in (b"nonsense", osc_message("/face/cmd/forget"), osc_message("/face/cmd/fly", 0)):
                    ears.sendto(bad, ("127.0.0.1", port))
                for words in (("forget", 0), ("freeze", 0, 1), ("schema",)):
                    ears.sendto(osc_message("/face/cmd/" + words[0], *words[1:]), ("127.0.0.1", port))

    configuration = f"""[osc]\ntarget = "127.0.0.1:{ears.getsockname()[1]}"\nstyle = "vector"\n
commands = true\nlisten = "127.0.0.1:{port}"\n"""
    arguments = ["--source", "simulated", "--frames", "220", "--fast"]
    path, log, status = session.run(mien, configuration, arguments, between)
    (at,) = asked_at
    states = [state for _, _, state in frames]
    tracking, warming = session.STATES["tracking"], session.STATES["warming"]
    assert states[at - 1] == tracking and states[at + 2 : at + 32] == [warming] * 30, "the face is not forgotten"
    assert any(at <= heard <= at + 2 for heard in schemas), schemas
    (output,) = [output for output in status["outputs"] if output["name"] == "osc"]
    assert (output["commands"], output["commands_refused"]) == (3, 3), output
    assert status["users"][0]["frozen"] is True
    print(f"-- commands: forgotten, frozen and told at frame {at}; 3 taken, 3 refused")


if __name__ == "__main__":
    main()
