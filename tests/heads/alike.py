"""One head brought in many ways must get one set of shapes: faces reversed, mirrored, z up, other units, split, cut to triangles.

    python tests/heads/alike.py STUDIO OUT [DATA] [--auto] [--heads ict,old-woman] [--ways z-up]    (needs numpy and scipy)

Each way is baked with the same 68 points, or with --auto with those that are found, and compared with the plain head: the largest error of a
shape's displacement over its size (both RMS over the vertices), and the shape. Ends with 1 if one is above the bar of 1 %.
"""
import argparse
import subprocess
import sys
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from awkward import HEADS, parts, read, seams_split, triangles, write

BAR = 0.01
MIRROR = [*range(16, -1, -1), *range(26, 16, -1), 27, 28, 29, 30, 35, 34, 33, 32, 31, 45, 44, 43, 42, 47, 46, 39, 38, 37, 36, 41, 40,
          54, 53, 52, 51, 50, 49, 48, 59, 58, 57, 56, 55, 64, 63, 62, 61, 60, 67, 66, 65]


def ways(p, f):
    """Name: places, faces, and how places and ways of these come back to the plain head."""
    same = lambda q: q
    part = parts(len(p), f)
    skin = np.bincount(part).argmax()
    back = [face[::-1] for face in f]
    mixed = lambda turns: [b if turns(k, a[0]) else a for k, (a, b) in enumerate(zip(f, back))]
    mirror = lambda q: q * [-1, 1, 1]
    return {
        "reversed": (p, back, same),
        "skin-reversed": (p, mixed(lambda k, v: part[v] == skin), same),
        "rest-reversed": (p, mixed(lambda k, v: part[v] != skin), same),
        "third-reversed": (p, mixed(lambda k, v: k % 3 == 0), same),
        "mirrored": (mirror(p), back, mirror),
        "mirrored-only": (mirror(p), f, mirror),
        "z-up": (p[:, [0, 2, 1]] * [1, -1, 1], f, lambda q: q[:, [0, 2, 1]] * [1, 1, -1]),
        "centimetres": (p * 100, f, lambda q: q / 100),
        "decimetres": (p * 10, f, lambda q: q / 10),
        "split": (*seams_split(p, f), same),
        "triangulated": (p, triangles(f), same),
    }


def vertices(path):
    return np.array([line.split()[1:4] for line in open(path) if line.startswith("v ")], float)


def bake(studio, mesh, landmarks):
    out = mesh.with_suffix(".shapes")
    command = [studio, "bake", "--mesh", mesh, "--landmarks", landmarks, "--out", mesh.with_suffix(".glb"), "--obj", out]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{mesh}: {done.stderr}")
    neutral = vertices(mesh)
    shapes = {one.stem: vertices(one) - neutral for one in out.glob("*.obj") if one.stem != "neutral"}
    for one in out.glob("*"):
        one.unlink()
    return neutral, shapes, [line for line in done.stdout.splitlines() if "look inwards" in line]


def other_side(name):
    for one, two in (("Left", "Right"), ("Right", "Left")):
        if name.endswith(one):
            return name.removesuffix(one) + two
    return name


def main():
    words = argparse.ArgumentParser()
    words.add_argument("studio")
    words.add_argument("out", type=Path)
    words.add_argument("data", type=Path, nargs="?", default=Path("../shared/data"))
    words.add_argument("--auto", action="store_true")
    words.add_argument("--heads", default=",".join(HEADS))
    words.add_argument("--ways", default="", help="only these, with commas")
    asked = words.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    worst = 0
    for name in asked.heads.split(","):
        path, metres, _ = HEADS[name]
        p, f = read(asked.data / path, metres)
        # As it is written: the same places in every unit.
        p = p.round(6)
        plain = asked.out / f"{name}.obj"
        write(plain, p, f)
        neutral, shapes, said = bake(asked.studio, plain, "auto")
        print(f"{name}: {len(shapes)} shapes of the plain head", *said, flush=True)
        points = [int(line) for line in open(plain.with_suffix(".landmarks.txt"))]
        for way, (places, faces, back) in ways(p, f).items():
            if asked.ways and way not in asked.ways.split(","):
                continue
            mesh, text = asked.out / f"{name}-{way}.obj", asked.out / f"{name}-{way}.txt"
            write(mesh, places, faces)
            there = cKDTree(back(places)).query(p[points])[1]
            there = there[MIRROR] if "mirrored" in way else there
            text.write_text("".join(f"{v}\n" for v in there))
            found, made, said = bake(asked.studio, mesh, "auto" if asked.auto else text)
            # Closed lips have several vertices in one place.
            far, near = cKDTree(back(found)).query(neutral, k=4)
            errors = []
            for shape, d in shapes.items():
                other = back(made[other_side(shape) if "mirrored" in way else shape])
                miss = np.where(far < 3e-6, ((other[near] - d[:, None]) ** 2).sum(2), np.inf).min(1)
                miss = miss[np.isfinite(miss)].sum()
                errors.append((float(np.sqrt(miss / (d**2).sum())), shape))
            errors.sort(reverse=True)
            worst = max(worst, errors[0][0])
            print(f"  {way}: {errors[0][0]:.4f} ({errors[0][1]}), {sum(e > BAR for e, _ in errors)} above {BAR}", *said, flush=True)
    sys.exit(worst > BAR)


if __name__ == "__main__":
    main()
