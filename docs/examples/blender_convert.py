"""A baked head into other programs' files by way of Blender: FBX and USD for engines and for Maya, .blend for Blender itself.

blender --background --python blender_convert.py -- head.glb head.fbx      (or head.usdc, head.usda, head.blend; several, as you like)
pip install bpy==5.0.1 && python blender_convert.py head.glb head.fbx head.blend

Every shape key keeps its name, at 0; unit and axes are those of the kind of file. An animation comes along, at 30 frames a second.
"""
import math
import pathlib
import sys

import bpy


def imported(path):
    """The head with its shape keys, each vertex as the file has it."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    # The sensor's rate: each of its frames is one of Blender's.
    scene.render.fps = 30
    bpy.ops.import_scene.gltf(filepath=str(path), merge_vertices=False)
    ends = [action.frame_range[1] for action in bpy.data.actions]
    scene.frame_start, scene.frame_end = 0, math.ceil(max(ends, default=0))


def write(path):
    # Blender looks for a folder from where it was started only if it is told all of it.
    path = pathlib.Path(path).resolve()
    kind = path.suffix.lower()
    if kind == ".blend":
        # Pictures of the GLB travel inside the file.
        bpy.ops.file.pack_all()
        bpy.ops.wm.save_as_mainfile(filepath=str(path), check_existing=False)
    elif kind == ".fbx":
        bpy.ops.export_scene.fbx(
            filepath=str(path),
            # Modifiers that are applied take the shape keys with them.
            use_mesh_modifiers=False,
            add_leaf_bones=False,
            path_mode="COPY",
            embed_textures=True,
            bake_anim=bool(bpy.data.actions),
            # Export the scene's full frame range: rounding may end an action just before its last frame, which would be lost.
            bake_anim_use_nla_strips=False,
            bake_anim_use_all_actions=False,
        )
    elif kind in (".usdc", ".usda"):
        bpy.ops.wm.usd_export(filepath=str(path), export_shapekeys=True, export_animation=bool(bpy.data.actions))
    else:
        sys.exit(f"{path.name}: expected a name that ends in .fbx, .usdc, .usda or .blend")


if __name__ == "__main__":
    words = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    if len(words) < 2:
        sys.exit("expected a .glb and what to make of it: head.glb head.fbx head.blend")
    imported(words[0])
    for name in words[1:]:
        write(name)
