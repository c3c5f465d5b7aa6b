"""One table of mien and MediaPipe on the same frames.

compare.py MIEN TABLES RENDERINGS FACES      (mediapipe 0.10.21, numpy, OpenCV)

TABLES holds NAME.csv of `mien run`; RENDERINGS/NAME-FRAMES are sessions of the second world with truth.csv, FACES/pNN-P those of the
Kinect v2's stills. Errors are in % of the distance between the outer eye corners, over frames in which both report a face, as
reported (in brackets) and with each method's own mean offset per point, over all frames of a table, taken out: the two place the same
point of a face by different conventions. In the second world, points that are hidden do not count. Jitter is the deviation of a still face's points.
Times are a core's, of the process: mien's is all of it on recorded frames (reading them, pose, weights), MediaPipe's the mesh alone.
"""
import csv
import glob
import os
import resource
import subprocess
import sys
import time

import cv2
import mediapipe
import numpy as np

sys.path.insert(0, os.path.join(os.path.dirname(__file__), "../real"))
import score

# Vertices of the mesh in the order of the 68.
MESH = [162, 234, 93, 58, 172, 136, 149, 148, 152, 377, 378, 365, 397, 288, 323, 454, 389, 71, 63, 105, 66, 107, 336, 296, 334, 293, 301,
        168, 197, 5, 4, 75, 97, 2, 326, 305, 33, 160, 158, 133, 153, 144, 362, 385, 387, 263, 373, 380, 61, 39, 37, 0, 267, 269, 291, 405,
        314, 17, 84, 181, 78, 82, 13, 312, 308, 317, 14, 87]
REGIONS = {"brows": range(17, 27), "nose": range(27, 36), "eyes": range(36, 48), "outer lips": range(48, 60), "inner lips": range(60, 68)}
# The contour is a silhouette to one and fixed points of the head to the other.
INNER = range(17, 68)
# Frames at the start of a scene that its scorer leaves out too.
SKIP = {"hairy": 300, "person1": 300, "person2": 300, "person3": 300, "person4": 300, "person5": 300, "person6": 300}
SKIP_OTHERS = 30


def pictures(session):
    """Number of a depth frame and the colour picture nearest in ticks."""
    names = open(f"{session}/INDEX.txt").read().split()
    at = lambda name: int(name.rsplit("-", 1)[1].split(".")[0])
    colours = [n for n in names if n.startswith("r-")]
    ticks = np.array([at(n) for n in colours])
    for k, depth in enumerate(n for n in names if n.startswith("d-")):
        yield k, f"{session}/{colours[np.abs(ticks - at(depth)).argmin()]}"


def meshed(session):
    """Points by frame, and seconds of this process a frame."""
    net = mediapipe.solutions.face_mesh.FaceMesh(static_image_mode=False, max_num_faces=1, refine_landmarks=True)
    found, seconds, frames, last = {}, 0.0, 0, None
    for k, path in pictures(session):
        picture = cv2.cvtColor(cv2.imread(path), cv2.COLOR_BGR2RGB)
        start = time.process_time()
        faces = net.process(picture).multi_face_landmarks
        seconds, frames = seconds + time.process_time() - start, frames + 1
        if faces:
            high, wide = picture.shape[:2]
            all_points = faces[0].landmark
            found[k] = np.array([[all_points[v].x * wide - 0.5, all_points[v].y * high - 0.5] for v in MESH])
    net.close()
    return found, seconds / max(frames, 1)


def reported(table):
    """Points by frame, of the first person."""
    run = score.Run(table)
    first = run.slots[0] if run.slots else None
    return {r.frame: r.points() for r in run.rows if r.user == first and r.face and r.state in score.REPORTED}


def shifts(points, truth, rows):
    """Of every point in the face's own axes, in outer-eye distances."""
    out = []
    for k in rows:
        right, left = (truth[k][i] for i in EYES[truth[k].shape[0]])
        scale = np.linalg.norm(left - right)
        axis = (left - right) / scale
        out.append((points[k] - truth[k]) @ np.array([axis, [-axis[1], axis[0]]]).T / scale)
    return np.array(out)


EYES = {68: (36, 45), 15: (score.RIGHT_EYE, score.LEFT_EYE)}


def world(session, skip):
    truth, seen = {}, {}
    with open(f"{session}/truth.csv") as f:
        for r in csv.DictReader(f):
            k = int(r["frame"])
            if r["person"] == "0" and k >= skip:
                truth[k] = np.array([[float(r[f"u{i}"]), float(r[f"v{i}"])] for i in range(68)])
                seen[k] = np.array([r[f"vis{i}"] == "1" for i in range(68)])
    return truth, seen


def table(scenes, regions):
    """Rows of scenes (name, mien's points, the peer's, truth, which points are seen), with one offset per point and method over all."""
    print("| frames | mien reports | MediaPipe reports | " + " | ".join(name for name, _ in regions) + " |")
    print("| --- " * (3 + len(regions)) + "|")
    both = [[k for k in truth if k in mien and k in peer] for _, mien, peer, truth, _ in scenes]
    masks = [np.array([seen[k] for k in rows]) for rows, (*_, seen) in zip(both, scenes)]
    found = [[shifts(scene[of], scene[3], rows) for rows, scene in zip(both, scenes)] for of in (1, 2)]
    everywhere = np.concatenate(masks)[..., None]
    means = [(np.concatenate(f) * everywhere).sum(0) / np.maximum(everywhere.sum(0), 1) for f in found]
    for n, (name, mien, peer, truth, _) in enumerate(scenes):
        cells = [f"{100 * sum(k in points for k in truth) / len(truth):.1f} %" for points in (mien, peer)]
        for _, points in regions:
            errors = []
            for f, mean in zip(found, means):
                for shift in (f[n] - mean, f[n]):
                    length = np.where(masks[n], 100 * np.linalg.norm(shift, axis=2), np.nan)
                    errors.append(np.nanmean(length[:, list(points)]))
            a, plain_a, b, plain_b = errors
            bold = lambda value, other: f"**{value:.2f}**" if value < other else f"{value:.2f}"
            cells.append(f"{bold(a, b)} / {bold(b, a)} ({plain_a:.2f} / {plain_b:.2f})")
        print(f"| {name} | " + " | ".join(cells) + " |")


def still(points, frames):
    known = np.array([points[k] for k in frames if k in points])
    if len(known) < 2:
        return "-"
    scale = np.linalg.norm(known.mean(0)[36] - known.mean(0)[45])
    return f"{100 * known[:, INNER].std(0).mean() / scale:.2f} %"


def main():
    mien, tables, renderings, faces = sys.argv[1:]
    regions = [("all but the contour", INNER), *REGIONS.items()]
    print("Error in % of the outer-eye distance, mien / MediaPipe, offsets taken out (and as reported).\n")
    costs, jitter, scenes = [], None, []
    for name in os.environ["SCENES"].split():
        session, = glob.glob(f"{renderings}/{name}-[0-9]*")
        truth, seen = world(session, SKIP.get(name, SKIP_OTHERS))
        ours, (theirs, seconds) = reported(f"{tables}/{name}.csv"), meshed(session)
        costs.append(seconds)
        scenes.append((f"second world, {name}", ours, theirs, truth, seen))
        if name == "static":
            jitter = still(ours, truth), still(theirs, truth)
    table(scenes, regions)
    # Real faces: each still is held for some frames, and judged in the last; its 15 points come from both.
    sheets = [{}, {}, {}, {}]
    for of in sorted(glob.glob(f"{tables}/p[0-9][0-9]-[0-9].csv")):
        name = os.path.basename(of)[:-4]
        found = [reported(of), meshed(f"{faces}/{name}")[0]]
        for held in score.read(f"{faces}/{name}/truth.csv"):
            end = int(held["to"]) - 1
            sheets[2][name, end] = np.array([[float(held[f"{a}{i}"]) for a in "xy"] for i in range(15)])
            sheets[3][name, end] = np.ones(15, bool)
            for sheet, points in zip(sheets, found):
                if end in points:
                    sheet[name, end] = np.array([points[end][ids].mean(0) for ids in score.POINTS])
    if sheets[2]:
        print()
        table([("six real faces, infrared", *sheets)], [("all 15 points", range(15)), ("nose", range(8, 11)), ("eyes", range(8)), ("lips", range(11, 15))])
    longest = max(glob.glob(f"{renderings}/{os.environ['SCENES'].split()[0]}-[0-9]*"))
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([mien, "run", "--source", longest, "--fast", "--csv", "/dev/null"], check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    ours = (after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime) / len(list(pictures(longest)))
    print(f"\nProcessor time a frame: mien {1e3 * ours:.2f} ms with reading the frames, MediaPipe {1e3 * np.median(costs):.2f} ms for the mesh alone."
          + (f" A still face's points jitter by {jitter[0]} and {jitter[1]}." if jitter else ""))


main()
