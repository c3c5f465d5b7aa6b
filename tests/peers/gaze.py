"""Gaze of real people: the map in config/units.toml beside MediaPipe's irises on the same pictures.

gaze.py STUDIO DATA SCRATCH      (mediapipe 0.10.21, numpy, OpenCV)

Pictures have no depth, so landmarks come from `mien-studio fit`, and the eyes are cut and read here as in `landmarks/eyes.rs` and
`expression/gaze.rs`. MediaPipe's gaze is how far irises lie from the midpoint between the eye corners. The head's turn, as its
mesh gives it, is regressed out of both before they are correlated, which leaves the motion of the eyes alone. Closed eyes and
faces turned more than 30° to a side are left out.
"""
import csv
import os
import subprocess
import sys
import tomllib

import cv2
import mediapipe
import numpy as np

ACROSS, DOWN, EXTENT = 16, 9, (1.1, 0.7)
# Iris, corners, lids of the right and of the left eye in the mesh; ears, forehead and chin.
EYES = ((468, 33, 133, 159, 145), (473, 362, 263, 386, 374))
EARS, UPRIGHT = (234, 454), (10, 152)
OPEN, TURNED = 0.18, 0.5


def cells(grey, points):
    """Both eyes of a picture, normalised; None if they are too small or too plain."""
    corners = [(points[36], points[39]), (points[45], points[42])]
    middles = [(a + b) / 2 for a, b in corners]
    width = np.mean([np.hypot(*(b - a)) for a, b in corners])
    line = middles[1] - middles[0]
    axis, out = line / np.hypot(*line), []
    if width < 15:
        return None
    for middle, to_nose in zip(middles, (1, -1)):
        along = lambda n, extent: ((np.arange(2 * n) + 0.5) / (2 * n) - 0.5) * extent * width
        x, y = to_nose * along(ACROSS, EXTENT[0])[None, :], along(DOWN, EXTENT[1])[:, None]
        at = (middle[i] + x * axis[i] + y * (-axis[1], axis[0])[i] for i in (0, 1))
        eye = cv2.remap(grey, *(part.astype(np.float32) for part in at), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        eye = eye.reshape(DOWN, 2, ACROSS, 2).mean((1, 3)).ravel()
        if eye.std() < 2:
            return None
        out.append((eye - eye.mean()) / eye.std())
    return out


def irises(mesh):
    """Gaze to the subject's left and up, in eye widths, summed over both eyes; how open the less open eye is; the head's turn."""
    looks, gaps = np.zeros(2), []
    for iris, a, b, upper, lower in EYES:
        axis = mesh[b, :2] - mesh[a, :2]
        width = np.hypot(*axis)
        off = mesh[iris, :2] - (mesh[a, :2] + mesh[b, :2]) / 2
        looks += np.array([off @ axis, off @ (axis[1], -axis[0])]) / width**2
        gaps.append(np.hypot(*(mesh[upper, :2] - mesh[lower, :2])) / width)
    across, down = mesh[EARS[1]] - mesh[EARS[0]], mesh[UPRIGHT[1]] - mesh[UPRIGHT[0]]
    ahead = np.cross(across, down)
    return looks, min(gaps), (ahead / np.linalg.norm(ahead))[:2]


def own(values, turns):
    """The values with the head's turn regressed out."""
    turns = np.column_stack([turns, np.ones(len(turns))])
    return values - turns @ np.linalg.lstsq(turns, values, rcond=None)[0]


def main(studio, data, scratch):
    with open("config/units.toml", "rb") as f:
        gaze = tomllib.load(f)["gaze"]
    left, up = (np.array(gaze[name][:-1]) for name in ("left", "up"))
    print("\nGaze of real people against MediaPipe's irises, after removing the head's rotation from both:\n")
    print("| pictures | seen by both | correlation, horizontal | vertical |\n| --- | --- | --- | --- |")
    for what, folder, video in (("a video of one person talking", "video_talkingface/img", True),
                                ("stills of 205 people", "faces_ytfaces68", False)):
        folder, boxes, table = f"{data}/{folder}", f"{scratch}/boxes.csv", f"{scratch}/fit.csv"
        below = folder if video else f"{folder}/img"
        net = mediapipe.solutions.face_mesh.FaceMesh(static_image_mode=not video, refine_landmarks=True, min_detection_confidence=0.3)
        meshes = {}
        for name in sorted(os.listdir(below)):
            picture = cv2.imread(f"{below}/{name}")
            high, wide = picture.shape[:2]
            large = picture if video else cv2.resize(picture, None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC)
            found = net.process(cv2.cvtColor(large, cv2.COLOR_BGR2RGB)).multi_face_landmarks
            if found:
                meshes[name] = np.array([[p.x * wide - 0.5, p.y * high - 0.5, p.z * wide] for p in found[0].landmark])
        given = []
        if video:
            with open(boxes, "w") as f:
                f.write("file,x,y,w,h\n")
                for name, mesh in meshes.items():
                    x, x1, y, y1 = mesh[:, 0].min(), mesh[:, 0].max(), np.median(mesh[[105, 334], 1]), mesh[:, 1].max()
                    f.write(f"{name},{x:.1f},{y:.1f},{x1 - x:.1f},{y1 - y:.1f}\n")
            given = ["--boxes", boxes]
        subprocess.run([studio, "fit", "--model", "config/face.model", "--images", folder, *given, "--out", table], check=True,
                       stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        read, seen, turns = [], [], []
        with open(table) as f:
            for row in csv.DictReader(f):
                name = os.path.basename(row["file"])
                if name not in meshes:
                    continue
                points = np.array([[float(row[f"x{i}"]), float(row[f"y{i}"])] for i in range(68)])
                eyes = cells(cv2.imread(f"{below}/{name}", cv2.IMREAD_GRAYSCALE), points)
                looks, gap, turn = irises(meshes[name])
                if eyes is not None and gap > OPEN and abs(turn[0]) < TURNED:
                    read.append([left @ (eyes[1] - eyes[0]), up @ (eyes[1] + eyes[0])])
                    seen.append(looks)
                    turns.append(turn)
        read, seen = own(np.array(read), turns), own(np.array(seen), turns)
        r = [np.corrcoef(read[:, k], seen[:, k])[0, 1] for k in (0, 1)]
        print(f"| {what} | {len(read)} | {r[0]:.2f} | {r[1]:.2f} |")


main(*sys.argv[1:4])
