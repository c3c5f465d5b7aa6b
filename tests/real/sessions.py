"""The real recordings of the data sets as sessions that `mien run --source` plays.

sessions.py DATA CACHE [film desk faces pcl]      (numpy, opencv-python-headless)

Each session is made once, under CACHE: film, film-depth (without the grey colour picture), desk, p00-0 to p05-8 (person and
pose), pcl-people, pcl-desk. Prints their names. The data sets' own scripts write all but the last two;
with FACES=own the faces are written at their camera's own size.
"""
import json
import os
import shutil
import subprocess
import sys

import cv2
import numpy as np

import depth_camera

PEOPLE = [f"p{i:02}" for i in range(6)]
POSES = range(9)
# A Kinect v1's focal length in its depth camera's own view, and in kinect_v1_pcl.
FOCAL_PX, PCL_FOCAL_PX = 575.8, 525.0
CENTRE = (319.5, 239.5)
# The zero-plane's nominal figures (mm), and no distance between the cameras: colour and depth of kinect_v1_pcl share a grid.
EMITTER, COLOUR, REFERENCE, PIXEL, SHIFT = 7.5, 0.0001, 120.0, 0.1042, 200
# Stills of the faces: neutral between the expressions.
ORDER = [2, 1, 0, 2, 3, 2, 4, 2, 5, 2]
PCL = {"pcl-people": ["five_people"], "pcl-desk": ["desk_000", "desk_001"]}
HELD = 30
OWN = os.environ.get("FACES") == "own"


def pcl(data, out, names):
    """Millimetres and colour on one grid -> raw depth and colour, enlarged to the depth camera's focal length; each picture is
    held for HELD frames, 30 a second."""
    zoom = FOCAL_PX / PCL_FOCAL_PX
    warp = np.array([[zoom, 0, CENTRE[0] * (1 - zoom)], [0, zoom, CENTRE[1] * (1 - zoom)]])
    index = []
    for name in names:
        mm = cv2.imread(f"{data}/kinect_v1_pcl/{name}_depth.png", -1).astype(np.float32)
        rgb = cv2.imread(f"{data}/kinect_v1_pcl/{name}_rgb.png")[..., ::-1]
        mm = cv2.warpAffine(mm, warp, (640, 480), flags=cv2.INTER_NEAREST)
        rgb = cv2.warpAffine(rgb, warp, (640, 480), flags=cv2.INTER_LINEAR)
        raw = 4 * (EMITTER * (1 - REFERENCE * 10 / np.maximum(mm, 1)) / PIXEL + SHIFT + 0.375)
        raw = np.where(mm > 0, raw.round().clip(0, 2047), 2047).astype("<u2")
        # Without a distance between the cameras, a colour pixel is the depth pixel + (1.375, 1).
        rgb = np.roll(rgb, (1, 1), (0, 1))
        first = {}
        for _ in range(HELD):
            n = len(index) // 2
            wall, ticks = 1500000000 + n / 30, 10_000_000 + n * 2_000_000
            for kind, file, body in (
                ("r", f"r-{wall:.6f}-{ticks}.ppm", b"P6 640 480 255 \n" + rgb.tobytes()),
                ("d", f"d-{wall + 0.001:.6f}-{ticks + 5000}.pgm", b"P5 640 480 65535\n" + raw.tobytes()),
            ):
                index.append(file)
                if kind in first:
                    os.link(first[kind], f"{out}/{file}")
                else:
                    first[kind] = f"{out}/{file}"
                    with open(first[kind], "wb") as f:
                        f.write(body)
    with open(f"{out}/INDEX.txt", "w") as f:
        f.write("\n".join(index) + "\n")
    zero = {"dcmos_emitter_distance": EMITTER, "dcmos_rcmos_distance": COLOUR, "reference_distance": REFERENCE,
            "reference_pixel_size": PIXEL}
    pad = {"start_lines": 0, "end_lines": 0, "cropping_lines": 0}
    with open(f"{out}/device.json", "w") as f:
        json.dump({"reg_info": {"pad_info": pad, "zero_plane_info": zero}, "const_shift": SHIFT}, f)


def script(data, folder, out, *words):
    subprocess.run([sys.executable, f"{data}/{folder}/to_session.py", out, *words], check=True, stdout=subprocess.DEVNULL)


def makers(data, part):
    """Name -> what writes that session into a folder."""
    if part == "film":
        return {"film": lambda out: script(data, "kinect_v1_film", out),
                "film-depth": lambda out: script(data, "kinect_v1_film", out, "--depth-only")}
    if part == "desk":
        return {"desk": lambda out: script(data, "kinect_v1_desk", out, "--hold", "6")}
    if part == "faces" and OWN:
        return {f"{p}-{k}": lambda out, p=p, k=k: depth_camera.session(f"{data}/kinect_v2_faces", out, p, k, ORDER)
                for p in PEOPLE for k in POSES}
    if part == "faces":
        return {f"{p}-{k}": lambda out, p=p, k=k: script(data, "kinect_v2_faces", out, "--person", p, "--pose", str(k))
                for p in PEOPLE for k in POSES}
    if part == "pcl":
        return {name: lambda out, names=names: pcl(data, out, names) for name, names in PCL.items()}
    sys.exit(f"REAL knows film, desk, faces and pcl, not {part}")


def main():
    data, cache = sys.argv[1:3]
    for part in sys.argv[3:]:
        whole = "camera.json" if part == "faces" and OWN else "INDEX.txt"
        for name, make in makers(data, part).items():
            to = f"{cache}/{name}"
            if not os.path.exists(f"{to}/{whole}"):
                # In a folder of its own first: what is cut off half way leaves nothing that looks whole.
                half = f"{to}.half-{os.getpid()}"
                shutil.rmtree(half, ignore_errors=True)
                os.makedirs(half)
                try:
                    make(half)
                    shutil.rmtree(to, ignore_errors=True)
                    os.rename(half, to)
                finally:
                    shutil.rmtree(half, ignore_errors=True)
            print(name)


if __name__ == "__main__":
    main()
