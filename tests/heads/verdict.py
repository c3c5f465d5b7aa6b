"""Whether baked shapes are what an animator would sign, by definitions that artists' own shapes were measured with.

python verdict.py DATA WORK                  artists' shapes: the calibration; WORK as judge.py left it
python verdict.py FOLDER...       heads baked with `--landmarks auto --out FOLDER/h.glb --obj FOLDER/obj`; --shapes says each shape's

The product's report has the same definitions (src/baking/bake/verdict.rs) in its own code; neither uses what the solver looks for.
Lengths are in distances w between the inner eye corners, along the face's axes. "Visible" is a vertex of the skin that one of the
views in VIEWS sees in the neutral (orthographic, depth buffer of cells of 0.02 w, nothing before it by more than 0.06 w).

folds     length, in the neutral, of the edges between two visible triangles whose normals are less than 35 degrees apart in the
          neutral and more than 90 in the shape; edges within 0.3 w of a landmark of a lid are summed apart (lids).
turned    area, in the neutral, of visible triangles whose normal turns by more than 120 degrees.
behind    area of cells near the mouth (in front: across the mouth and 0.3 w aside, nose to chin) in which the foremost triangle
          is skin seen from behind, less that of the neutral.
back      in jawOpen: way of the chin (landmark 8) back, for one down; hinge: height above the chin over distance behind it of the
          point about which the best rigid motion of the skin between chin and lower lip turns in the plane of symmetry; lips: by
          how much the middles of the inner lips end apart; upper: the upper one's way over the lower one's.
inside    what lies in the mouth (parts of their own between the lips and 2.5 w behind, and skin behind the lips further than
          0.35 w from them along the surface): mean displacement, in mm at 34 mm between the inner eye corners, in shapes without
          a jaw; their mean, and the worst shape.
grown     share of the edges of parts in the mouth that grow over twofold, worst shape.
open      open area between the lid lines, seen from in front, left in a blink, of the neutral's; the wider eye.
rim       of a mask that ends less than 0.8 w below the chin: way of its rim there in jawOpen over the chin's.
"""
import json
import pathlib
import sys

import numpy as np
from scipy.sparse.csgraph import connected_components, dijkstra

from mesh import Head, displacement, polygons, positions

# Turn to the left and upwards, in degrees: from in front, both sides, above and below.
VIEWS = [(0, 0), (-40, 0), (40, 0), (-75, 0), (75, 0), (0, 30), (0, -40), (-40, -35), (40, -35)]
CELL, IN_FRONT = 0.02, 0.06
FLAT, FOLDED, TURNED = np.cos(np.radians([35, 90, 120]))
AT_LID, AT_CHIN, TO_LIP, ASIDE, DEEP, MASK = 0.3, 0.4, 0.7, 0.3, 0.35, 0.8
MM = 34
# An eye that is open by less on the mean is shut.
SHUT = 0.05
# Shapes that move the jaw or the tongue.
JAW = ("jaw", "mouthStretchWide", "mouthClose", "tongue")
# What the shapes of a head have to keep; the measures of one head, in this order.
BARS = {
    "folds": ("<=", 0.6), "lids": ("<=", 0.8), "turned": ("<=", 0.02), "behind": ("<=", 0.015),
    "back": ("<=", 1.25), "hinge": ("in", (0.60, 0.90)), "lips": (">=", 0.85), "upper": ("<=", 0.25),
    "inside": ("<=", 0.5), "worst": ("<=", 3), "grown": ("<=", 0.01), "open": ("<=", 0.08), "rim": (">=", 0.8),
}


def kept(name, value):
    how, bar = BARS[name]
    if value is None or np.isnan(value):
        return True
    return bar[0] <= value <= bar[1] if how == "in" else value <= bar if how == "<=" else value >= bar


def normals(p, t):
    n = np.cross(p[t[:, 1]] - p[t[:, 0]], p[t[:, 2]] - p[t[:, 0]])
    return n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-300), 0.5 * np.linalg.norm(n, axis=1)


def sprinkled(q, t, cell):
    """Every triangle with its points closer together than half a cell: number of the triangle, place."""
    longest = np.max([np.linalg.norm(q[t[:, k], :2] - q[t[:, k - 1], :2], axis=1) for k in range(3)], axis=0)
    steps = np.minimum(np.ceil(longest / (0.5 * cell)).astype(int) + 1, 400)
    for n in np.unique(steps):
        i, j = np.tril_indices(n + 1)
        weights = np.column_stack([n - i, i - j, j]) / n
        some = np.flatnonzero(steps == n)
        at = np.einsum("gk,mkc->mgc", weights, q[t[some]])
        yield np.repeat(some, len(weights)), at.reshape(-1, 3)


def seen_from(q, t, normal, cell=CELL):
    """Vertices that are seen along -z."""
    low = q[:, :2].min(0)
    size = np.floor((q[:, :2].max(0) - low) / cell).astype(int) + 2
    depth = np.full(size, -np.inf)
    for _, at in sprinkled(q, t, cell):
        c = np.floor((at[:, :2] - low) / cell).astype(int)
        np.maximum.at(depth, (c[:, 0], c[:, 1]), at[:, 2])
    c = np.floor((q[:, :2] - low) / cell).astype(int)
    return (q[:, 2] > depth[c[:, 0], c[:, 1]] - IN_FRONT) & (normal[:, 2] > 0.1)


class Judge:
    """What is measured on the neutral."""

    def __init__(self, head):
        self.head, self.w = head, head.w
        self.q = (head.p - head.p[head.landmarks[[39, 42]]].mean(0)) @ head.axes / head.w
        t = head.skin_triangles
        self.visible = self.see()
        self.t = t[self.visible[t].all(1)]
        self.n0, self.area = normals(self.q, self.t)
        self.pairs, self.edge = self.neighbours()
        self.in_mouth()
        self.unturned = self.behind(self.q)

    def see(self):
        vertex = np.zeros_like(self.q)
        t = self.head.triangles
        flat = np.cross(self.q[t[:, 1]] - self.q[t[:, 0]], self.q[t[:, 2]] - self.q[t[:, 0]])
        for k in range(3):
            np.add.at(vertex, t[:, k], flat)
        vertex /= np.maximum(np.linalg.norm(vertex, axis=1, keepdims=True), 1e-300)
        seen = np.zeros(len(self.q), bool)
        near = np.abs(self.q[:, 1]).clip(max=9) < 5
        t = t[near[t].all(1)]
        for aside, up in np.radians(VIEWS):
            turn = np.array([[np.cos(aside), 0, -np.sin(aside)], [0, 1, 0], [np.sin(aside), 0, np.cos(aside)]])
            lift = np.array([[1, 0, 0], [0, np.cos(up), -np.sin(up)], [0, np.sin(up), np.cos(up)]])
            m = (lift @ turn).T
            seen |= seen_from(self.q @ m, t, vertex @ m)
        return seen & self.head.skin & near

    def neighbours(self):
        """Pairs of triangles on both sides of an edge, and the edges' ends."""
        t = self.t
        edges = np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1)
        owner = np.tile(np.arange(len(t)), 3)
        order = np.lexsort(edges.T)
        edges, owner = edges[order], owner[order]
        same = (edges[1:] == edges[:-1]).all(1)
        # Of an edge with more than two triangles nothing is said.
        more = np.zeros(len(edges) - 1, bool)
        more[1:] = same[1:] & same[:-1]
        more[:-1] |= same[1:] & same[:-1]
        first = np.flatnonzero(same & ~more)
        return np.column_stack([owner[first], owner[first + 1]]), edges[first]

    def in_mouth(self):
        """Parts in the mouth and what of the skin lies behind the lips."""
        head, q = self.head, self.q
        part = connected_components(head.graph, directed=False)[1]
        corners = q[head.landmarks[[60, 64]]]
        middle, lip = corners.mean(0), q[head.landmarks[51]]
        wide = np.linalg.norm(q[head.landmarks[54]] - q[head.landmarks[48]])
        self.parts = np.zeros(len(q), bool)
        for c in range(part.max() + 1):
            some = part == c
            low, high = q[some].min(0), q[some].max(0)
            d = (low + high) / 2 - middle
            if head.skin[some].any() or abs(d[0]) > 0.6 * wide or abs(d[1]) > 0.6 or not -2.5 < d[2] < 0.3:
                continue
            self.parts |= some & (high - low < 2.2)[:2].all() & (high[2] < lip[2] + 0.05)
        line = np.unique(np.concatenate(head.lips))
        free = head.skin.copy()
        free[np.unique(np.concatenate([line, *head.lids[0], *head.lids[1]]))] = False
        inner = head.graph[free][:, free]
        label = np.full(len(q), -1)
        label[free] = connected_components(inner, directed=False)[1]
        behind = (label >= 0) & (label != label[head.landmarks[8]])
        touching = np.unique(label[(head.graph[line] > 0).indices])
        behind &= np.isin(label, touching)
        # What lies behind a lid touches no lip.
        far = dijkstra(head.graph, directed=False, indices=line, min_only=True) / self.w
        self.deep = behind & (far > DEEP)
        self.inside = self.parts | self.deep
        t = head.triangles
        t = t[self.parts[t].all(1)]
        edges = np.unique(np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1), axis=0)
        self.mouth_edges = edges.reshape(-1, 2)

    def shape(self, d):
        """Figures of one shape; d in mesh units."""
        q = self.q + d @ self.head.axes / self.w
        n, _ = normals(q, self.t)
        a, b = self.pairs.T
        folded = ((self.n0[a] * self.n0[b]).sum(1) > FLAT) & ((n[a] * n[b]).sum(1) < FOLDED)
        at = self.q[self.edge]
        length = np.linalg.norm(at[:, 0] - at[:, 1], axis=1)
        lids = self.q[self.head.landmarks[36:48]]
        beside = (np.linalg.norm(at.mean(1)[:, None] - lids[None], axis=2) < AT_LID).any(1)
        turned = (self.n0 * n).sum(1) < TURNED
        out = {
            "folds": length[folded & ~beside].sum(), "lids": length[folded & beside].sum(),
            "turned": self.area[turned].sum(), "behind": self.behind(q) - self.unturned,
        }
        e = self.mouth_edges
        if len(e):
            size = lambda p: np.linalg.norm(p[e[:, 0]] - p[e[:, 1]], axis=1)
            out["grown"] = (size(q) > 2 * size(self.q) + 1e-9).mean()
        if self.inside.any():
            out["inside"] = np.linalg.norm((q - self.q)[self.inside], axis=1).mean() * MM
        return out

    def behind(self, q):
        """Area in front of the mouth where skin is seen from behind."""
        l = q[self.head.landmarks]
        low = np.array([l[48:60, 0].min() - ASIDE, l[8, 1]])
        high = np.array([l[48:60, 0].max() + ASIDE, l[33, 1]])
        t = self.head.triangles
        corners = q[t][:, :, :2]
        near = ((corners.max(1) > low) & (corners.min(1) < high)).all(1) & (q[t][:, :, 2] > l[33, 2] - 4).all(1)
        t = t[near]
        n, _ = normals(q, t)
        away = (n[:, 2] < 0) & self.head.skin[t[:, 0]]
        size = np.floor((high - low) / CELL).astype(int) + 1
        depth, back = np.full(size, -np.inf), np.zeros(size, bool)
        for some, at in sprinkled(q, t, CELL):
            c = np.floor((at[:, :2] - low) / CELL).astype(int)
            ok = ((c >= 0) & (c < size)).all(1)
            c, z, is_away = c[ok], at[ok, 2], away[some[ok]]
            order = np.argsort(z, kind="stable")
            c, z, is_away = c[order], z[order], is_away[order]
            nearer = z > depth[c[:, 0], c[:, 1]]
            c, z, is_away = c[nearer], z[nearer], is_away[nearer]
            depth[c[:, 0], c[:, 1]] = z
            back[c[:, 0], c[:, 1]] = is_away
        return back.sum() * CELL**2

    def jaw(self, d):
        head = self.head
        m = d @ head.axes / self.w
        chin = self.q[head.landmarks[8]]
        front = chin + TO_LIP * (self.q[head.landmarks[57]] - chin)
        some = self.visible & (np.linalg.norm(self.q - front, axis=1) < AT_CHIN)
        some[head.landmarks[[8, 57]]] = True
        way = m[head.landmarks[8]]
        up, low = m[head.landmarks[62]], m[head.landmarks[66]]
        gap = (self.q[head.landmarks[62]] + up - self.q[head.landmarks[66]] - low)[1]
        out = {"back": way[2] / min(way[1], -1e-9), "lips": gap, "upper": np.linalg.norm(up) / max(np.linalg.norm(low), 1e-9)}
        out["hinge"] = hinge(self.q[some], m[some], chin)
        rim = self.rim(chin)
        if rim is not None:
            out["rim"] = np.linalg.norm(m[rim].mean(0)) / max(np.linalg.norm(m[head.landmarks[8]]), 1e-9)
        return out

    def rim(self, chin):
        """Vertices of a mask's lower edge below the chin."""
        skin = self.q[self.head.skin]
        middle = np.abs(skin[:, 0] - chin[0]) < 0.3
        if skin[middle & (skin[:, 2] < chin[2] + 0.3), 1].min() < chin[1] - MASK:
            return None
        t = self.head.triangles[self.head.skin[self.head.triangles[:, 0]]]
        edges = np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1)
        edges, count = np.unique(edges, axis=0, return_counts=True)
        rim = np.unique(edges[count == 1])
        near = np.linalg.norm(self.q[rim] - chin, axis=1) < MASK
        near &= (np.abs(self.q[rim, 0] - chin[0]) < 0.3) & (self.q[rim, 1] < chin[1] + 0.2)
        return rim[near] if near.any() else None

    def open(self, d, side):
        """Open area between the lid lines of an eye, of the neutral's."""
        upper, lower = self.head.lids[side]

        def area(q):
            x = np.linspace(*self.q[[lower[0], lower[-1]], 0], 201)
            line = lambda l: np.interp(x, *sorted_line(q[l]))
            return np.maximum(line(upper) - line(lower), 0).mean()

        before = area(self.q)
        return area(self.q + d @ self.head.axes / self.w) / before if before > SHUT else np.nan


def sorted_line(l):
    order = np.argsort(l[:, 0], kind="stable")
    return l[order, 0], l[order, 1]


def hinge(q, m, chin):
    """Height above the chin over distance behind it of the point about which it turns."""
    a, b = q[:, 1:], (q + m)[:, 1:]
    a0, b0 = a.mean(0), b.mean(0)
    cross = ((a - a0)[:, 0] * (b - b0)[:, 1] - (a - a0)[:, 1] * (b - b0)[:, 0]).sum()
    angle = np.arctan2(cross, ((a - a0) * (b - b0)).sum())
    if abs(angle) < np.radians(2):
        return np.nan
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    at = np.linalg.solve(np.eye(2) - turn, b0 - turn @ a0)
    return (at[0] - chin[1]) / (chin[2] - at[1])


def verdict(head, d, upon):
    """The worst of every measure with its shape, and every shape's figures."""
    judge, shapes = Judge(head), {}
    for name, moved in d.items():
        beneath = sum((d[b] for b in [upon.get(name)] if b in d), np.zeros_like(moved))
        shapes[name] = judge.shape(moved + beneath)
        shapes[name].pop("inside", None) if name.startswith(JAW) else None
        if name.startswith("tongue"):
            shapes[name].pop("grown", None)
    worst = {}
    for measure in ("folds", "lids", "turned", "behind", "grown"):
        known = {n: f[measure] for n, f in shapes.items() if measure in f}
        if known:
            shape = max(known, key=known.get)
            worst[measure] = (known[shape], shape)
    still = {n: f["inside"] for n, f in shapes.items() if "inside" in f}
    if still:
        shape = max(still, key=still.get)
        worst["inside"], worst["worst"] = (np.mean(list(still.values())), ""), (still[shape], shape)
    if "jawOpen" in d:
        worst |= {k: (v, "jawOpen") for k, v in judge.jaw(d["jawOpen"]).items()}
    for side, name in enumerate(["eyeBlinkLeft", "eyeBlinkRight"]):
        if name in d:
            left = judge.open(d[name], side)
            if not np.isnan(left) and left >= worst.get("open", (-1,))[0]:
                worst["open"] = (left, name)
    return worst, shapes


def line(name, worst):
    cells = []
    for measure in BARS:
        value, shape = worst.get(measure, (np.nan, ""))
        number = "   -" if np.isnan(value) else f"{value:5.3f}" if measure in ("turned", "behind", "grown", "open") else f"{value:5.2f}"
        cells.append(f"{number}{' ' if kept(measure, value) else '!'}")
    bad = [f"{m} {worst[m][1]}" for m in BARS if m in worst and not kept(m, worst[m][0]) and worst[m][1] not in ("", "jawOpen")]
    return f"{name:12}" + " ".join(f"{c:>7}" for c in cells) + "  " + ", ".join(bad)


def title():
    return f"{'head':12}" + " ".join(f"{m:>7}" for m in BARS)


def artists(data, marks):
    """Heads with shapes that somebody made, with landmarks found by the baker where none are known."""
    index = lambda folder: [r.split(",")[:2] for r in (folder / "index.csv").read_text().split("\n")[1:] if r]
    for name, folder in [("facecap", "head_facecap"), ("faceunits", "heads_makehuman/faceunits01"), ("vitruvian", "head_vitruvian")]:
        folder = data / folder
        shapes = {ours: displacement(folder / "shapes" / file) for file, ours in index(folder)}
        yield name, (folder / "head.obj").read_text(), np.loadtxt(marks / name / "aoi/h.landmarks.txt", dtype=int), shapes
    folder = data / "ict_facekit"
    shapes = {p.stem.replace("_L", "Left").replace("_R", "Right"): displacement(p) for p in sorted((folder / "expr").glob("*.f32"))}
    yield "ict", (folder / "generic_neutral_mesh.obj").read_text(), np.loadtxt(folder / "landmarks68.txt", dtype=int), shapes


def baked(folder):
    """A head as the baker left it: landmarks, shapes, what each is meant upon."""
    text = (folder / "obj/neutral.obj").read_text()
    p = positions(text)
    listed = json.loads((folder / "obj/shapes.json").read_text())["shapes"]
    d = {s["name"]: positions((folder / "obj" / s["file"]).read_text()) - p for s in listed}
    # Lips that were cut open have points of their own.
    cut = folder / "obj/landmarks.txt"
    marks = np.loadtxt(cut if cut.exists() else folder / "h.landmarks.txt", dtype=int)
    return Head(p, polygons(text), marks), d, {s["name"]: s["upon"] for s in listed}


def main():
    folders = [pathlib.Path(a) for a in sys.argv[1:] if a != "--shapes"]
    calibrates = len(folders) == 2 and (folders[0] / "ict_facekit").exists()
    print(title())
    for name, text, marks, shapes in artists(*folders) if calibrates else ():
        worst, _ = verdict(Head(positions(text), polygons(text), marks), shapes, {"mouthClose": "jawOpen"})
        print(line(name, worst), flush=True)
    for folder in () if calibrates else folders:
        worst, shapes = verdict(*baked(folder))
        print(line(folder.name, worst), flush=True)
        for name, figures in shapes.items() if "--shapes" in sys.argv else ():
            each = (f"{k} {v:.3f}{'' if kept('worst' if k == 'inside' else k, v) else '!'}" for k, v in figures.items())
            print(f"  {name:24} " + "  ".join(each))


if __name__ == "__main__":
    main()
