"""What OpenUSD itself sees in a baked .usda: valid, with the unit, axis, polygons, names and motions of the files beside it.

python check.py FILE.usda OBJ_FOLDER FILE.glb      (usd-core and numpy; tests/usd/run gets them)

OBJ_FOLDER is what the same bake wrote with --obj, FILE.glb what it wrote with --out of that name. UsdSkel itself moves the
points, for three shapes at a weight of 1, for all of them as its queries do it, and with the head's joint turned.
"""
import json
import math
import pathlib
import struct
import sys

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdShade, UsdSkel, UsdValidation, Vt

# Of the head's unit: what single precision leaves of a sum of coordinates up to 30.
CLOSE = 1e-5


def obj(path):
    """Places of an OBJ file and its text; a colour may follow a place."""
    text = pathlib.Path(path).read_text()
    lines = [line for line in text.split("\n") if line.startswith("v ")]
    return np.loadtxt(lines, usecols=(1, 2, 3)), text


def glb_names(path):
    data = pathlib.Path(path).read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    return json.loads(data[20 : 20 + length])["meshes"][0]["extras"]["targetNames"]


def apart(found, true):
    found = np.array(found)
    assert found.shape == true.shape, (found.shape, true.shape)
    return np.abs(found - true).max()


def opened(path):
    # Layers are shared between stages; what one test writes stays in a session of its own.
    return Usd.Stage.Open(path, Usd.Stage.LoadAll)


def weighted(path, name):
    """Points of the mesh with one shape at 1, moved and written down by UsdSkel."""
    stage = opened(path)
    stage.SetEditTarget(stage.GetSessionLayer())
    weights = UsdSkel.Animation.Get(stage, "/head/weights")
    names = list(weights.GetBlendShapesAttr().Get())
    weights.GetBlendShapeWeightsAttr().Set([float(n == name) for n in names])
    assert UsdSkel.BakeSkinning(Usd.PrimRange(stage.GetDefaultPrim()))
    return UsdGeom.Mesh.Get(stage, "/head/face").GetPointsAttr().Get(Usd.TimeCode.EarliestTime())


def main():
    path, folder, glb = sys.argv[1], pathlib.Path(sys.argv[2]), sys.argv[3]
    listed = json.load(open(folder / "shapes.json"))["shapes"]
    neutral, text = obj(folder / "neutral.obj")
    stage = opened(path)

    registry = UsdValidation.ValidationRegistry()
    errors = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators()).Validate(stage)
    # Damage is found: a mesh bound to a skeleton that says nothing of it.
    damaged = Usd.Stage.CreateInMemory()
    UsdSkel.BindingAPI(UsdGeom.Mesh.Define(damaged, "/a").GetPrim()).CreateSkeletonRel()
    context = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators())
    assert context.Validate(damaged), "the validators find nothing in a damaged stage"
    assert not errors, [f"{e.GetName()}: {e.GetMessage()}" for e in errors]

    assert UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y
    metres = np.ptp(neutral[:, 1]) * UsdGeom.GetStageMetersPerUnit(stage)
    assert 0.1 < metres < 1.0, f"a head {metres} m tall"

    mesh = UsdGeom.Mesh.Get(stage, "/head/face")
    assert apart(mesh.GetPointsAttr().Get(), neutral) <= CLOSE
    ends = iter(mesh.GetFaceVertexIndicesAttr().Get())
    kept = [[next(ends) for _ in range(n)] for n in mesh.GetFaceVertexCountsAttr().Get()]
    faces = [line.split()[1:] for line in text.split("\n") if line.startswith("f ")]
    faces = [[int(corner.split("/")[0]) - 1 for corner in face] for face in faces]
    assert kept == faces, "polygons as in the OBJ file"
    material = UsdShade.MaterialBindingAPI(mesh.GetPrim())
    parts = material.GetMaterialBindSubsets() or [mesh]
    bound = [UsdShade.MaterialBindingAPI(p.GetPrim()).ComputeBoundMaterial()[0] for p in parts]
    assert all(bound), "a material everywhere"
    # Skin with a picture is white beneath it; where plain skin meets it, the plain one keeps its colour.
    shown = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("displayColor")
    colours = np.array(shown.ComputeFlattened())
    if shown.GetInterpolation() == "vertex":
        colours = colours[mesh.GetFaceVertexIndicesAttr().Get()]
    starts = np.cumsum([0] + [len(face) for face in faces])
    (plain,) = (p for p in parts if p.GetPrim().GetName() == "skin_behind")
    plain = [colours[starts[f] : starts[f + 1]] for f in plain.GetIndicesAttr().Get()]
    assert np.concatenate(plain).max() < 0.8, "plain skin as white as the pictured one"

    names = [s["name"] for s in listed]
    assert names == glb_names(glb), "names of the glTF targets"
    binding = UsdSkel.BindingAPI(mesh.GetPrim())
    assert list(binding.GetBlendShapesAttr().Get()) == names
    query = UsdSkel.BlendShapeQuery(binding)
    assert query.GetNumBlendShapes() == len(names)
    prims = [query.GetBlendShape(k).GetPrim().GetName() for k in range(len(names))]
    assert prims == names, "all of them are identifiers"

    # Every shape, as UsdSkel resolves it.
    worst, rows = 0.0, 0
    indices, offsets = query.ComputeBlendShapePointIndices(), query.ComputeSubShapePointOffsets()
    for k, shape in enumerate(listed):
        weights = Vt.FloatArray([float(n == shape["name"]) for n in names])
        subs = query.ComputeSubShapeWeights(weights)
        points = Vt.Vec3fArray(mesh.GetPointsAttr().Get())
        assert query.ComputeDeformedPoints(*subs, indices, offsets, points)
        worst = max(worst, apart(points, obj(folder / shape["file"])[0]))
        prim = query.GetBlendShape(k)
        if prim.GetPointIndicesAttr().HasAuthoredValue():
            both = [prim.GetOffsetsAttr().Get(), prim.GetNormalOffsetsAttr().Get() or []]
            moved = sum(np.abs(np.reshape(d, (-1, 3))).sum(1) for d in both if len(d))
            assert np.all(moved > 0), f"{shape['name']}: points that do not move"
        rows += len(indices[k])
    assert worst <= CLOSE, worst

    # Three as a renderer gets them, and the neutral face, which must not be one of them.
    for name in ("jawOpen", "eyeBlinkLeft", "mouthSmileRight"):
        true = obj(folder / f"{name}.obj")[0]
        found = weighted(path, name)
        assert apart(found, true) <= CLOSE, (name, apart(found, true))
        assert apart(found, neutral) > 100 * CLOSE, f"{name} moves nothing"

    # The joint in the middle of the head carries all of it.
    skeleton = UsdSkel.Skeleton.Get(stage, "/head/skeleton")
    middle = np.array(skeleton.GetRestTransformsAttr().Get()[0].ExtractTranslation())
    stage.SetEditTarget(stage.GetSessionLayer())
    run = UsdSkel.Animation.Get(stage, "/head/weights")
    run.CreateJointsAttr(["head"])
    run.CreateTranslationsAttr([Gf.Vec3f(*middle)])
    run.CreateScalesAttr([Gf.Vec3h(1)])
    half = math.radians(20) / 2
    run.CreateRotationsAttr([Gf.Quatf(math.cos(half), 0, math.sin(half), 0)])
    assert UsdSkel.BakeSkinning(Usd.PrimRange(stage.GetDefaultPrim()))
    # What one joint carries as a whole is moved by its transform.
    now = Usd.TimeCode.EarliestTime()
    places = mesh.GetPointsAttr().Get(now)
    placed = np.array(mesh.ComputeLocalToWorldTransform(now))
    turned = np.column_stack([places, np.ones(len(places))]) @ placed
    cos, sin = math.cos(math.radians(20)), math.sin(math.radians(20))
    x, y, z = (neutral - middle).T
    true = np.column_stack([cos * x + sin * z, y, cos * z - sin * x]) + middle
    # Translations and rotations are in single precision too.
    assert apart(turned[:, :3], true) <= 5 * CLOSE, apart(turned[:, :3], true)
    print(
        f"{path}: valid, {len(neutral)} points, {len(faces)} polygons, {len(parts)} materials, {metres:.3f} m tall, {len(names)} shapes"
        f" by the names of the GLB, {rows} offsets; points of every shape within {worst:.1e} of the OBJ files' (unit of the head)"
    )


main()
