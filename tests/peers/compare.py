"""One table of mien and MediaPipe on the same frames.

compare.py MIEN TABLES RENDERINGS FACES WILD PORTRAITS      (mediapipe 0.10.21, numpy, OpenCV)

TABLES holds NAME.csv of `mien run`; RENDERINGS/NAME-FRAMES are sessions of the second world with truth.csv, FACES/pNN-P those of the
Kinect v2's stills, WILD/N those of `mien-studio evaluate --wild --record`, PORTRAITS a folder with landmarks68.csv, of which
`mien-studio fit` wrote TABLES/portraits.csv. Errors are in % of the distance between the outer eye corners, over frames in which both
report a face, as reported and with each method's own mean offset per point taken out, over all frames of a table and over each
scene's: the two place the same point of a face by different conventions. In the second world, points that are hidden do not count.
Jitter is the deviation of a still face's points. Times are a core's, of the process, the least of three runs and of all scenes: mien's
is all of it on recorded frames (reading them, pose, weights), MediaPipe's the mesh alone.
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


def meshed(paths, video=True):
    """Points by number or name of a picture, and seconds of this process a picture."""
    net = mediapipe.solutions.face_mesh.FaceMesh(static_image_mode=not video, max_num_faces=1, refine_landmarks=True)
    found, seconds, frames = {}, 0.0, 0
    for k, path in paths:
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


def followed(table):
    """Rows by frame, of the person reported most: somebody may stand behind."""
    faces = [r for r in score.Run(table).rows if r.face and r.state in score.REPORTED]
    users = [r.user for r in faces]
    most = max(set(users), key=users.count, default=None)
    return {r.frame: r for r in faces if r.user == most}


def reported(table):
    return {k: r.points() for k, r in followed(table).items()}


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


def landmarks(row, x, y):
    return np.array([[float(row[f"{x}{i}"]), float(row[f"{y}{i}"])] for i in range(68)])


def world(session, skip):
    """True points by frame, and which of them are to be seen: all where it is not said."""
    truth, seen = {}, {}
    for r in score.read(f"{session}/truth.csv"):
        k = int(r["frame"])
        if r.get("person", "0") == "0" and k >= skip:
            truth[k] = landmarks(r, "u", "v")
            seen[k] = np.array([r.get(f"vis{i}", "1") == "1" for i in range(68)])
    return truth, seen


def portraits(folder, fitted):
    """Points of mien, points of the peer, truth and which are seen, of the portraits of people that nothing was trained on."""
    rows = score.read(f"{folder}/landmarks68.csv")
    people = sorted({(r["set"], r["person"]) for r in rows})
    held_out = [r for r in rows if r["x0"] and people.index((r["set"], r["person"])) % 5 == 0]
    truth = {r["file"]: landmarks(r, "x", "y") for r in held_out}
    fits = {os.path.basename(r["file"]): landmarks(r, "x", "y") for r in score.read(fitted)}
    theirs, _ = meshed([(name, f"{folder}/img/{name}") for name in truth], video=False)
    return {name: fits[name] for name in truth}, theirs, truth, {name: np.ones(68, bool) for name in truth}


def table(scenes, regions):
    """Rows of scenes (name, mien's points, the peer's, truth, which points are seen): errors with one offset per point and method over
    all scenes out; in brackets, of several scenes, with the scene's own out."""
    print("| frames | mien reports | MediaPipe reports | as reported | " + " | ".join(name for name, _ in regions) + " |")
    print("| --- " * (4 + len(regions)) + "|")
    both = [[k for k in truth if k in mien and k in peer] for _, mien, peer, truth, _ in scenes]
    masks = [np.array([seen[k] for k in rows])[..., None] for rows, (*_, seen) in zip(both, scenes)]
    found = [[shifts(scene[of], scene[3], rows) for rows, scene in zip(both, scenes)] for of in (1, 2)]
    mean = lambda f, mask: (f * mask).sum(0) / np.maximum(mask.sum(0), 1)
    means = [mean(np.concatenate(f), np.concatenate(masks)) for f in found]
    bold = lambda value, other: f"**{value:.2f}**" if value < other else f"{value:.2f}"
    for n, (name, mien, peer, truth, _) in enumerate(scenes):
        own = [mean(f[n], masks[n]) for f in found]

        def errors(offsets, points):
            a, b = (np.nanmean(np.where(masks[n][..., 0], 100 * np.linalg.norm(f[n] - offset, axis=2), np.nan)[:, list(points)])
                    for f, offset in zip(found, offsets))
            return f"{bold(a, b)} / {bold(b, a)}"

        cells = [f"{100 * sum(k in points for k in truth) / len(truth):.1f} %" for points in (mien, peer)]
        cells.append(errors((0, 0), regions[0][1]))
        for _, points in regions:
            cells.append(errors(means, points) + (f" ({errors(own, points)})" if len(scenes) > 1 else ""))
        print(f"| {name} | " + " | ".join(cells) + " |")


def still(points, frames):
    known = np.array([points[k] for k in frames if k in points])
    if len(known) < 2:
        return "-"
    scale = np.linalg.norm(known.mean(0)[36] - known.mean(0)[45])
    return f"{100 * known[:, INNER].std(0).mean() / scale:.2f} %"


def main():
    mien, tables, renderings, faces, wild, folder = sys.argv[1:]
    regions = [("all but the contour", INNER), *REGIONS.items()]
    print("Error in % of the outer-eye distance, mien / MediaPipe, after removing mean offsets over all frames of the table;"
          " in brackets those of each scene: how accurately motion is tracked.\n")
    costs, jitter, scenes = [], None, []
    for name in os.environ["SCENES"].split():
        session, = glob.glob(f"{renderings}/{name}-[0-9]*")
        truth, seen = world(session, SKIP.get(name, SKIP_OTHERS))
        ours, (theirs, seconds) = reported(f"{tables}/{name}.csv"), meshed(pictures(session))
        costs.append(seconds)
        scenes.append((f"second world, {name}", ours, theirs, truth, seen))
        if name == "static":
            jitter = still(ours, truth), still(theirs, truth)
    table(scenes, regions)
    print()
    scenes = []
    for session in sorted(glob.glob(f"{wild}/*"), key=lambda session: int(os.path.basename(session))):
        number = os.path.basename(session)
        ours, theirs = reported(f"{tables}/wild{number}.csv"), meshed(pictures(session))[0]
        scenes.append((f"own wild scenes, person {number}", ours, theirs, *world(session, SKIP_OTHERS)))
    table(scenes, regions)
    print()
    table([("portraits of people held out", *portraits(folder, f"{tables}/portraits.csv"))], regions)
    # Real faces: each still is held for some frames, and judged in the last; its 15 points come from both.
    sheets = [{}, {}, {}, {}]
    for of in sorted(glob.glob(f"{tables}/p[0-9][0-9]-[0-9].csv")):
        name = os.path.basename(of)[:-4]
        found = [reported(of), meshed(pictures(f"{faces}/{name}"))[0]]
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
    ours = []
    for _ in range(3):  # Less is less disturbed; the first time files come from the disk.
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([mien, "run", "--source", longest, "--fast", "--csv", "/dev/null"], check=True, capture_output=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        ours.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    ours = min(ours) / len(list(pictures(longest)))
    print(f"\nProcessor time a frame: mien {1e3 * ours:.2f} ms with reading the frames, MediaPipe {1e3 * min(costs):.2f} ms for the mesh alone."
          + (f" A still face's points jitter by {jitter[0]} and {jitter[1]}." if jitter else ""))


if __name__ == "__main__":
    main()
