"""Whether what Blender makes of a baked GLB still has every shape: FBX and .blend by docs/examples/blender_convert.py, read back.

pip install bpy==5.0.1 && python carries_over.py FILE.glb

Of each file: the names of all shape keys, in order, and how far any vertex of any of them moves other than in the GLB, as a part
of the head's size; at most 1e-4.
"""
import pathlib
import sys
import tempfile

import bpy
import numpy as np
from mathutils.kdtree import KDTree

sys.path.insert(0, str(pathlib.Path(__file__).parents[2] / "docs/examples"))
import blender_convert as convert

MOST = 1e-4


def rows(key):
    out = np.empty(len(key.data) * 3, np.float32)
    key.data.foreach_get("co", out)
    return out.reshape(-1, 3)


def heads():
    """Places in the world, size, and motions of all shape keys by name, of everything that has some."""
    found = [o for o in bpy.data.objects if o.type == "MESH" and o.data.shape_keys]
    assert found, "no shape keys at all"
    # In the order of places: an importer may split and number objects as it likes.
    names = [k.name for k in found[0].data.shape_keys.key_blocks][1:]
    places, motions = [], {name: [] for name in names}
    for o in found:
        blocks = o.data.shape_keys.key_blocks
        assert [k.name for k in blocks][1:] == names, "the same names on every part"
        matrix = np.array(o.matrix_world)
        basis = rows(blocks[0])
        places.append(basis @ matrix[:3, :3].T + matrix[:3, 3])
        for name in names:
            motions[name].append((rows(blocks[name]) - basis) @ matrix[:3, :3].T)
    return np.concatenate(places), {n: np.concatenate(m) for n, m in motions.items()}


def compared(what, true, found):
    """The largest difference of a motion, each vertex against those of the GLB in its place."""
    (places, motions), (others, moved) = true, found
    size = np.ptp(places, axis=0).max()
    assert list(moved) == list(motions), f"{what}: names {sorted(set(motions) ^ set(moved))}"
    tree = KDTree(len(places))
    for v, p in enumerate(places):
        tree.insert(p, v)
    tree.balance()
    near = [[v for _, v, _ in tree.find_range(p, MOST * size)] for p in others]
    assert all(near), f"{what}: {sum(not n for n in near)} vertices where the GLB has none"
    worst = 0.0
    true_all = np.stack([motions[n] for n in motions], 1)
    found_all = np.stack([moved[n] for n in motions], 1)
    for v, some in enumerate(near):
        # Lips and lids touch: of several vertices in one place the one that moves alike in all shapes is meant.
        away = np.abs(true_all[some] - found_all[v]).max((1, 2))
        worst = max(worst, away.min())
    reach = max(np.abs(m).max() for m in moved.values())
    assert reach > 0.01 * size, f"{what}: nothing moves"
    share = worst / size
    print(f"{what}: {len(moved)} shape keys by the same names, {len(others)} vertices, largest difference {share:.1e} of the head")
    assert share <= MOST, f"{what}: {share}"


def main():
    glb = pathlib.Path(sys.argv[1])
    convert.imported(glb)
    bpy.context.view_layer.update()
    true = heads()
    with tempfile.TemporaryDirectory() as folder:
        fbx, blend = (pathlib.Path(folder) / f"head.{kind}" for kind in ("fbx", "blend"))
        convert.write(fbx)
        convert.write(blend)
        bpy.ops.wm.open_mainfile(filepath=str(blend))
        compared("blend", true, heads())
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.ops.import_scene.fbx(filepath=str(fbx))
        bpy.context.view_layer.update()
        compared("FBX", true, heads())


main()
