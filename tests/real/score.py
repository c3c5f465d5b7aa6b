"""Tables of `mien run` on the real recordings against their hand-made truth.

score.py DATA CACHE TABLES [TABLES_OFF]      (numpy)

TABLES holds NAME.csv of each session of sessions.py; with a second folder (`pose.learn_shape` off) the figures stand side by
side. What a figure means is written in the table's own lines and in docs/results.md. Rows are read by column name, so that
tables with fewer or more columns work; without head_x0 … the head's box is not judged.
"""
import csv
import math
import os
import sys

import numpy as np

# States in which a row's pose is measured in this frame; `held` keeps or predicts it.
FOLLOWED = ("warming", "tracking", "posed")
REPORTED = ("warming", "tracking")
FACING = ("within60", "covered")
RIGHT_IOU = 0.5
# A segment of a face is tracked if the face is reported in its last frame; points and units are means over this many.
LAST = 10
# Truth's 15 points in the 68, 0-based.
POINTS = [[36], [37, 38], [39], [40, 41], [42], [43, 44], [45], [46, 47], [30], [31], [35], [48], [62], [54], [66]]
RIGHT_EYE, LEFT_EYE = 0, 6
FRONTAL = (1, 4, 7)
# Points of a face that is where it is said to be are within this, in % of the outer-eye distance.
RIGHT_PERCENT = 10.0
EXPRESSIONS = ["mouth wide open", "mouth half open", "neutral", "smile", "mouth sad", "eyes closed"]
UNITS = {"AU12": ["w_AU12L", "w_AU12R"], "AU25": ["w_AU25"], "AU26": ["w_AU26"], "AU43": ["w_AU43L", "w_AU43R"],
         "AU17": ["w_AU17"]}
# Unit, expressions (as in EXPRESSIONS) that show it, and those it is to be told from.
TOLD = [("AU12", (3,), (0, 1, 2, 4, 5)), ("AU25", (0, 1), (2, 3, 4, 5)), ("AU26", (0, 1), (2, 3, 4, 5)), ("AU43", (5,), (0, 1, 2, 3, 4)),
        ("AU17", (4,), (2,))]
# Heads of kinect_v1_pcl's five_people as sessions.py enlarges it: x0, y0, x1, y1, within about 8 px. All are seen from behind.
PCL_HEADS = {"pcl-people": [(27, 48, 103, 122), (139, 86, 202, 150), (325, 94, 370, 145), (407, 91, 454, 144), (521, 30, 597, 122)],
             "pcl-desk": []}
BOX = ["head_x0", "head_y0", "head_x1", "head_y1"]


class Row:
    """One user in one frame."""

    def __init__(self, row):
        self.user, self.state, self.frame = row["user"], row["state"], int(row["frame"])
        self.time_s = int(row["time_us"]) * 1e-6
        self.values = row
        self.position_m = self.vector(["tx_m", "ty_m", "tz_m"])
        self.box = self.vector(BOX)
        self.face = row.get("x0", "") != ""

    def vector(self, names):
        words = [self.values.get(n) or "" for n in names]
        return None if "" in words else np.array([float(w) for w in words])

    def points(self):
        p = self.vector([f"{a}{i}" for i in range(68) for a in "xy"])
        return p.reshape(68, 2)

    def weight(self, names):
        return float(np.mean([float(self.values.get(n) or 0) for n in names]))


class Run:
    """The table of one session."""

    def __init__(self, path):
        with open(path) as f:
            table = csv.DictReader(f)
            self.has_boxes = set(BOX) <= set(table.fieldnames)
            self.rows = [Row(r) for r in table]
        self.by_frame = {}
        for row in self.rows:
            self.by_frame.setdefault(row.frame, [])
            if row.user != "":
                self.by_frame[row.frame].append(row)
        self.frames = len(self.by_frame)
        self.slots = sorted({r.user for r in self.rows if r.user != ""})

    def at(self, frame):
        return self.by_frame.get(frame, [])

    def flips(self):
        """Changes into or out of `held`, in all slots."""
        states = {}
        for r in self.rows:
            states.setdefault(r.user, []).append(r.state)
        return sum(a != b and "held" in (a, b) for s in states.values() for a, b in zip(s, s[1:]))


def load(folder, name):
    path = f"{folder}/{name}.csv"
    return Run(path) if os.path.exists(path) else None


def read(path):
    with open(path) as f:
        return list(csv.DictReader(f))


def mean(values):
    values = list(values)
    return float(np.mean(values)) if values else math.nan


def median(values):
    values = [v for v in values if not math.isnan(v)]
    return float(np.median(values)) if values else math.nan


def overlap(a, b):
    """Intersection over union, and whether they touch at all."""
    w, h = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
    if w <= 0 or h <= 0:
        return 0.0, False
    area = lambda x: (x[2] - x[0]) * (x[3] - x[1])
    return w * h / (area(a) + area(b) - w * h), True


def boxes_beside(run, heads_at):
    """Frames that have head boxes, and those with one that touches none of the frame's heads; `heads_at(frame)` is a list of
    boxes, None where heads are not marked."""
    have = beside = 0
    for frame, rows in run.by_frame.items():
        heads = heads_at(frame)
        boxes = [r.box for r in rows if r.box is not None]
        if heads is None or not boxes:
            continue
        have += 1
        beside += any(not any(overlap(b, h)[1] for h in heads) for b in boxes)
    return have, beside


def share(part, whole):
    return f"{100 * part / whole:.1f} % ({part} of {whole})" if whole else "none to judge"


def film(data, run):
    """Rows of the film's table: (what, figure)."""
    facing = {}
    for r in read(f"{data}/kinect_v1_film/facing.csv"):
        facing.update({f: r["facing"] for f in range(int(r["from"]), int(r["to"]) + 1)})
    within = [f for f, v in facing.items() if v == "within60"]
    posed = lambda f, states: any(r.position_m is not None and r.state in states for r in run.at(f))
    now = sum(posed(f, FOLLOWED) for f in within)
    kept = sum(posed(f, FOLLOWED + ("held",)) for f in within)
    out = [("frames facing within 60° with a measured pose", share(now, len(within))),
           ("… with a pose, including held ones", share(kept, len(within)))]

    # A jump is one of whoever keeps a slot, or of the only one there: a new number hides nothing.
    frames = sorted(run.by_frame)
    times = {f: min((r.time_s for r in run.rows if r.frame == f), default=0) for f in frames}
    period = median(np.diff([times[f] for f in frames]))
    jumps, bends = [], []
    moved = {}
    for a, b in zip(frames, frames[1:]):
        gap = times[b] - times[a]
        if gap > 2.05 * period:
            continue
        before, after = ([r for r in run.at(f) if r.position_m is not None] for f in (a, b))
        for p in before:
            for q in after:
                if p.user == q.user or len(before) == len(after) == 1:
                    step = q.position_m - p.position_m
                    calm = all(facing[f] in FACING for f in (a, b))
                    jumps.append((100 * float(np.linalg.norm(step)), b, gap, calm, q.user))
                    moved[b, q.user] = (step, calm)
                    # What he really moves by is in both steps, a jump in one of them. (Not scaled by time: the film's times are
                    # those of a screen's recorder, and less even than the motion.)
                    if (a, p.user) in moved:
                        earlier, was_calm = moved[a, p.user]
                        bends.append((100 * float(np.linalg.norm(step - earlier)), b, gap, calm and was_calm, q.user))
    worst = lambda js: f"{max(js)[0]:.1f} cm (frame {max(js)[1]}, {1000 * max(js)[2]:.0f} ms, slot {max(js)[4]})" if js else "none"
    calm = [j for j in jumps if j[3]]
    out.append(("largest step between neighbouring frames, facing or covered", worst(calm)))
    out.append(("… over 4 cm", share(sum(j[0] > 4 for j in calm), len(calm))))
    out.append(("… after subtracting the previous step (his own motion)", worst([b for b in bends if b[3]])))
    out.append(("largest step at all", worst(jumps)))
    out.append(("… after subtracting the previous step", worst(bends)))
    out.append(("slots used (one man)", str(len(run.slots))))
    ghosts = sum(sum(r.position_m is not None for r in rows) > 1 for rows in run.by_frame.values())
    out.append(("frames with a second pose", share(ghosts, run.frames)))
    out.append(("changes into or out of held", str(run.flips())))

    if not run.has_boxes:
        return out + [("head box", "no boxes in this table")]
    heads = {int(r["frame"]): np.array([float(r[k]) for k in ("x0", "y0", "x1", "y1")]) for r in read(f"{data}/kinect_v1_film/heads.csv")}
    best = {}
    for f, head in heads.items():
        boxes = [r.box for r in run.at(f) if r.box is not None]
        best[f] = max(((overlap(b, head)[0], b) for b in boxes), key=lambda x: x[0], default=(0.0, None))
    right = [f for f in heads if best[f][0] >= RIGHT_IOU]
    wrong = [f for f in heads if f not in right]
    centre = lambda b: np.array([b[0] + b[2], b[1] + b[3]]) / 2
    found = [(f, b) for f, (_, b) in best.items() if b is not None]
    offset = [(centre(b) - centre(heads[f])) / (heads[f][2] - heads[f][0]) for f, b in found]
    size = [((b[2] - b[0]) / (heads[f][2] - heads[f][0]), (b[3] - b[1]) / (heads[f][3] - heads[f][1])) for f, b in found]
    out.append((f"head box correct (overlap / union with the marked one at least {RIGHT_IOU})",
                share(len(right), len(heads)) + (f"; not in frame {', '.join(map(str, wrong))}" if wrong else "")))
    out.append(("… mean overlap / union; centre off in x, y (of the marked width); width, height over the marked",
                f"{mean(v for v, _ in best.values()):.2f}" + (f"; {mean(o[0] for o in offset):+.2f}, {mean(o[1] for o in offset):+.2f}; "
                f"{mean(s[0] for s in size):.2f}, {mean(s[1] for s in size):.2f}" if found else "")))
    have, beside = boxes_beside(run, lambda f: [heads[f]] if f in heads else None)
    out.append(("marked frames with a box that touches no head", share(beside, len(heads))))
    return out


def nobody_looks(run, heads_at, frames):
    """Rows for recordings in which no face looks at the sensor."""
    faces = sum(any(r.face and r.state in REPORTED for r in rows) for rows in run.by_frame.values())
    out = [("frames with a face reported (there is none)", share(faces, frames))]
    if not run.has_boxes:
        return out + [("head box", "no boxes in this table")]
    have, beside = boxes_beside(run, heads_at)
    return out + [("frames with a head box", share(have, frames)), ("frames with a head box that touches no head", share(beside, frames))]


def desk(data, run):
    heads = {}
    for r in read(f"{data}/kinect_v1_desk/heads.csv"):
        heads.setdefault(int(r["source_frame"]), []).append([float(r[k]) for k in ("x0", "y0", "x1", "y1")])
    # Each pair is held for six frames, and is the sixth of the source's: numbers are nearly the same.
    return nobody_looks(run, lambda f: heads.get(f // 6 * 6, []), run.frames)


def pcl(name, run):
    return nobody_looks(run, lambda f: PCL_HEADS[name], run.frames)


class Face:
    """One segment of one person in one pose."""

    def __init__(self, run, row):
        self.expression, self.first, self.end = int(row["expression"]), int(row["from"]), int(row["to"])
        truth = np.array([[float(row[f"{a}{i}"]) for a in "xy"] for i in range(15)])
        seen = {f: next((r for r in run.at(f) if r.face and r.state in REPORTED), None) for f in range(self.first, self.end)}
        self.followed = seen[self.end - 1] is not None
        # The other way to count, for who wants to compare: three quarters of the last twenty frames.
        self.mostly = sum(seen[f] is not None for f in range(self.end - 20, self.end)) >= 15
        late = [seen[f] for f in range(self.end - LAST, self.end) if seen[f] is not None] if self.followed else []
        width = np.linalg.norm(truth[RIGHT_EYE] - truth[LEFT_EYE])
        self.error = math.nan
        # A face may be reported where it is not.
        self.right = False
        self.weights = {}
        if late:
            found = mean_points([r.points() for r in late])
            self.error = 100 * float(np.mean(np.linalg.norm(found - truth, axis=1))) / width
            self.right = self.error <= RIGHT_PERCENT
            self.weights = {u: mean(r.weight(names) for r in late) for u, names in UNITS.items()}


def mean_points(points68):
    all68 = np.mean(points68, axis=0)
    return np.array([all68[k].mean(axis=0) for k in POINTS])


def faces(cache, folder):
    """Person -> pose -> segments, and the changes into or out of held per session."""
    out, flips, frames = {}, 0, 0
    for p in range(6):
        for k in range(9):
            run = load(folder, f"p{p:02}-{k}")
            if run is None:
                continue
            out.setdefault(f"p{p:02}", {})[k] = [Face(run, r) for r in read(f"{cache}/p{p:02}-{k}/truth.csv")]
            flips += run.flips()
            frames += run.frames
    return out, 300 * flips / frames if frames else math.nan


def table(title, columns, rows):
    """Markdown; `rows` are lists of as many cells."""
    print(f"\n**{title}**\n")
    print("| " + " | ".join(columns) + " |")
    print("|" + " --- |" * len(columns))
    for row in rows:
        print("| " + " | ".join(row) + " |")


def side_by_side(title, sides, names):
    """A column for each session of `names` ((session, label, how it is judged), …) and side; rows are what is judged."""
    found, columns = [], ["what"]
    for name, label, how in names:
        for side, word in zip(sides, ("on", "off")):
            run = load(side, name)
            if run is None:
                print(f"\n{title}: {name} is not played")
                continue
            found.append(how(run))
            columns.append(label if len(sides) == 1 else f"{label}, {word}")
    if found:
        table(title, columns, [[rows[0][0]] + [r[1] for r in rows] for rows in zip(*found)])


def percent(segments, attribute="followed"):
    return 100 * mean(getattr(s, attribute) for s in segments)


def face_tables(cache, sides):
    found = [faces(cache, side) for side in sides]
    if not all(people for people, _ in found):
        print("\nkinect_v2_faces: not played")
    elif len(sides) == 1:
        face_table(*found[0])
    else:
        faces_against(*(people for people, _ in found))


def face_table(people, flips):
    everybody = {p: [s for ss in poses.values() for s in ss] for p, poses in people.items()}
    joint = {k: [s for poses in people.values() for s in poses.get(k, [])] for k in range(9)}
    every = [s for ss in everybody.values() for s in ss]

    def row(name, poses, segments):
        by_pose = [f"{percent(poses[k]):.0f}" if poses.get(k) else "-" for k in range(9)]
        return [name, f"{percent(segments):.1f} %", f"{percent(segments, 'right'):.1f} %"] + by_pose + errors(poses)

    table("kinect_v2_faces: segments tracked, and correct; tracked in % in poses 0 to 8; landmark error on 15 points in % of the "
          "outer-eye distance, median over segments", ["person", "tracked", "and correct"] + [str(k) for k in range(9)] + ["frontal", "all poses"],
          [row(p, people[p], everybody[p]) for p in people] + [row("all", joint, every)])
    least = lambda attribute: min(everybody, key=lambda p: percent(everybody[p], attribute))
    follow, right = least("followed"), least("right")
    off = {p: median(s.error for s in ss) for p, ss in everybody.items()}
    wrong = max(off, key=lambda p: -1 if math.isnan(off[p]) else off[p])
    print(f"\n{len(every)} segments, mean (worst): tracked {percent(every):.1f} % ({follow} {percent(everybody[follow]):.1f} %), correct "
          f"{percent(every, 'right'):.1f} % ({right} {percent(everybody[right], 'right'):.1f} %), landmarks {median(s.error for s in every):.2f} % "
          f"({wrong} {off[wrong]:.2f} %); reported in 15 of a segment's last 20 frames {percent(every, 'mostly'):.1f} %; into or out of held "
          f"{flips:.1f} times in 10 s")
    rows = []
    for e in (2, 1, 0, 3, 4, 5):
        these = [s for s in every if s.expression == e and s.weights]
        rows.append([EXPRESSIONS[e], str(len(these))] + [f"{mean(s.weights[u] for s in these):.2f}" for u in UNITS])
    table("kinect_v2_faces: mean weights while an expression is held", ["expression", "segments"] + list(UNITS), rows)
    told = []
    for unit, acted, others in TOLD:
        held, other = ([s.weights[unit] for s in every if s.expression in which and s.weights] for which in (acted, others))
        told.append(f"{unit} {auc(held, other):.2f} ({' or '.join(EXPRESSIONS[e] for e in acted)})")
    print(f"\nSeparation from all other segments (AU17: from neutral ones) by the unit's weight, area under the ROC curve: {', '.join(told)}")


def auc(held, other):
    """Chance that the weight of a segment in which it is held is above that of one in which it is not."""
    a, b = np.array(held)[:, None], np.array(other)[None, :]
    return float(np.mean((a > b) + 0.5 * (a == b))) if a.size and b.size else math.nan


def faces_against(on, off):
    rows = []
    for p in on:
        a, b = ([s for ss in side.get(p, {}).values() for s in ss] for side in (on, off))
        # Errors of the segments tracked in both: those that one of them loses are often the hardest.
        both = [(s.error, t.error) for s, t in zip(a, b) if not math.isnan(s.error + t.error)]
        rows.append([p, f"{percent(a):.1f} %", f"{percent(b):.1f} %", f"{percent(a, 'right'):.1f} %", f"{percent(b, 'right'):.1f} %",
                     f"{median(x for x, _ in both):.2f} %", f"{median(y for _, y in both):.2f} %", verdict(percent(b, "right") - percent(a, "right"))])
    table("kinect_v2_faces: learn_shape on and off; landmark error of the segments tracked in both",
          ["person", "tracked, on", "off", "and correct, on", "off", "landmarks, on", "off", "on is"], rows)


def verdict(worse):
    return "worse" if worse > 0.05 else "better" if worse < -0.05 else "the same"


def errors(poses):
    return [f"{median(s.error for k, ss in poses.items() if k in which for s in ss):.2f}" for which in (FRONTAL, range(9))]


def main():
    data, cache, *sides = sys.argv[1:]
    there = lambda name: any(os.path.exists(f"{side}/{name}.{kind}") for side in sides for kind in ("csv", "log"))
    against = "" if len(sides) == 1 else ": learn_shape on and off"
    if there("p00-4"):
        face_tables(cache, sides)
    if there("film"):
        judge = lambda run: film(data, run)
        side_by_side(f"kinect_v1_film{against}", sides, [("film-depth", "depth only", judge), ("film", "with a grey colour picture", judge)])
    quiet = [("desk", "desk", lambda run: desk(data, run)), ("pcl-people", "five from behind", lambda run: pcl("pcl-people", run)),
             ("pcl-desk", "a box on a floor", lambda run: pcl("pcl-desk", run))]
    quiet = [session for session in quiet if there(session[0])]
    if quiet:
        side_by_side(f"kinect_v1_desk, kinect_v1_pcl{against}", sides, quiet)


if __name__ == "__main__":
    main()
