"""Weights of mien beside MediaPipe's blendshapes on the same frames, against the acted expressions.

weights.py MODEL ACTIVATIONS FACES TABLES SCENE=SESSION=RUN.csv=SKIP...      (mediapipe 0.10.21, numpy, OpenCV)

MODEL is face_landmarker_v2.task, run in video mode for one face; ACTIVATIONS the second world's activations.py, which says what expressions
make a unit. Each SESSION has a truth.csv with acted expressions by their ICT names; its first SKIP frames are left out. FACES/pNN-P
are the Kinect v2's stills, with TABLES/pNN-P.csv of `mien run`. Figures are of frames in which both report a face, and of units
that both give. MediaPipe's unit is the mean of the blendshapes that have the names of the unit's expressions; one that has no sides is both.
"""
import glob
import os
import re
import sys

import cv2
import mediapipe
import numpy as np
from mediapipe.tasks.python import BaseOptions, vision

import compare
import score

# A unit that MediaPipe moves by less than this (standard deviation) in every scene is one it does not give.
MOVES = 0.005
# An expression is acted if its largest is above the first and its deviation above the second; below the third it rests, for which so
# many frames are needed; above the last, in parts of its largest, it is full.
ACTED, VARIES, RESTS, FEWEST, FULL = 0.3, 0.02, 0.03, 20, 0.8
# Gain says nothing about a weight that does not follow; sides are compared where their difference deviates by this.
FOLLOWS, SIDES = 0.7, 0.03
TICKS_PER_MS = 60_000


def blendshapes(model, session):
    """MediaPipe's categories by frame."""
    options = vision.FaceLandmarkerOptions(base_options=BaseOptions(model_asset_path=model), output_face_blendshapes=True,
                                           running_mode=vision.RunningMode.VIDEO, num_faces=1)
    found, first, last = {}, None, -1
    with vision.FaceLandmarker.create_from_options(options) as net:
        for k, path in compare.pictures(session):
            ticks = int(path.rsplit("-", 1)[1].split(".")[0])
            first = ticks if first is None else first
            # It wants times that rise, and one picture may be the nearest of two depth frames.
            last = max(last + 1, (ticks - first) % 2**32 // TICKS_PER_MS)
            picture = cv2.cvtColor(cv2.imread(path), cv2.COLOR_BGR2RGB)
            faces = net.detect_for_video(mediapipe.Image(image_format=mediapipe.ImageFormat.SRGB, data=picture), last).face_blendshapes
            if faces:
                found[k] = {c.category_name: c.score for c in faces[0]}
    return found


def theirs(shapes, expressions):
    """The unit of these expressions; NaN if they have none."""
    def shape(name):
        base, _, side = name.partition("_")
        return shapes.get(base + {"L": "Left", "R": "Right", "": ""}[side], shapes.get(base, np.nan))
    return np.mean([shape(name) for name in expressions])


def correlation(a, b):
    return np.corrcoef(a, b)[0, 1] if min(a.std(), b.std()) > 1e-6 else 0.0


def figures(truth, weights):
    """Correlation, gain and rest of one unit; NaN where the scene does not show it."""
    acted, quiet, full = truth.max() > ACTED and truth.std() > VARIES, truth < RESTS, truth > FULL * truth.max()
    r = correlation(truth, weights) if acted else np.nan
    return {"r": r, "gain": np.median(weights[full]) if r >= FOLLOWS else np.nan,
            "rest": np.percentile(weights[quiet], 95) if quiet.sum() >= FEWEST else np.nan}


def judged(units, acted, both):
    """Unit -> how far MediaPipe moves it, and figures of (mien, MediaPipe); left minus right stands with the left."""
    out = {}
    for unit in (u for u in units if not np.isnan(both[u]).any()):
        truth, right = acted[unit], unit[:-1] + "R"
        pair = [figures(truth, weights) for weights in both[unit]]
        of = {key: np.array([each[key] for each in pair]) for key in pair[0]}
        of.update(moves=both[unit][1].std(), full=np.median(truth[truth > FULL * truth.max()]) if truth.any() else 0.0, sides=np.full(2, np.nan))
        # A jaw that shifts (AU30) is one thing, and a blendshape without sides says nothing of them.
        if unit.endswith("L") and unit != "AU30L" and (truth - acted[right]).std() > SIDES and (both[unit] != both[right]).any(1)[1]:
            of["sides"] = np.array([correlation(truth - acted[right], d) for d in both[unit] - both[right]])
        out[unit] = of
    return out


def scene(units, model, session, run, skip):
    """Shares of frames with a face (mien, MediaPipe), and what `judged` gives."""
    rows = {int(r["frame"]): r for r in score.read(f"{session}/truth.csv") if r.get("person", "0") == "0" and int(r["frame"]) >= skip}
    ours, shapes = compare.followed(run), blendshapes(model, session)
    # A face that is reported has no weights before it is measured.
    at = [k for k in rows if k in ours and k in shapes and ours[k].values["w_AU26"]]
    acted = {u: np.array([np.mean([float(rows[k][e]) for e in of]) for k in at]) for u, of in units.items()}
    both = {u: np.array([[float(ours[k].values.get(f"w_{u}") or np.nan), theirs(shapes[k], of)] for k in at]).T for u, of in units.items()}
    return [np.mean([k in found for k in rows]) for found in (ours, shapes)], judged(units, acted, both) if at else {}


def mean(values, both=True):
    """Of the pairs that are known to both, or of what each knows."""
    known = np.array([np.full(2, np.nan), *values])
    if both:
        known[np.isnan(known).any(1)] = np.nan
    counts = (~np.isnan(known)).sum(0)
    return np.where(counts, np.nansum(known, axis=0) / np.maximum(counts, 1), np.nan)


def cell(pair, more=True):
    """mien / MediaPipe, the better in bold if more or less (False) is better."""
    text = ["-" if np.isnan(v) else f"{v:.2f}" for v in pair]
    if more is not None and text[0] != text[1] and "-" not in text:
        better = int((pair[1] > pair[0]) == more)
        text[better] = f"**{text[better]}**"
    return text[0] if text == ["-", "-"] else " / ".join(text)


def scenes_table(scenes, given):
    print("| scene | faces, mien / MediaPipe | units | correlation | mien is ahead in | rest: median unit | loudest unit | weight at full act "
          "| left minus right |")
    print("| --- " * 9 + "|")
    for name, shares, found in scenes:
        these = [found[u] for u in given if u in found]
        r, rest = ([f[key] for f in these if not np.isnan(f[key]).any()] for key in ("r", "rest"))
        middle, loudest = (np.median(rest, axis=0), np.max(rest, axis=0)) if rest else np.full((2, 2), np.nan)
        print(f"| {name} | {100 * shares[0]:.1f} % / {100 * shares[1]:.1f} % | {len(r)} | {cell(mean(r))} | {sum(a > b for a, b in r)} | "
              f"{cell(middle, False)} | {cell(loudest, False)} | "
              f"{cell(mean([f['gain'] for f in these], both=False), None)} | {cell(mean([f['sides'] for f in these]))} |")


def units_table(title, scenes, given):
    print(f"\n{title}\n\n| unit | scenes | correlation | rest | weight at full act | acted | left minus right |")
    print("| --- " * 7 + "|")
    behind = []
    for unit in given:
        found = [of[unit] for *_, of in scenes if unit in of]
        shown = [f for f in found if not np.isnan(f["r"]).any()]
        r = mean([f["r"] for f in shown])
        if r[0] < r[1]:
            behind.append(f"{unit} ({sum(f['r'][0] < f['r'][1] for f in shown)} of {len(shown)} scenes)")
        if shown:
            print(f"| {unit} | {len(shown)} | {cell(r)} | {cell(mean([f['rest'] for f in found]), False)} | "
                  f"{cell(mean([f['gain'] for f in found], both=False), None)} | {np.mean([f['full'] for f in shown]):.2f} | "
                  f"{cell(mean([f['sides'] for f in found]))} |")
    print(f"\nMean correlation below MediaPipe's: {', '.join(behind) or 'none'}.")


def stills(units, model, faces, tables):
    """How well the weights of held expressions tell them from others, of real faces in infrared."""
    held = []
    for table in sorted(glob.glob(f"{tables}/p[0-9][0-9]-[0-9].csv")):
        name = os.path.basename(table)[:-4]
        run, shapes = score.Run(table), blendshapes(model, f"{faces}/{name}")
        for row in score.read(f"{faces}/{name}/truth.csv"):
            face, late = score.Face(run, row), range(int(row["to"]) - score.LAST, int(row["to"]))
            known = [shapes[k] for k in late if k in shapes] if late[-1] in shapes else []
            peer = {u: np.mean([theirs(s, units[name[2:]]) for s in known for name in names]) for u, names in score.UNITS.items() if known}
            held.append((face.expression, face.weights, peer))
    if not held:
        return
    print(f"\n{len(held)} stills of six real faces in infrared: area under the ROC curve of the weight that tells an expression from all "
          "others (AU17: from neutral faces).\n")
    print("| method | found | " + " | ".join(f"{u} ({' or '.join(score.EXPRESSIONS[e] for e in of)})" for u, of, _ in score.TOLD) + " |")
    print("| --- " * (2 + len(score.TOLD)) + "|")
    for k, method in ((1, "mien"), (2, "MediaPipe")):
        told = [score.auc(*([h[k][u] for h in held if h[0] in which and h[k]] for which in (of, others))) for u, of, others in score.TOLD]
        print(f"| {method} | {100 * np.mean([bool(h[k]) for h in held]):.1f} % | " + " | ".join(f"{a:.2f}" for a in told) + " |")


def main(model, activations, faces, tables, *names):
    units = eval(re.search(r"U=(\{.*?\})\n", open(activations).read(), re.S)[1])
    scenes = []
    for name, session, run, skip in (words.split("=") for words in names):
        scenes.append((name, *scene(units, model, session, run, int(skip))))
    moves = {u: max((of[u]["moves"] for *_, of in scenes if u in of), default=None) for u in units}
    given = [u for u in units if moves[u] is not None and moves[u] > MOVES]
    print(f"Weights of the {len(given)} units that both give, mien / MediaPipe: correlation with the acted expression; rest, the 95th percentile"
          " while the unit is not acted; the median weight while it is acted at full, where the correlation is at least .7.\n")
    scenes_table(scenes, given)
    for title, own in (("By unit, in the worlds that share no code with mien:", False), ("By unit, in our own wild scenes:", True)):
        of = [s for s in scenes if s[0].startswith("own") == own]
        if of:
            units_table(title, of, given)
    print(f"MediaPipe's weight does not move in {', '.join(u for u in units if moves[u] is not None and u not in given) or 'none'};"
          f" mien does not give {', '.join(u for u in units if moves[u] is None) or 'none'}.")
    stills(units, model, faces, tables)


if __name__ == "__main__":
    main(*sys.argv[1:])
