"""Drives the shape keys of a head in Blender from mien, over OSC (at 127.0.0.1:9140).

In Blender: File > Import > glTF, a head that `mien-studio bake` or `mien-studio head` wrote; open this file in the Scripting tab
and press Run; run `mien run` with `target = "127.0.0.1:9140"` in its section [osc]. Run it again to stop. The head turns with the pose, too.

Without the window, to see that it works:
    pip install bpy==5.0.1 && python blender_shape_keys.py head.glb SECONDS [PORT]
prints how far each shape key went. Any number of heads may be in the scene; all follow user 0.
"""
import ast
import socket
import struct
import sys
import time

import bpy
import mathutils

ADDRESS = ("127.0.0.1", 9140)
PERIOD_S = 1 / 60


def messages(data):
    """Address and arguments of every message of a datagram; what is damaged is left out."""
    if data.startswith(b"#bundle\0"):
        at = 16
        while at + 4 <= len(data):
            (size,) = struct.unpack_from(">i", data, at)
            if size <= 0:
                return
            yield from messages(data[at + 4:at + 4 + size])
            at += 4 + size
        return

    def text(at):
        end = data.index(b"\0", at)
        return data[at:end].decode("ascii"), end // 4 * 4 + 4

    try:
        address, at = text(0)
        tags, at = text(at)
        values = []
        for tag in tags[1:]:
            if tag in "if":
                (value,) = struct.unpack_from(">" + tag, data, at)
                values.append(value)
                at += 4
            elif tag == "s":
                value, at = text(at)
                values.append(value)
            else:
                return
    except (ValueError, struct.error):
        return
    yield address, values


def heads():
    """Objects with shape keys, and for each key the units of which the largest drives it: those the baker wrote, and its name."""
    for thing in bpy.data.objects:
        keys = thing.data.shape_keys if thing.type == "MESH" else None
        if not keys:
            continue
        names = [key.name for key in keys.key_blocks][1:]
        written = thing.data.get("mien")
        # The importer keeps what has no Blender type as the text of a Python value.
        if isinstance(written, str):
            written = ast.literal_eval(written)
        units = list(written["units"]) if written else []
        units += [None] * (len(names) - len(units))
        yield thing, [(name, [*(unit or name).split("|"), name]) for name, unit in zip(names, units)]


class Receiver:
    def __init__(self, address=ADDRESS):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(address)
        self.socket.setblocking(False)
        self.weights = {}
        self.pose = None

    def step(self):
        """Takes all that has come and sets the keys; Blender calls it again after the seconds it returns."""
        while True:
            try:
                data = self.socket.recv(65536)
            except BlockingIOError:
                break
            for address, values in messages(data):
                words = address.split("/")[1:]
                if words[1:3] == ["0", "au"] and len(words) == 4 and len(values) == 1:
                    self.weights[words[3]] = values[0]
                elif words[1:] == ["0", "pose"] and len(values) == 7:
                    self.pose = values
        for thing, driven in heads():
            blocks = thing.data.shape_keys.key_blocks
            for name, units in driven:
                sent = [self.weights[unit] for unit in units if unit in self.weights]
                if sent:
                    blocks[name].value = max(sent)
            if self.pose:
                # The sensor's x right, y down, z away are Blender's x, -z, y.
                x, y, z, w = self.pose[3:]
                thing.rotation_mode = "QUATERNION"
                thing.rotation_quaternion = mathutils.Quaternion((w, x, z, -y))
        return PERIOD_S

    def close(self):
        self.socket.close()


def main():
    running = bpy.app.driver_namespace.pop("mien", None)
    if running:
        bpy.app.timers.unregister(running.step)
        running.close()
        print("mien: stopped")
        return
    receiver = Receiver()
    bpy.app.driver_namespace["mien"] = receiver
    bpy.app.timers.register(receiver.step)
    print("mien: receiving at %s:%d" % ADDRESS)


def without_window(path, seconds, port):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=path)
    receiver = Receiver((ADDRESS[0], port))
    reached = {}
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        receiver.step()
        for thing, driven in heads():
            for name, _ in driven:
                value = thing.data.shape_keys.key_blocks[name].value
                reached[name] = max(reached.get(name, 0.0), value)
        time.sleep(PERIOD_S)
    for name, value in sorted(reached.items()):
        print(f"{name} {value:.3f}")


if __name__ == "__main__":
    if bpy.app.background and len(sys.argv) >= 3 and sys.argv[1].endswith(".glb"):
        without_window(sys.argv[1], float(sys.argv[2]), int(sys.argv[3]) if len(sys.argv) > 3 else ADDRESS[1])
    else:
        main()
