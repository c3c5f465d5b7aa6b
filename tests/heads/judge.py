"""Heads that played no part in the work, baked and judged: a table of heads and methods.

python judge.py STUDIO DATA WORK [--heads A,B*] [--methods aoi,carried] [--shapes]
STUDIO is mien-studio, DATA the shared data, WORK a folder that is kept: what is there of the same binary is not baked again.
Needs numpy and scipy. None of the product's code is used, only the OBJ files that `bake --obj` writes.

What is judged, all in eye distances w (between landmarks 39 and 42):

found     largest distance of one of the landmarks 17 to 67 from where it is known to be, where it is known; else the
          confidence that `bake --landmarks auto` prints. 'no' if there was no bake.
fails     which measures of verdict.py the shapes miss, with their value; 'none' if they keep all.
lids      largest distance of a vertex of the upper lid line from the lower line in eyeBlink; both lines are shortest ways
          along edges through the landmarks of the lid.
bends     of what is worn (HEAD.rigid.json beside the head names it), the furthest way of a vertex in any shape from where the
          part's best rigid motion takes it, and, in brackets, the furthest way at all: a head that stays moves nothing.
error     against shapes that others sculpted on the same head. Over the vertices of the skin that a camera in front sees
          (orthographic, along the face's axis: the normal points to it, and no part of the head is in front by more than
          0.05 w, by a depth buffer of cells of 0.01 w), |g b - t| / |t|, where g is the one gain of the shape that makes it
          least: how far a shape goes is taste. All vertices count the same. A shape sculpted for both sides at once is
          compared with the sum of both. Mean over the shapes and the worst; `both` counts only shapes that ICT has too.

carried   what anybody could do in an hour: ICT's neutral is warped onto the head by a thin-plate spline (kernel r) through the
          68 landmarks; each vertex of the skin takes the displacement of the nearest point of the warped surface.
"""
import argparse
import fnmatch
import hashlib
import json
import pathlib
import subprocess
import sys

import numpy as np
from scipy.spatial import cKDTree

from mesh import Head, displacement, polygons, positions
from verdict import kept, verdict

METHODS = ["aoi", "paper", "laplacian", "carried"]
# ICT's names of what ours are called; a name alone is its own.
ICT = {"cheekPuff": "cheekPuff_L cheekPuff_R", "browInnerUp": "browInnerUp_L browInnerUp_R"}


# ------------------------------------------------------------------------------------------------------ carried over


def warp(source, target):
    """The thin-plate map through both sets of points."""
    n = len(source)
    kernel = lambda p: -np.linalg.norm(p[:, None] - source[None], axis=2)
    line = lambda p: np.column_stack([np.ones(len(p)), p])
    system = np.block([[kernel(source), line(source)], [line(source).T, np.zeros((4, 4))]])
    x = np.linalg.lstsq(system, np.r_[target, np.zeros((4, 3))], rcond=None)[0]
    return lambda p: kernel(p) @ x[:n] + line(p) @ x[n:]


def nearest(points, p, t):
    """For every point: the triangle and the weights of its corners at the nearest place of a surface."""
    middle = p[t].mean(1)
    found = cKDTree(middle).query(points, k=24)[1]
    best = np.full(len(points), np.inf)
    corner, weight = np.zeros((len(points), 3), int), np.zeros((len(points), 3))
    for column in found.T:
        a, b, c = p[t[column, 0]], p[t[column, 1]], p[t[column, 2]]
        w = barycentric(points, a, b, c)
        at = w[:, :1] * a + w[:, 1:2] * b + w[:, 2:] * c
        far = ((at - points) ** 2).sum(1)
        nearer = far < best
        best[nearer], corner[nearer], weight[nearer] = far[nearer], t[column[nearer]], w[nearer]
    return corner, weight


def barycentric(p, a, b, c):
    """Weights of the nearest point of each triangle."""
    dot = lambda x, y: (x * y).sum(1)
    ab, ac, ap = b - a, c - a, p - a
    d = [dot(ab, ab), dot(ab, ac), dot(ac, ac)]
    e, f = dot(ap, ab), dot(ap, ac)
    size = np.maximum(d[0] * d[2] - d[1] ** 2, 1e-300)
    v, w = (d[2] * e - d[1] * f) / size, (d[0] * f - d[1] * e) / size
    inside = np.column_stack([1 - v - w, v, w])
    best, far = inside, np.where((inside >= 0).all(1), 0.0, np.inf)
    for i, j, q, r in [(0, 1, a, b), (1, 2, b, c), (2, 0, c, a)]:
        s = np.clip(dot(p - q, r - q) / np.maximum(dot(r - q, r - q), 1e-300), 0, 1)
        edge = np.zeros_like(inside)
        edge[:, i], edge[:, j] = 1 - s, s
        away = dot(q + s[:, None] * (r - q) - p, q + s[:, None] * (r - q) - p)
        away = np.where(np.isfinite(far) & (far == 0), np.inf, away)
        nearer = away < far
        best = np.where(nearer[:, None], edge, best)
        far = np.where(nearer, away, far)
    return best


def ict_shapes(data, name):
    """Sum of ICT's shapes that one of ours is; None if it has none."""
    names = ICT.get(name, name.replace("Left", "_L").replace("Right", "_R")).split()
    if name in ("mouthLeft", "mouthRight", "jawLeft", "jawRight"):
        names = [name]
    paths = [data / "ict_facekit/expr" / f"{n}.f32" for n in names]
    return sum(map(displacement, paths)) if all(p.exists() for p in paths) else None


def carried(head, source, shapes):
    """Another head's shapes on this one, by name."""
    at, there = (h.p[h.landmarks] @ h.axes / h.w for h in (source, head))
    skin = warp(at, there)(source.p @ source.axes / source.w)
    here = np.flatnonzero(head.skin)
    t = source.triangles[source.skin[source.triangles[:, 0]]]
    corner, weight = nearest(head.p[here] @ head.axes / head.w, skin, t)
    out = {}
    for name, d in shapes.items():
        out[name] = moved = np.zeros_like(head.p)
        moved[here] = (d[corner] * weight[..., None]).sum(1) @ source.axes / source.w @ head.axes.T * head.w
    return out


def ict(data, names):
    """ICT's head, and its shapes by our names."""
    text = (data / "ict_facekit/generic_neutral_mesh.obj").read_text()
    marks = np.loadtxt(data / "ict_facekit/landmarks68.txt", dtype=int)
    shapes = {name: d for name in names if (d := ict_shapes(data, name)) is not None}
    return Head(positions(text), polygons(text), marks), shapes


# ------------------------------------------------------------------------------------------------------------- heads


def sculpted(folder):
    """A head with the shapes that somebody made for it."""
    rows = [line.split(",")[:2] for line in (folder / "index.csv").read_text().split("\n")[1:] if line]
    return folder / "head.obj", None, {ours: displacement(folder / "shapes" / file) for file, ours in rows}


def person(data, work, seed):
    """A person of ICT's identity modes at random; sculpted are its own shapes, which the skin was learned from."""
    text = (data / "ict_facekit/generic_neutral_mesh.obj").read_text()
    marks = np.loadtxt(data / "ict_facekit/landmarks68.txt", dtype=int)
    p = positions(text)
    random = np.random.default_rng(seed)
    for k in range(40):
        p = p + displacement(data / f"ict_facekit/id/identity{k:03}.f32") * random.normal()
    path = work / "head.obj"
    rows = iter(p)
    lines = ("v %.6f %.6f %.6f" % tuple(next(rows)) if line.startswith("v ") else line for line in text.split("\n"))
    path.write_text("\n".join(lines))
    return path, marks, "ict"


def heads(data, work):
    """Name of every head with what makes its file, known landmarks and sculpted shapes."""
    folders = {"vitruvian": "head_vitruvian", "facecap": "head_facecap", "faceunits": "heads_makehuman/faceunits01"}
    out = {name: lambda folder=data / folder: sculpted(folder) for name, folder in folders.items()}
    out["scan"] = lambda: (data / "head_scan/head.obj", None, None)
    for path in sorted((data / "heads_makehuman").glob("*.obj")):
        out[path.stem] = lambda path=path: (path, None, None)
    marks = lambda folder: np.loadtxt(data / folder / "landmarks68.txt", dtype=int)
    out["ict"] = lambda: (data / "ict_facekit/generic_neutral_mesh.obj", marks("ict_facekit"), "ict")
    for seed in range(1, 4):
        out[f"ict-person-{seed}"] = lambda seed=seed: person(data, work / f"ict-person-{seed}", seed)
    out["canonical"] = lambda: (data / "canonical_face/canonical_face_model.obj", marks("canonical_face"), None)
    awkward = pathlib.Path(__file__).with_name("awkward.py")
    if awkward.exists():
        folder = work / "awkward"
        if not folder.exists():
            subprocess.run([sys.executable, awkward, folder, data], check=True, stdout=subprocess.DEVNULL)
        for path in sorted([*folder.glob("*.obj"), *folder.glob("*.gl*")]):
            out[path.stem] = lambda path=path: (path, None, None)
    return out


def bake(studio, path, method, folder):
    """Runs the baker; returns its words, or None where it refused."""
    out = folder / method
    out.mkdir(parents=True, exist_ok=True)
    marks = "auto" if method == "aoi" else folder / "aoi" / "h.landmarks.txt"
    words = [studio, "bake", "--mesh", path, "--landmarks", marks, "--out", out / "h.glb", "--obj", out / "obj"]
    stamp = hashlib.sha256(pathlib.Path(studio).read_bytes() + pathlib.Path(path).read_bytes())
    stamp, kept = stamp.hexdigest(), out / "stamp"
    if kept.exists() and kept.read_text().startswith(stamp):
        return kept.read_text()[len(stamp) :]
    ran = subprocess.run([*map(str, words), "--method", method], capture_output=True, text=True)
    if ran.returncode:
        print(f"   {path}, {method}: {ran.stderr.strip()[-300:]}", file=sys.stderr)
        return None
    kept.write_text(stamp + ran.stdout)
    return ran.stdout


def baked(out):
    """Neutral text, displacement of every shape, what each is meant upon."""
    text = (out / "obj/neutral.obj").read_text()
    p = positions(text)
    listed = json.loads((out / "obj/shapes.json").read_text())["shapes"]
    d = {s["name"]: positions((out / "obj" / s["file"]).read_text()) - p for s in listed}
    return p, text, d, {s["name"]: s["upon"] for s in listed}


def errors(head, d, sculpted, gains=False):
    """Error of every sculpted shape with the best gain, over what a camera in front sees; if asked for, also the gains."""
    seen = head.visible()
    out, gain = {}, {}
    for name, true in sculpted.items():
        parts = [d.get(n) for n in name.split("+")]
        if all(part is not None for part in parts) and true[seen].any():
            b, t = sum(parts)[seen].ravel(), true[seen].ravel()
            gain[name] = (b @ t) / max(b @ b, 1e-300)
            out[name] = np.linalg.norm(gain[name] * b - t) / np.linalg.norm(t)
    return (out, gain) if gains else out


def rigid(here, there):
    """The places moved as one, as near to the others as can be (Kabsch)."""
    a, b = here - here.mean(0), there - there.mean(0)
    u, _, v = np.linalg.svd(a.T @ b)
    u[:, -1] *= np.sign(np.linalg.det(u @ v))
    return a @ u @ v + there.mean(0)


def worn(path, head, d):
    """Words about what must not bend; its parts are the last of the mesh, in order."""
    listed = pathlib.Path(path).with_suffix(".rigid.json")
    sizes, said = json.loads(listed.read_text()) if listed.exists() else {}, ""
    at = len(head.p) - sum(sizes.values())
    for name, size in sizes.items():
        some = slice(at, at + size)
        at += size
        way = lambda off: max(np.linalg.norm(x, axis=1).max() / head.w for x in off)
        bent = way(rigid(head.p[some], head.p[some] + moved[some]) - head.p[some] - moved[some] for moved in d.values())
        said += f" {name} {bent:.3f} ({way(moved[some] for moved in d.values()):.3f})"
    return "  bends" + said if said else ""


def judge(head, d, upon):
    """What the verdict finds at fault, and the widest gap between lids."""
    worst, _ = verdict(head, d, upon)
    fails = [f"{m} {v:.3g} {shape}".strip() for m, (v, shape) in worst.items() if not kept(m, v)]
    return "; ".join(fails) or "none", head.lid_gap(d)


def one(name, make, options):
    folder = options.work / name
    folder.mkdir(parents=True, exist_ok=True)
    path, known, made = make()
    head, table = None, {}
    for method in options.methods:
        found = "-"
        if method == "carried":
            if head is None or name.startswith("ict"):
                continue
            d, upon = carried(head, *ict(options.data, first)), {}
        else:
            said = bake(options.studio, path, method, folder)
            if said is None:
                print(f"{name:24} {method:10} no")
                continue
            p, text, d, upon = baked(folder / method)
            if head is None:
                marks = np.loadtxt(folder / "aoi/h.landmarks.txt", dtype=int)
                if marks.max() >= len(p) or len(d) == 0:
                    marks = np.minimum(marks, len(p) - 1)
                head, first = Head(p, polygons(text), marks), d
            found = said.split("confidence ")[1].split(",")[0].split(":")[0] if "confidence" in said else "-"
            if known is not None and method == "aoi":
                off = np.linalg.norm(head.p[known] - head.p[head.landmarks], axis=1) / head.w
                found = f"{off[17:].max():.3f}"
        if made == "ict":
            made = {n: t for n, t in ((n, ict_shapes(options.data, n)) for n in d) if t is not None}
        fails, gap = judge(head, d, upon)
        line = f"{name:24} {method:10} found {found:5}  lids {gap:.3f}  fails: {fails}"
        line += worn(path, head, d)
        if made:
            e = table[method] = errors(head, d, made)
            worst = max(e, key=e.get)
            both = [e[n] for n in e if ict_shapes(options.data, n) is not None]
            line += f"  error {np.mean(list(e.values())):.3f} of {len(e)}, {np.mean(both):.3f} of both {len(both)} (worst {worst} {e[worst]:.3f})"
        print(line, flush=True)
    if options.shapes and table:
        print(f"   {'':46}" + "".join(f"{m:>10}" for m in table))
        for shape in made:
            print(f"   {shape:46}" + "".join(f"{table[m].get(shape, float('nan')):10.3f}" for m in table))


def main():
    ask = argparse.ArgumentParser()
    ask.add_argument("studio")
    ask.add_argument("data", type=pathlib.Path)
    ask.add_argument("work", type=pathlib.Path)
    ask.add_argument("--heads", default="")
    ask.add_argument("--methods", default=",".join(METHODS))
    ask.add_argument("--shapes", action="store_true", help="every sculpted shape")
    options = ask.parse_args()
    options.methods = options.methods.split(",")
    options.work.mkdir(parents=True, exist_ok=True)
    chosen = options.heads.split(",") if options.heads else None
    for name, make in heads(options.data, options.work).items():
        if chosen is None or any(fnmatch.fnmatch(name, c) for c in chosen):
            (options.work / name).mkdir(parents=True, exist_ok=True)
            one(name, make, options)


if __name__ == "__main__":
    main()
