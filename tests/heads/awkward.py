"""Heads as strangers bring them, made from the CC0 heads and ICT FaceKit's: cut, turned, coarser, finer, dressed.

    python tests/heads/awkward.py OUT [DATA]    (DATA: ../shared/data; needs numpy)

Writes OUT/HEAD-WHAT.obj (split, glasses: .glb; nodes: .gltf), metres, y up and face towards +z unless WHAT says otherwise, and beside it what
must not bend: OUT/HEAD-WHAT.rigid.json. What is made of a head is the same for every head; only its unit is known.
"""
import base64
import json
import struct
import sys
from pathlib import Path

import numpy as np

# File, metres per unit, and a shape that opens the lips where there is one.
HEADS = {
    "vitruvian": ("head_vitruvian/head.obj", 1.0, "head_vitruvian/shapes/jawOpen.f32"),
    "ict": ("ict_facekit/generic_neutral_mesh.obj", 0.01, "ict_facekit/expr/jawOpen.f32"),
    "old-woman": ("heads_makehuman/african-female-old.obj", 1.0, None),
    "young-man": ("heads_makehuman/african-male-young.obj", 1.0, None),
    "young-woman": ("heads_makehuman/caucasian-female-young.obj", 1.0, None),
}


def read(path, metres):
    places, faces = [], []
    for line in open(path, encoding="utf-8", errors="replace"):
        words = line.split()
        if words[:1] == ["v"]:
            places.append([float(w) for w in words[1:4]])
        elif words[:1] == ["f"]:
            faces.append([int(w.split("/")[0]) - 1 for w in words[1:]])
    return np.array(places) * metres, faces


def write(path, places, faces):
    with open(path, "w", encoding="ascii") as out:
        out.writelines(f"v {x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in places)
        out.writelines("f " + " ".join(str(v + 1) for v in face) + "\n" for face in faces)


def kept(places, faces, keep):
    """The faces all of whose vertices are kept, and those vertices only."""
    faces = [f for f in faces if all(keep[v] for v in f)]
    used = np.unique(np.concatenate([np.array(f) for f in faces]))
    number = np.full(len(places), -1)
    number[used] = np.arange(len(used))
    return places[used], [[int(number[v]) for v in f] for f in faces]


def parts(count, faces):
    """A number per vertex, the same for all that hang together."""
    label = np.arange(count)
    edges = np.array([(a, b) for f in faces for a, b in zip(f, f[1:] + f[:1])])
    while True:
        low = label.copy()
        np.minimum.at(low, edges[:, 0], label[edges[:, 1]])
        np.minimum.at(low, edges[:, 1], label[edges[:, 0]])
        low = low[low]
        if (low == label).all():
            return label
        label = low


def triangles(faces):
    return [[f[0], f[k - 1], f[k]] for f in faces for k in range(2, len(f))]


def decimated(places, faces, wanted=2000):
    """Vertices of one part in one cell become one; the cell grows until few enough are left."""
    part, cell = parts(len(places), faces), 0.002
    while True:
        key = np.column_stack([part, np.round(places / cell).astype(int)])
        _, number = np.unique(key, axis=0, return_inverse=True)
        number = number.ravel()
        if number.max() < wanted:
            break
        cell *= 1.1
    mean = np.column_stack([np.bincount(number, places[:, k]) / np.bincount(number) for k in range(3)])
    short = [[int(number[v]) for v in t] for t in triangles(faces)]
    seen = {tuple(sorted(t)): t for t in short if len(set(t)) == 3}
    return mean, list(seen.values())


def subdivided(places, faces, wanted=100_000):
    while len(places) < wanted:
        middle, more, cut = {}, list(places), []

        def between(a, b):
            key = (min(a, b), max(a, b))
            if key not in middle:
                middle[key] = len(more)
                more.append((places[a] + places[b]) / 2)
            return middle[key]

        for f in faces:
            edge = [between(a, b) for a, b in zip(f, f[1:] + f[:1])]
            if len(f) == 3:
                cut += [[f[k], edge[k], edge[k - 1]] for k in range(3)] + [edge]
            else:
                more.append(np.mean([places[v] for v in f], axis=0))
                cut += [[f[k], edge[k], len(more) - 1, edge[k - 1]] for k in range(len(f))]
        places, faces = np.array(more), cut
    return places, faces


def glb(path, places, faces):
    """Triangles as binary glTF; its rows are sewn by whoever reads them."""
    points, order = places.astype("<f4"), np.array(faces, "<u4")
    data = points.tobytes() + order.tobytes()
    rows = {"componentType": 5126, "type": "VEC3", "count": len(points), "min": points.min(0).tolist(), "max": points.max(0).tolist()}
    text = json.dumps({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}], "buffers": [{"byteLength": len(data)}],
        "accessors": [{"bufferView": 0, **rows}, {"bufferView": 1, "componentType": 5125, "type": "SCALAR", "count": order.size}],
        "bufferViews": [{"buffer": 0, "byteLength": points.nbytes}, {"buffer": 0, "byteOffset": points.nbytes, "byteLength": order.nbytes}],
    }).encode()
    text += b" " * (-len(text) % 4)
    with open(path, "wb") as out:
        out.write(struct.pack("<5I", 0x46546C67, 2, 28 + len(text) + len(data), len(text), 0x4E4F534A) + text)
        out.write(struct.pack("<2I", len(data), 0x004E4942) + data)


def gltf(path, *meshes):
    """glTF as text, lying on its back in centimetres and set upright by nodes; each mesh about its own middle and with a buffer of
    its own, the first in a file beside, the others in the text."""
    out = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "meshes": [], "buffers": [], "bufferViews": [], "accessors": [],
           "nodes": [{"rotation": [-(0.5**0.5), 0, 0, 0.5**0.5], "children": [1]},
                     {"matrix": [0.01, 0, 0, 0, 0, 0.01, 0, 0, 0, 0, 0.01, 0, 0, 0, 0, 1], "children": []}]}
    for k, (places, faces) in enumerate(meshes):
        lying = places[:, [0, 2, 1]] * [100, -100, 100]
        points, order = (lying - lying.mean(0)).astype("<f4"), np.array(triangles(faces), "<u4")
        data = points.tobytes() + order.tobytes()
        uri = path.stem + " 1.bin"
        if k == 0:
            path.with_name(uri).write_bytes(data)
        out["buffers"].append({"byteLength": len(data), "uri": "data:application/octet-stream;base64," + base64.b64encode(data).decode() if k else uri.replace(" ", "%20")})
        out["bufferViews"] += [{"buffer": k, "byteLength": points.nbytes}, {"buffer": k, "byteOffset": points.nbytes, "byteLength": order.nbytes}]
        out["accessors"] += [{"bufferView": 2 * k, "componentType": 5126, "type": "VEC3", "count": len(points), "min": points.min(0).tolist(), "max": points.max(0).tolist()},
                             {"bufferView": 2 * k + 1, "componentType": 5125, "type": "SCALAR", "count": order.size}]
        out["meshes"].append({"primitives": [{"attributes": {"POSITION": 2 * k}, "indices": 2 * k + 1}]})
        out["nodes"][1]["children"].append(2 + k)
        out["nodes"].append({"mesh": k, "translation": lying.mean(0).tolist()})
    path.write_text(json.dumps(out))


def seams_split(places, faces):
    """Two charts of texture, left and right, as glTF stores them: vertices of the middle twice."""
    more, twin, out = list(places), {}, []
    for f in triangles(faces):
        left = np.mean(places[f], axis=0)[0] > 0
        for v in f if left else []:
            if v not in twin and abs(places[v][0]) < 0.004:
                twin[v] = len(more)
                more.append(places[v])
        out.append([twin.get(v, v) if left else v for v in f])
    return kept(np.array(more), out, [True] * len(more))


def joined(*meshes):
    places, faces = [], []
    for p, f in meshes:
        at = sum(len(q) for q in places)
        places.append(p)
        faces += [[v + at for v in face] for face in f]
    return np.vstack(places), faces


def lattice(rows):
    """Closed rings of places, each joined to the next."""
    n = len(rows[0])
    cell = lambda r, k: [r * n + k, r * n + (k + 1) % n, (r + 1) * n + (k + 1) % n, (r + 1) * n + k]
    return np.vstack(rows), [cell(r, k) for r in range(len(rows) - 1) for k in range(n)]


def ring(middle, across, along, n=48):
    t = np.linspace(0, 2 * np.pi, n, endpoint=False)[:, None]
    return np.array(middle) + np.cos(t) * np.array(across) + np.sin(t) * np.array(along)


def dome(middle, size, lowest, n, rows):
    """The upper part of an ellipsoid: a cap, hair."""
    up = np.radians(np.linspace(lowest, 89, rows))
    return lattice([ring(middle + [0, size[1] * np.sin(a), 0], [size[0] * np.cos(a), 0, 0], [0, 0, -size[2] * np.cos(a)], n)
                    for a in up])


def tube(along, radius, n=8):
    """A thin bar through some places, closed in section."""
    along = np.array(along, float)
    ends = np.gradient(along, axis=0)
    across = np.cross(ends, [0.3, 1, 0.2])
    across *= radius / np.linalg.norm(across, axis=1)[:, None]
    third = np.cross(ends / np.linalg.norm(ends, axis=1)[:, None], across)
    return lattice([ring(p, a, b, n) for p, a, b in zip(along, across, third)])


def glasses(places, eyes):
    """Rims with lenses, a bridge, temples back to the ears and pads that rest on the nose; all parts of their own."""
    made, nose = [], places[abs(places[:, 0]) < 0.004]
    front = max(eyes[0][2] + 0.026, nose[abs(nose[:, 1] - eyes[0][1]) < 0.004][:, 2].max() + 0.003)
    for eye in eyes:
        at, side = np.array([eye[0], eye[1] - 0.005, front]), np.sign(eye[0])
        made.append(lattice([ring(at + [0, 0, z], [r, 0, 0], [0, 0.8 * r, 0]) for r, z in [(0.025, 0), (0.025, 0.003), (0.028, 0.003), (0.028, 0)]]))
        made.append(lattice([ring(at + [0, 0, 0.0015], [r, 0, 0], [0, 0.8 * r, 0]) for r in (0.025, 0.018, 0.01, 0.001)]))
        wide = max(abs(eye[0]) + 0.032, abs(places[(abs(places[:, 1] - at[1]) < 0.01) & (places[:, 2] > front - 0.09), 0]).max() + 0.002)
        made.append(tube([[side * (abs(eye[0]) + 0.027), at[1], front], *([side * wide, at[1], front - 0.012 * k] for k in range(1, 9))], 0.0015))
        wing = places[(abs(places[:, 0] - side * 0.009) < 0.003) & (abs(places[:, 1] - at[1] + 0.006) < 0.004)]
        pad = np.array([side * 0.010, at[1] - 0.006, wing[:, 2].max() + 0.0015])
        made.append(lattice([ring(pad + [side * x, 0, 0], [0, r, 0], [0, 0, 0.6 * r], 8) for x, r in [(-0.001, 0.001), (-0.001, 0.005), (0.001, 0.005), (0.001, 0.001)]]))
        made.append(tube([pad, pad + [side * 0.002, 0.002, 0.002], at - [side * 0.0252, 0, 0]], 0.0006))
    inner = [e + [-np.sign(e[0]) * 0.0265, 0, 0] for e in eyes]
    made.append(tube([[e[0], eyes[0][1], front + 0.001 * (k == 1)] for k, e in enumerate([inner[0], np.mean(inner, 0), inner[1]])], 0.0015))
    return joined(*made)


def dressed(places, eyes):
    """A cap with a peak, hair of more vertices than the skin, rings at the ears, glasses: none may bend."""
    low, high = places.min(0), places.max(0)
    skull = places[places[:, 1] > eyes[:, 1].mean() + 0.02]
    middle, half = (skull.min(0) + skull.max(0)) / 2, (skull.max(0) - skull.min(0)) / 2
    middle[1] = eyes[0][1] + 0.045
    tall = high[1] - middle[1] + 0.012
    cap = dome(middle, [half[0] + 0.008, tall, half[2] + 0.008], 0, 48, 16)
    front = middle + [0, 0.005, half[2]]
    peak = lattice([ring(front + [0, -0.004 * k, 0.0], [0.075 - 0.004 * k, 0, 0], [0, -0.012, 0.06 + 0.003 * k]) for k in range(3)])
    back = middle - [0, 0.04, 0.03]
    hair = dome(back, [half[0] + 0.012, tall + 0.03, half[2]], -50, 200, 110)
    beside = places[abs(places[:, 1] - eyes[0][1]) < 0.03]
    ears = [beside[(s * beside[:, 0]).argmax()] for s in (-1, 1)]
    rings = [lattice([ring(e + [0, -0.02, 0] + 0.002 * np.array([np.cos(t), 0, 0]), [0, 0.008 + 0.002 * np.sin(t), 0], [0, 0, 0.008 + 0.002 * np.sin(t)], 16)
                      for t in np.linspace(0, 2 * np.pi, 7)]) for e in ears]
    return {"cap": joined(cap, peak), "hair": hair, "rings": joined(*rings), "glasses": glasses(places, eyes)}


def with_shoulders(places, faces):
    """Below the neck, cut level, a bust: the neck widens to shoulders that stick out further to the front than a nose-less profile."""
    low, high = places.min(0), places.max(0)
    part = parts(len(places), faces)
    skin = part == np.bincount(part).argmax()
    at = low[1] + 0.02 * (high[1] - low[1])
    near = places[skin & (places[:, 1] < at + 0.02)]
    middle, half = (near.min(0) + near.max(0)) / 2, (near.max(0) - near.min(0)) / 2
    profile = [(0.0, 0.0), (0.03, 0.05), (0.06, 0.25), (0.08, 0.6), (0.10, 0.85), (0.14, 1.0), (0.32, 0.95)]
    rows = [ring([middle[0], at - down, middle[2]], [half[0] + t * (0.21 - half[0]), 0, 0], [0, 0, -(half[2] + t * max(0.12 - half[2], 0.03))], 96)
            for down, t in profile]
    return joined((places, faces), lattice(rows))


def main(out, data):
    out.mkdir(parents=True, exist_ok=True)
    for name, (path, metres, jaw) in HEADS.items():
        p, f = read(data / path, metres)
        part = parts(len(p), f)
        label, size = np.unique(part, return_counts=True)
        skin = part == label[size.argmax()]
        boxes = {k: (p[part == k].min(0), p[part == k].max(0)) for k in label if k != label[size.argmax()]}
        # Eyeballs: the two roundest parts of their size beside the middle.
        balls = [k for k, (a, b) in boxes.items() if (b - a).min() > 0.7 * (b - a).max() and 0.018 < (b - a).max() < 0.04]
        eyes = np.array([p[np.isin(part, [k for k in balls if np.sign(p[part == k][0][0]) == s])].mean(0) for s in (-1, 1)])
        below, worn = eyes[0][1] - 0.065, dressed(p, eyes)
        made = {
            "triangulated": (p, triangles(f)),
            "coarse": decimated(p, f),
            "fine": subdivided(p, f),
            "split": seams_split(p, f),
            "mirrored": (p * [-1, 1, 1], [face[::-1] for face in f]),
            "z-up": (p[:, [0, 2, 1]] * [1, -1, 1], f),
            "to-minus-x": (p[:, [2, 1, 0]] * [-1, 1, 1], f),
            "centimetres": (p * 100, f),
            "decimetres": (p * 10, f),
            "reversed": (p, [face[::-1] for face in f]),
            "skin-reversed": (p, [face[::-1] if skin[face[0]] else face for face in f]),
            "dressed": joined((p, f), *worn.values()),
            "glasses": joined(seams_split(p, f), worn["glasses"]),
            "no-eyeballs": kept(p, f, ~np.isin(part, balls)),
            "neck-high": kept(p, f, p[:, 1] > below - 0.075),
            "shoulders": with_shoulders(p, f),
        }
        if jaw:
            d = np.fromfile(data / jaw, "<f4").reshape(-1, 3) * metres
            made["lips-open"] = (p + d * (0.002 / np.linalg.norm(d, axis=1).max()) * 2, f)
        # Behind the lips: skin that other skin hides, 8 to 60 mm behind it.
        cell = np.round(p[:, :2] / 0.004).astype(int)
        front = {}
        for key, z in zip(map(tuple, cell[skin]), p[skin][:, 2]):
            front[key] = max(front.get(key, -9), z)
        deep = np.array([front.get(tuple(c), -9) for c in cell]) - p[:, 2]
        mouth = (abs(p[:, 0]) < 0.03) & (abs(p[:, 1] - below) < 0.035) & (deep > 0.008) & (deep < 0.06)
        made["no-cavity"] = kept(p, f, ~mouth)
        gltf(out / f"{name}-nodes.gltf", kept(p, f, skin), kept(p, f, ~skin), worn["glasses"])
        (out / f"{name}-nodes.rigid.json").write_text(json.dumps({"glasses": len(worn["glasses"][0])}))
        for what, (places, faces) in made.items():
            rigid = {"dressed": worn, "glasses": {"glasses": worn["glasses"]}}.get(what, {})
            if rigid:
                # Counted from the end: what is read may have fewer vertices before them.
                sizes = {k: len(q) for k, (q, _) in rigid.items()}
                (out / f"{name}-{what}.rigid.json").write_text(json.dumps(sizes))
            if what in ("split", "glasses"):
                glb(out / f"{name}-{what}.glb", places, triangles(faces))
            else:
                write(out / f"{name}-{what}.obj", places, faces)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2] if len(sys.argv) > 2 else "../shared/data"))
