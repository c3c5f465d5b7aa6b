#!/usr/bin/env python3
"""depth_camera.py DATA OUT --person p00 [--pose 0..8] [--order …] [--first 60] [--hold 20] [--ending pgm|png]
`kinect_v2_faces` of the data sets as its own camera saw it: one person in one pose as a recording in the layout of the TUM RGB-D data
sets, 512x424, millimetres, the infra-red picture in grey, 30 a second; the stills, their order and `truth.csv` are those of the data
set's own to_session.py. Needs numpy and opencv-python. A still is one file, however often it is named."""
import argparse, csv, json, os, sys
import cv2
import numpy as np

# A Kinect v2: its infra-red picture is the depth camera's own.
CAMERA = {"depth": {"width": 512, "height": 424, "fx": 365.0, "fy": 365.0, "cx": 256.0, "cy": 212.0, "metres_per_unit": 0.001}}


def still(here, row):
    """Depth in millimetres, grey, and 15 points of one labelled still, where the face was about."""
    name = f"{here}/{row['person']}/%s_{int(row['index']):02d}.png"
    ir, mm = cv2.imread(name % "ir", -1).astype(np.float32), cv2.imread(name % "depth", -1)
    h, w = ir.shape
    x0, y0 = 256 - w // 2, 199 - h // 2
    depth, grey = np.zeros((424, 512), np.uint16), np.full((424, 512), 60, np.uint8)
    depth[y0:y0 + h, x0:x0 + w] = np.where(mm > 1500, 0, mm)
    grey[y0:y0 + h, x0:x0 + w] = np.clip(ir / np.percentile(ir, 98), 0, 1) ** .6 * 235
    points = np.array([float(v) for k, v in row.items() if k.endswith(("_x", "_y"))]).reshape(-1, 2) + [x0, y0]
    return depth, grey, points


def session(here, out, person, pose, order, first=60, hold=20, ending="pgm"):
    for folder in ("depth", "rgb"):
        os.makedirs(f"{out}/{folder}", exist_ok=True)
    with open(f"{here}/points.csv", newline="") as f:
        rows = {int(r["expression"]): r for r in csv.DictReader(f) if r["person"] == person and int(r["pose"]) == pose}
    lists, truth, n = {"depth": ["# depth maps"], "rgb": ["# infra-red"]}, [], 0
    for k, e in enumerate(order):
        depth, grey, points = still(here, rows[e])
        cv2.imwrite(f"{out}/depth/{e}.{ending}", depth)
        cv2.imwrite(f"{out}/rgb/{e}.{ending}", grey)
        count = first if k == 0 else hold
        truth.append([k, e, n, n + count] + [f"{v:.2f}" for v in points.ravel()])
        for n in range(n, n + count):
            for folder, late in (("rgb", 0), ("depth", .001)):
                lists[folder].append(f"{1500000000 + n / 30 + late:.6f} {folder}/{e}.{ending}")
        n += 1
    for folder, lines in lists.items():
        with open(f"{out}/{folder}.txt", "w") as f:
            f.write("\n".join(lines) + "\n")
    with open(f"{out}/camera.json", "w") as f:
        json.dump(CAMERA, f)
    with open(f"{out}/truth.csv", "w", newline="") as f:
        writer = csv.writer(f)
        writer.writerow("segment expression from to".split() + [f"{a}{i}" for i in range(15) for a in "xy"])
        writer.writerows(truth)


if __name__ == "__main__":
    a = argparse.ArgumentParser()
    a.add_argument("data")
    a.add_argument("out")
    a.add_argument("--person", required=True)
    a.add_argument("--pose", type=int, default=4)
    a.add_argument("--order", default="2,1,0,2,3,2,4,2,5,2")
    a.add_argument("--first", type=int, default=60)
    a.add_argument("--hold", type=int, default=20)
    a.add_argument("--ending", default="pgm")
    a = a.parse_args()
    if not os.path.exists(f"{a.data}/kinect_v2_faces/points.csv"):
        sys.exit(f"{a.data}: no kinect_v2_faces there")
    order = [int(e) for e in a.order.split(",")]
    session(f"{a.data}/kinect_v2_faces", a.out, a.person, a.pose, order, a.first, a.hold, a.ending)
