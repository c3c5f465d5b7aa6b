"""The error of libigl's own deformations on the comparison that `comes_closer_to_sculpted_shapes` prints.

pip install libigl==2.6.3 numpy scipy && python libigl.py FOLDER_OF_ICT_FACEKIT

Biharmonic deformation (k = 2) and as-rigid-as-possible, controlled by the true displacements of the 68 landmarks; then
the same with head and neck held. The figure is the mean over 29 shapes of RMS error / RMS motion on vertices 0 to 9408.
"""
import pathlib
import sys

import igl
import numpy as np

folder = pathlib.Path(sys.argv[1])
points, faces = [], []
for line in open(folder / "generic_neutral_mesh.obj"):
    word = line.split()
    if word[:1] == ["v"]:
        points.append([float(x) for x in word[1:4]])
    elif word[:1] == ["f"]:
        c = [int(x.split("/")[0]) - 1 for x in word[1:]]
        faces += [[c[0], c[k - 1], c[k]] for k in range(2, len(c))]
SKIN = 14062
points = np.array(points)[:SKIN]
faces = np.array([f for f in faces if max(f) < SKIN], dtype=np.int64)
marks = np.loadtxt(folder / "landmarks68.txt", dtype=np.int64)
shapes = [p for p in sorted((folder / "expr").glob("*.f32")) if not p.stem.startswith("PupilDilate")]
truth = [np.fromfile(p, "<f4").reshape(-1, 3)[:SKIN].astype(float) for p in shapes]


def error(moved, true):
    return np.sqrt(((moved - points - true)[:9409] ** 2).sum() / (true[:9409] ** 2).sum())


for held in (np.array([], np.int64), np.arange(9409, 11248)):
    fixed = np.concatenate([marks, held[~np.isin(held, marks)]])
    goals = [np.concatenate([points[marks] + t[marks], points[fixed[68:]]]) for t in truth]
    what = "head and neck held" if len(held) else "nothing else held"
    found = [
        points + igl.harmonic(points, faces, fixed, g - points[fixed], 2) for g in goals
    ]
    print(f"biharmonic, {what}: {np.mean([error(f, t) for f, t in zip(found, truth)]):.4f}", flush=True)
    found = []
    for g in goals:
        solver = igl.ARAPData()
        solver.max_iter = 10
        igl.arap_precomputation(points, faces, 3, fixed.astype(np.int32), solver)
        found.append(igl.arap_solve(g, solver, points.copy()))
    print(f"as rigid as possible, {what}: {np.mean([error(f, t) for f, t in zip(found, truth)]):.4f}", flush=True)
