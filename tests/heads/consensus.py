"""What two artists share, as rows of the recipe: `move` of config/blendshapes.toml from sculpted shapes.

python consensus.py RECIPE DATA VITRUVIAN_LANDMARKS OUT [--teachers ict,vitruvian] [--hand 1]   (numpy and scipy)
VITRUVIAN_LANDMARKS is what `bake --landmarks auto` wrote for that head (target/heads/vitruvian/aoi/h.landmarks.txt).

For every shape that a teacher sculpted, the displacements of the 78 control points in the face's frame, of both sides where
there are both, are made as long as a unit together; so are the rows that RECIPE has. Their weighted mean (1 a teacher, --hand the
rows) keeps what they share and shortens what they do not; it is then made as long together as they are in the mean, but no point
goes further than in one of them. Shapes of both sides are made symmetric. Points that move less than 0.006 eye distances stay.
Lids that a shape closes stay
as they are, and so do shapes that move the jaw, blink, or undo another one: these are not rows of points.
To judge a head, give only the other teacher: RECIPE must then be one made without it too.
"""
import argparse
import pathlib
import re
import tomllib

import numpy as np

import judge

SIDE = re.compile(r"_(L|R)(?=$|_|\d)")
BOTH = re.compile(r"_S(?=$|_|\d)")
STILL = 0.006
NAMES = re.findall(r'^    "(\w+)",$', (pathlib.Path(__file__).parents[2] / "src/studio/bake/names.rs").read_text(), re.M)
OTHER = {"L": "R", "R": "L"}
MIRROR = [NAMES.index(SIDE.sub(lambda m: "_" + OTHER[m[1]], name, count=1)) for name in NAMES]
OUTWARDS = np.array([-1.0 if (m := SIDE.search(name)) and m[1] == "R" else 1.0 for name in NAMES])


class Teacher:
    """Sculpted shapes at the control points of one head, eye distances in the face's frame."""

    def __init__(self, p, faces, landmarks, shapes):
        head = judge.Head(p, faces, landmarks)
        points = [*head.landmarks, *derived(head)]
        self.shapes = {name: d[points] @ head.axes / head.w for name, d in shapes.items()}
        at = p[landmarks]
        gaps = [np.linalg.norm(at[a] - at[b]) for a, b in [(43, 47), (44, 46), (38, 40), (37, 41)]]
        self.opening = np.mean(gaps) / head.w
        self.x = (p[points] @ head.axes)[:, 0] - at[27] @ head.axes[:, 0]
        # A shape of both sides at once is one of each, cut in the middle.
        for name in [name for name in self.shapes if "+" in name]:
            for part in name.split("+"):
                here = self.x >= 0 if part.endswith("Left") else self.x <= 0
                self.shapes[part] = self.shapes[name] * here[:, None]

    def rows(self, name):
        """Mean of the shape and the mirror image of its other side; None if it is not there."""
        if name == "browInnerUp" and name not in self.shapes:
            left = self.rows("browInnerUpLeft")
            return None if left is None else left + flipped(left)
        found = [self.shapes[name]] if name in self.shapes else []
        other = name.replace("Left", "Right")
        found += [flipped(self.shapes[other])] if other in self.shapes and ("Left" in name) != (name == "mouthLeft") else []
        return np.mean(found, axis=0) if found else None


def flipped(rows):
    return (rows * [-1, 1, 1])[MIRROR]


def derived(head):
    """The ten points on cheeks and forehead."""
    p, up, out = head.p[head.landmarks], head.axes[:, 1], head.axes[:, 2]
    t, normal = head.triangles, np.zeros_like(head.p)
    for k in range(3):
        np.add.at(normal, t[:, k], np.cross(head.p[t[:, 1]] - head.p[t[:, 0]], head.p[t[:, 2]] - head.p[t[:, 0]]))
    some = head.skin & (judge.unit(normal) @ out > 0.1)
    some[head.landmarks] = False
    some = np.flatnonzero(some)
    for side in (range(68), MIRROR):
        at = [p[side[k]] for k in range(68)]
        aims = [(at[47] + at[35]) / 2, (at[46] + at[54] + at[14]) / 3, (at[54] + at[11]) / 2]
        for aim in [*aims, at[24] + up * 0.5 * head.w, at[23] + up * 1.1 * head.w]:
            far = head.p[some] - aim
            yield some[np.argmin((far**2).sum(1) - 0.9 * (far @ out) ** 2)]


def points(words):
    spelled = (BOTH.sub("_" + s, word) for word in words.split() for s in ("LR" if BOTH.search(word) else "L"))
    return [NAMES.index(name) for name in spelled]


def by_hand(entry):
    """The entry's rows (left, up, forwards); NaN where a derived point is free."""
    rows = np.zeros((78, 3))
    rows[68:] = np.nan
    for words, *way in entry.get("move", []):
        for k in points(words):
            rows[k] = np.nan_to_num(rows[k]) + np.array(way) * [OUTWARDS[k], 1, 1]
    return rows


def written(rows):
    """TOML of rows, points that move alike in one."""
    alike = {}
    for k, row in enumerate(rows):
        way = tuple(np.round(row * [OUTWARDS[k], 1, 1], 2) + 0.0)
        if k >= 68 or way != (0, 0, 0):
            alike.setdefault(way, []).append(NAMES[k])
    lines = []
    for way, names in alike.items():
        paired = [SIDE.sub("_S", n, count=1) if NAMES[MIRROR[NAMES.index(n)]] in names and SIDE.search(n) else n for n in names]
        lines.append('  ["%s", %.2f, %.2f, %.2f],\n' % (" ".join(dict.fromkeys(paired)), *way))
    return "move = [\n" + "".join(lines) + "]"


def consensus(entry, teachers, hand):
    taught = [rows for teacher in teachers if (rows := teacher.rows(entry["name"])) is not None]
    if not taught or entry.keys() & {"jaw", "undo", "tongue"} or any(close[1] == 1.0 for close in entry.get("close", [])):
        return None
    unit = np.mean([t.opening for t in teachers]) if entry.get("in") == "eye_opening" else 1.0
    ours = by_hand(entry) * unit
    free = np.isnan(ours[:, 0])
    ours = np.nan_to_num(ours)
    open_ones = np.full(78, True)
    if "close" in entry:
        open_ones[42:48] = False
    length = lambda rows: np.linalg.norm(rows[open_ones])
    sources = [(1.0, rows) for rows in taught] + [(hand, ours)]
    weight = len(taught) + np.where(free, 0.0, hand)
    mean = sum(w * rows / length(rows) for w, rows in sources) / weight[:, None]
    mean *= sum(w * length(rows) for w, rows in sources) / (len(taught) + hand) / length(mean)
    # No point goes further than somebody has it go.
    most = np.max([np.linalg.norm(rows, axis=1) for _, rows in sources], axis=0)
    mean *= np.minimum(1, most / np.maximum(np.linalg.norm(mean, axis=1), 1e-9))[:, None]
    if "mirror" not in entry:
        mean = (mean + flipped(mean)) / 2
    mean[np.linalg.norm(mean, axis=1) < STILL] = 0
    mean[~open_ones] = ours[~open_ones]
    return written(mean / unit)


def main():
    ask = argparse.ArgumentParser()
    for name in ("recipe", "data", "landmarks", "out"):
        ask.add_argument(name, type=pathlib.Path)
    ask.add_argument("--teachers", default="ict,vitruvian")
    ask.add_argument("--hand", type=float, default=1.0)
    options = ask.parse_args()
    text = options.recipe.read_text()
    recipe = tomllib.loads(text)["shape"]
    names = [name for entry in recipe for name in (entry["name"], entry.get("mirror")) if name]
    teachers = []
    if "ict" in options.teachers:
        source = (options.data / "ict_facekit/generic_neutral_mesh.obj").read_text()
        marks = np.loadtxt(options.data / "ict_facekit/landmarks68.txt", dtype=int)
        shapes = {n: d for n in names if (d := judge.ict_shapes(options.data, n)) is not None}
        teachers.append(Teacher(judge.positions(source), judge.polygons(source), marks, shapes))
    if "vitruvian" in options.teachers:
        path, _, shapes = judge.vitruvian(options.data)
        source = path.read_text()
        marks = np.loadtxt(options.landmarks, dtype=int)
        teachers.append(Teacher(judge.positions(source), judge.polygons(source), marks, shapes))
    for entry in recipe:
        rows = consensus(entry, teachers, options.hand)
        if rows:
            start = text.index(f'name = "{entry["name"]}"\n')
            begin = text.index("move = [", start)
            end = re.compile(r"\]\]|^\]", re.M).search(text, begin).end()
            text = text[:begin] + rows + text[end:]
    options.out.write_text(text)


if __name__ == "__main__":
    main()
