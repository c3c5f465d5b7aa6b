"""What Blender sees of baked GLB files, and whether it hands them on unchanged.

pip install bpy==5.0.1 && python blender.py OBJ_FOLDER FILE.glb...

OBJ_FOLDER is what `mien-studio bake --obj` wrote: the truth, one OBJ per shape. Every file is imported, its shape keys
are compared with that truth, and it is exported and imported again. Prints the largest difference in micrometres.
"""
import json
import pathlib
import sys
import tempfile

import bpy
import mathutils
import numpy as np


def rows(mesh_keys):
    out = np.empty(len(mesh_keys.data) * 3, np.float32)
    mesh_keys.data.foreach_get("co", out)
    # Blender is z up: back to y up.
    x, y, z = out.reshape(-1, 3).T
    return np.stack([x, z, -y], 1)


def load(path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=str(path), merge_vertices=False)
    found = [o for o in bpy.data.objects if o.type == "MESH" and o.data.shape_keys]
    blocks = [o.data.shape_keys.key_blocks for o in found]
    basis = np.concatenate([rows(b["Basis"]) for b in blocks])
    names = [k.name for k in blocks[0]][1:]
    return basis, {n: np.concatenate([rows(b[n]) for b in blocks]) - basis for n in names}


def obj(path):
    return np.array([line.split()[1:4] for line in open(path) if line.startswith("v ")], float)


def main():
    folder = pathlib.Path(sys.argv[1])
    listed = json.load(open(folder / "shapes.json"))["shapes"]
    neutral = obj(folder / "neutral.obj")
    for path in sys.argv[2:]:
        basis, shapes = load(path)
        scale = np.ptp(basis[:, 1]) / np.ptp(neutral[:, 1])
        scale = 10.0 ** round(np.log10(scale))
        # Vertices by place; where several are at one place, the one that moves alike counts.
        tree = mathutils.kdtree.KDTree(len(neutral))
        for v, p in enumerate(neutral * scale):
            tree.insert(p, v)
        tree.balance()
        who = [[v for _, v, _ in tree.find_range(p, 2e-6)] for p in basis]
        missing = sum(not w for w in who)
        worst = 0.0
        for s in listed:
            true = (obj(folder / s["file"]) - neutral) * scale
            for v, w in enumerate(who):
                if w:
                    worst = max(worst, min(np.abs(true[o] - shapes[s["name"]][v]).max() for o in w))
        with tempfile.TemporaryDirectory() as away:
            again = pathlib.Path(away) / "again.glb"
            bpy.ops.export_scene.gltf(filepath=str(again), export_morph_normal=False)
            back, returned = load(again)
        same = list(returned) == list(shapes)
        reach = max(np.abs(d).max() for d in shapes.values())
        ends = max(abs(np.abs(returned[n]).max() - np.abs(shapes[n]).max()) for n in shapes)
        print(
            f"{path}: {len(shapes)} shape keys, names as listed {list(shapes) == [s['name'] for s in listed]}, "
            f"{len(basis)} vertices ({missing} without a place), largest motion {reach * 1e3:.2f} mm, "
            f"largest difference {worst * 1e6:.3f} um; exported and imported again: "
            f"names kept {same}, {len(back)} vertices, difference {ends * 1e6:.3f} um"
        )


main()
