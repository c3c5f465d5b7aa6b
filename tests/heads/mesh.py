"""A head as the judges read it: OBJ, landmarks, triangles, the skin, the lines of lids and lips. None of the product's code is used."""
import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, dijkstra

CELL, IN_FRONT = 0.01, 0.05


def positions(text):
    lines = [line for line in text.split("\n") if line.startswith("v ")]
    return np.array([line.split()[1:4] for line in lines], dtype=float)


def polygons(text):
    lines = (line.split()[1:] for line in text.split("\n") if line.startswith("f "))
    return [[int(corner.split("/")[0]) - 1 for corner in line] for line in lines]


def displacement(path):
    return np.fromfile(path, dtype="<f4").reshape(-1, 3).astype(float)


def unit(v):
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-300)


class Head:
    """A neutral mesh with its landmarks."""

    def __init__(self, p, faces, landmarks):
        self.p, self.landmarks = p, np.asarray(landmarks)
        self.w, self.axes = frame(p[self.landmarks])
        self.triangles = triangles(p, faces)
        n = len(p)
        t = self.triangles
        # Edges of a face, not the cut through it: what lines go along.
        edges = np.array([(f[k - 1], f[k]) for f in faces for k in range(len(f))])
        a, b = edges.T
        length = np.linalg.norm(p[a] - p[b], axis=1) + 1e-12
        graph = coo_matrix((length, (a, b)), (n, n)).tocsr()
        self.graph = graph.maximum(graph.T)
        part = connected_components(self.graph, directed=False)[1]
        self.skin = part == part[self.landmarks[8]]
        self.lids = [self.seam([42, 43, 44, 45], [42, 47, 46, 45]), self.seam([36, 37, 38, 39], [36, 41, 40, 39])]
        self.lips = self.seam([60, 61, 62, 63, 64], [60, 67, 66, 65, 64])
        keep = self.skin[t[:, 0]] & ~self.films(faces)
        self.skin_triangles = t[keep]

    def seam(self, *rows):
        lines = []
        for row in rows:
            line = [self.landmarks[row[0]]]
            for a, b in zip(row, row[1:]):
                a, b = self.landmarks[a], self.landmarks[b]
                before = dijkstra(self.graph, directed=False, indices=a, return_predecessors=True, limit=2 * self.w)[1]
                way = [b]
                while way[-1] != a and before[way[-1]] >= 0:
                    way.append(before[way[-1]])
                line += way[::-1][1:]
            lines.append(np.array(line))
        return lines

    def films(self, faces):
        """Triangles of faces whose corners lie on the two lines of one seam, on both of them."""
        out = []
        seams = [(set(u), set(l)) for u, l in [*self.lids, self.lips]]
        for f in faces:
            film = any(
                all(v in u or v in l for v in f) and any(v not in l for v in f) and any(v not in u for v in f) for u, l in seams
            )
            out += [film] * (len(f) - 2)
        return np.array(out)

    def visible(self):
        """Vertices of the skin that a camera in front sees."""
        q = (self.p @ self.axes) / self.w
        t = self.triangles
        normal = np.zeros_like(q)
        flat = np.cross(q[t[:, 1]] - q[t[:, 0]], q[t[:, 2]] - q[t[:, 0]])
        for k in range(3):
            np.add.at(normal, t[:, k], flat)
        cell = np.floor((q[:, :2] - q[:, :2].min(0)) / CELL).astype(int)
        size = cell.max(0) + 2
        depth = np.full(size, -np.inf)
        # Every triangle is sprinkled with points closer than half a cell.
        longest = np.max([np.linalg.norm(q[t[:, k]] - q[t[:, k - 1]], axis=1) for k in range(3)], axis=0)
        steps = np.minimum(np.ceil(longest / (0.5 * CELL)).astype(int) + 1, 400)
        for n in np.unique(steps):
            i, j = np.tril_indices(n + 1)
            weights = np.column_stack([n - i, i - j, j]) / n
            at = np.einsum("gk,mkc->mgc", weights, q[t[steps == n]]).reshape(-1, 3)
            c = np.floor((at[:, :2] - q[:, :2].min(0)) / CELL).astype(int)
            np.maximum.at(depth, (c[:, 0], c[:, 1]), at[:, 2])
        seen = q[:, 2] > depth[cell[:, 0], cell[:, 1]] - IN_FRONT
        return self.skin & seen & (normal[:, 2] > 0)

    def lid_gap(self, d):
        worst = 0.0
        for side, name in enumerate(["eyeBlinkLeft", "eyeBlinkRight"]):
            if name not in d:
                continue
            p = self.p + d[name]
            upper, lower = self.lids[side]
            a, b = p[lower[:-1]], p[lower[1:]]
            for v in upper:
                line = b - a
                along = ((p[v] - a) * line).sum(1) / np.maximum((line**2).sum(1), 1e-300)
                far = np.linalg.norm(a + line * np.clip(along, 0, 1)[:, None] - p[v], axis=1)
                worst = max(worst, far.min() / self.w)
        return worst


def frame(l):
    """Eye distance and axes (columns left, up, out) of a face by its landmarks."""
    left = l[42] - l[39]
    w = np.linalg.norm(left)
    left = left / w
    up = 0.5 * (l[39] + l[42]) - l[8]
    up = unit(up - left * (up @ left))
    if up[1] > 0.8:
        up = unit(np.array([0, 1, 0]) - left * left[1])
    return w, np.column_stack([left, up, np.cross(left, up)])


def triangles(p, faces):
    """Quads are cut along their shorter diagonal."""
    out = []
    for f in faces:
        if len(f) == 4 and ((p[f[1]] - p[f[3]]) ** 2).sum() < ((p[f[0]] - p[f[2]]) ** 2).sum() * (1 - 1e-9):
            out += [(f[0], f[1], f[3]), (f[1], f[2], f[3])]
        else:
            out += [(f[0], f[k - 1], f[k]) for k in range(2, len(f))]
    return np.array(out)
