"""The second world's figures as one table, from what its scorer keeps.

world.py KEPT [KEPT_OFF]

KEPT holds NAME.json and NAME.csv of `../shared/world/run`, and in `said` what it printed; with a second folder (`pose.learn_shape` off) both stand side by
side. Rotation and position with one fixed offset per person taken out.
"""
import json
import os
import sys

import score

ORDER = ("hairy person1 person2 person3 person4 person5 person6 yaw pitch fast light glasses occlude static two swap far empty").split()
PEOPLE = ORDER[:7]
# What is no worse: degrees, millimetres.
ALIKE_DEG, ALIKE_MM = 0.1, 0.3


def read(folder, name):
    path = f"{folder}/{name}.json"
    if not os.path.exists(path):
        return None
    with open(path) as f:
        found = json.load(f)
    states = {}
    for row in score.read(f"{folder}/{name}.csv"):
        if row["user"] != "":
            states.setdefault(row["user"], []).append(row["state"])
    frames = sum(map(len, states.values()))
    flips = sum(a != b and "held" in (a, b) for s in states.values() for a, b in zip(s, s[1:]))
    found["flips"] = 300 * flips / frames if frames else None
    return found


def said(found, key, unit, form=".2f", times=1):
    value = found.get(key)
    return "-" if value is None else f"{value * times:{form}}{unit}"


def lost(found):
    return said(found, "lost_fraction_after_start", " %", times=100)


def beside(found):
    """What only some scenes have."""
    out = []
    if found.get("jitter_pose_deg_rms") is not None:
        out.append(f"jitter {said(found, 'jitter_pose_deg_rms', '°', '.3f')}, {said(found, 'jitter_pose_mm_rms', ' mm')}, "
                   f"points {said(found, 'jitter_landmark_pct_sd', ' %')}")
    if found["scenario"] in ("swap", "empty", "occlude", "far") and found.get("recovery_frames_max") is not None:
        out.append(f"tracked again after {found['recovery_frames_max']:.0f} frames at most")
    if found["scenario"] in ("swap", "two") and found.get("user_id_consistency") is not None:
        out.append(f"slot correct in {100 * found['user_id_consistency']:.0f} % of frames")
    return ", ".join(out)


def one(folder):
    rows = {name: found for name in ORDER if (found := read(folder, name))}
    score.table("second world", ["scene", "lost", "into or out of held in 10 s", "rotation", "position", "landmarks", ""], [
        [name, lost(f), said(f, "flips", "", ".1f"), said(f, "pose_deg_mean", "°"), said(f, "pose_mm_mean", " mm", ".1f"),
         said(f, "nme68_mean", " %", times=100), beside(f)] for name, f in rows.items()])
    people = {name: rows[name] for name in PEOPLE if name in rows}
    if people:
        print(f"\n{len(people)} sitting people, mean (worst): " + ", ".join(
            f"{what} {sum(f[key] * times for f in people.values()) / len(people):{form}}{unit} "
            f"({(who := max(people, key=lambda n: people[n][key]))} {people[who][key] * times:{form}}{unit})"
            for what, key, form, times, unit in (("lost", "lost_fraction_after_start", ".2f", 100, " %"), ("rotation", "pose_deg_mean", ".2f", 1, "°"),
                                                 ("position", "pose_mm_mean", ".1f", 1, " mm"), ("landmarks", "nme68_mean", ".2f", 100, " %"))))


def units(path):
    """What the scorer said of weights against the acted expressions, over the sitting people."""
    rows = []
    if os.path.exists(path):
        with open(path) as f:
            for words in map(str.split, f):
                if len(words) == 7 and words[0].startswith("AU"):
                    unit, r, worst, gain, quiet, reach, foreign = words
                    rows.append([f"`{unit}`", f"{r} ({worst})", gain, quiet, reach, foreign])
    if rows:
        score.table("second world, weights of the sitting people against the acted expressions",
                    ["unit", "correlation (worst person)", "gain", "95th percentile while nothing is acted", "median while fully acted",
                     "mean while others are acted"], rows)
        print(f"\nmean correlation of {len(rows)} units {sum(float(r[1].split()[0]) for r in rows) / len(rows):.2f}")


def both(on, off):
    pairs = [(name, a, b) for name in ORDER if (a := read(on, name)) and (b := read(off, name))]
    rows, turns, moves = [], [], []
    for name, a, b in pairs:
        if None in (a.get("pose_deg_mean"), b.get("pose_deg_mean")):
            continue
        turn, move = a["pose_deg_mean"] - b["pose_deg_mean"], a["pose_mm_mean"] - b["pose_mm_mean"]
        turns.append(turn)
        moves.append(move)
        worse = turn > ALIKE_DEG or move > ALIKE_MM or a["lost_fraction_after_start"] > b["lost_fraction_after_start"] + 0.0005
        rows.append([name, lost(a), lost(b), said(a, "pose_deg_mean", "°"), said(b, "pose_deg_mean", "°"),
                     said(a, "pose_mm_mean", " mm", ".1f"), said(b, "pose_mm_mean", " mm", ".1f"), "worse" if worse else "no worse"])
    score.table(f"second world: learn_shape on and off (worse: more than {ALIKE_DEG}°, {ALIKE_MM} mm, or lost more often)",
                ["scene", "lost, on", "off", "rotation, on", "off", "position, on", "off", "on is"], rows)
    if turns:
        print(f"\non minus off, mean: rotation {sum(turns) / len(turns):+.2f}°, position {sum(moves) / len(moves):+.1f} mm")


if __name__ == "__main__":
    if len(sys.argv) == 2:
        one(sys.argv[1])
        units(f"{sys.argv[1]}/said")
    else:
        both(*sys.argv[1:3])
