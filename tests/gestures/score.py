"""Gestures in the tables of `mien run` against what was acted.

score.py CONFIG own TABLES [NAME=WORDS ...]     TABLES: personN.csv, personN-acted.csv of tests/it/plays_gestures.rs
score.py CONFIG world SESSIONS TABLES           SESSIONS: personN-1200 of the second world, TABLES: personN.csv
score.py CONFIG faces BEGIN TABLES              sessions are BEGINpNN-K, with their truth.csv, TABLES: pNN-K.csv
score.py CONFIG life TABLES                     TABLES: NAME.csv and NAME-truth.csv of any scene of the simulated worlds

score.py CONFIG set_up TABLES                   as own, with personN-levels.csv: acts before and after the set-up by five repetitions

CONFIG is what `mien print-config` prints with the gestures that were played.
caught   acts at full, long enough for the hold time and by somebody who is not new to the box, during which the gesture goes on
delay    from the frame whose acted sum reaches the upper level to the gesture's going on, without its hold time
false    activations of any gesture while no gesture is acted, only speech, blinks, glances, turns, rest and what else is done in everyday
         life; in `life`, activations of a gesture that nobody in the picture acted at 0.2 or more for 80 % of its hold time
"""
import csv
import math
import os
import sys
import tomllib

FPS = 30.0
FULL = 0.8
# From the level's being reached, an act must last this much longer than the hold time to count as one.
SPARE_S = 0.15
# A gesture may come this long after the end of its act, and what was acted this long before belongs to it.
AFTER_S = 0.4
MADE_OF = {
    "smile": ["mouthSmile_L", "mouthSmile_R"], "brows": ["browInnerUp_L", "browInnerUp_R", "browOuterUp_L", "browOuterUp_R"],
    "mouth_open": ["jawOpen"], "wink_left": ["eyeBlink_L"], "wink_right": ["eyeBlink_R"],
    "blink_long": ["eyeBlink_L", "eyeBlink_R"], "look_left": ["eyeLookOut_L", "eyeLookIn_R"],
    "look_right": ["eyeLookOut_R", "eyeLookIn_L"], "look_up": ["eyeLookUp_L", "eyeLookUp_R"], "kiss": ["mouthPucker"]}
# In `life`, a gesture was made if the mean weight of its expressions reached this value.
MADE = 0.2
# What speech, blinks and glances consist of in the second world.
CALM = ("eyeBlink", "eyeLook", "jawOpen", "mouthClose", "mouthFunnel", "mouthPucker", "mouthStretch", "mouthLowerDown", "mouthUpperUp",
        "mouthRollLower")
SPEECH = ("mouthLowerDown_L", "mouthLowerDown_R")
STILLS = {"smile": 3, "blink_long": 5, "mouth_open": 0}
NEUTRAL = 2


def read(path):
    with open(path) as f:
        return list(csv.DictReader(f))


def switches(path, names):
    """Per frame, by name, whether the gesture is on (0 or 1), missing frames are off; and the frames of those who are new to the box."""
    on = {n: {} for n in names}
    frames, new = 0, set()
    for row in read(path):
        if row["state"] == "warming":
            new.add(int(row["frame"]))
        frames = max(frames, int(row["frame"]) + 1)
        for n in names:
            on[n][int(row["frame"])] = on[n].get(int(row["frame"]), 0) | int(row["g_" + n])
    return {n: [on[n].get(f, 0) for f in range(frames)] for n in names}, new


def rises(on):
    return [f for f in range(1, len(on)) if on[f] and not on[f - 1]]


def spans(flags):
    """(first, one past the last) of each run of true."""
    out, start = [], None
    for i, flag in enumerate(list(flags) + [False]):
        if flag and start is None:
            start = i
        if not flag and start is not None:
            out.append((start, i))
            start = None
    return out


def interval(events):
    """The exact 95 % interval of a Poisson mean, by bisection."""
    def below(mean, most):
        term = total = math.exp(-mean)
        for k in range(1, most + 1):
            term *= mean / k
            total += term
        return total

    def solve(chance, least):
        low, high = 0.0, 10.0 + 3.0 * events
        for _ in range(60):
            mean = (low + high) / 2
            low, high = (mean, high) if chance(mean) > least else (low, mean)
        return low

    fewer = events - 1
    return (solve(lambda mean: below(mean, fewer), 0.975) if events else 0.0), solve(lambda mean: below(mean, events), 0.025)


def rates(hours, false, of=""):
    """A row for each gesture and one for all: events, and an hour's rate with its 95 % interval."""
    print(f"{hours:.2f} hours{of}")
    for name in [*false, "all"]:
        count = sum(false.values()) if name == "all" else false[name]
        low, high = interval(count)
        print(f"{name:11} {count:4}  {count / hours:6.2f} an hour ({low / hours:.2f} to {high / hours:.2f})")


class Tally:
    """Figures of a number of people."""

    def __init__(self, gestures):
        self.gestures = gestures
        self.acts = {n: 0 for n in gestures}
        self.caught = {n: 0 for n in gestures}
        self.delays = {n: [] for n in gestures}
        self.missed = {}
        self.calm_s, self.false = {}, {}
        self.crossed = {}

    def person(self, person, switched, heights, calm):
        """`switched` as [`switches`] gives it; `heights` by gesture and frame, 0…1; `calm` by frame: the name of what is done while nothing is acted, or empty."""
        on, new = switched
        for n, g in self.gestures.items():
            terms = min(s.count("AU") - s.count("- AU") for s in g["of"].split("&"))
            level = [h * terms >= g["on"] for h in heights[n]]
            for a, b in spans(h > 0.25 for h in heights[n]):
                full = [f for f in range(a, b) if heights[n][f] >= FULL]
                reached = [f for f in range(a, b) if level[f]]
                if not full or not reached or len(full) < (g["hold_s"] + SPARE_S) * FPS or new & set(range(a, b)):
                    continue
                self.acts[n] += 1
                until = b + int(AFTER_S * FPS)
                when = [f for f in range(a, min(until, len(on[n]))) if on[n][f]]
                if when:
                    self.caught[n] += 1
                    self.delays[n].append((when[0] - reached[0]) / FPS - g["hold_s"])
                else:
                    self.missed[n, person] = self.missed.get((n, person), 0) + 1
        for kind in calm:
            if kind:
                self.calm_s[kind] = self.calm_s.get(kind, 0) + 1 / FPS
        for n in self.gestures:
            for f in rises(on[n]):
                if f < len(calm) and calm[f]:
                    self.false.setdefault(calm[f], []).append((n, person))
                elif f < len(calm):
                    back = range(max(0, f - int(AFTER_S * FPS)), f + 1)
                    if all(heights[n][i] < 0.25 for i in back):
                        other = max(heights, key=lambda m: max(heights[m][i] for i in back))
                        what = other if max(heights[other][i] for i in back) > 0.25 else "other expressions"
                        self.crossed[n, what] = self.crossed.get((n, what), 0) + 1

    def table(self):
        if any(self.acts.values()):
            print(f"{'gesture':11} {'acts':>5} {'caught':>8} {'delay ms':>9}  missed by person")
        for n in filter(self.acts.get, self.gestures):
            d = self.delays[n]
            late = f"{1000 * sum(d) / len(d):9.0f}" if d else f"{'':9}"
            caught = f"{100 * self.caught[n] / self.acts[n]:6.1f} %" if self.acts[n] else f"{'':8}"
            print(f"{n:11} {self.acts[n]:5} {caught} {late}  " + ", ".join(f"{p} {k}" for (m, p), k in self.missed.items() if m == n))
        acts, caught = sum(self.acts.values()), sum(self.caught.values())
        delays = [d for all_ in self.delays.values() for d in all_]
        if acts:
            print(f"all: {100 * caught / acts:.1f} % of {acts} caught, {1000 * sum(delays) / max(1, len(delays)):.0f} ms after the hold time")
        hours = sum(self.calm_s.values()) / 3600
        events = sum(len(f) for f in self.false.values())
        print(f"false: {events} in {60 * hours:.1f} min" + (f", {events / hours:.1f} an hour" if hours else ""))
        if not acts:
            count = {n: sum(n == name for found in self.false.values() for name, _ in found) for n in self.gestures}
            rates(hours, count)
        for kind, seconds in self.calm_s.items():
            found = self.false.get(kind, [])
            count = {}
            for one in found:
                count[one] = count.get(one, 0) + 1
            print(f"  {kind:6} {seconds / 60:5.1f} min: {len(found)}  " + ", ".join(f"{n} {p} {k}" for (n, p), k in count.items()))
        crossed = sorted(self.crossed.items(), key=lambda pair: -pair[1])
        print("while others are acted: " + (", ".join(f"{n} at {other} {k}" for (n, other), k in crossed) or "none"))


def people(tables):
    """Name and acted rows of each person of `tables`."""
    for name in sorted(f[:-10] for f in os.listdir(tables) if f.endswith("-acted.csv")):
        yield name, read(f"{tables}/{name}-acted.csv")


def own(gestures, tables, _=None):
    tally = Tally(gestures)
    for name, rows in people(tables):
        is_judged = [r["part"] in ("full", "calm", "life") for r in rows]
        heights = {n: [float(r["height"]) if r["acted"] == n and judged else 0.0 for r, judged in zip(rows, is_judged)] for n in gestures}
        calm = ["" if r["acted"] in MADE_OF or not r["acted"] else r["acted"] for r in rows]
        on, new = switches(f"{tables}/{name}.csv", gestures)
        on = {n: [is_on and judged for is_on, judged in zip(on[n], is_judged)] for n in gestures}
        tally.person(name, (on, new), heights, calm)
    tally.table()


def values(path, gestures, frames):
    """By gesture, the value of its expression in each frame: the least of its sums; below any level without a tracked face."""
    out = {n: [-9.0] * frames for n in gestures}
    for row in read(path):
        if row["state"] != "tracking" or int(row["frame"]) >= frames:
            continue
        for n, g in gestures.items():
            sums = [s.replace("-", "+ -").replace("- ", "-").split("+") for s in g["of"].split("&")]
            weight = lambda term: (-1 if "-" in term else 1) * min(1.0, max(0.0, float(row["w_" + term.strip(" -")] or 0)))
            out[n][int(row["frame"])] = min(sum(weight(t) for t in terms if t.strip()) for terms in sums)
    return out


def kept(value, hold_s):
    """Highest level that a value kept for a time."""
    held = int(math.ceil(hold_s * FPS)) + 1
    return max((min(value[i:i + held]) for i in range(len(value) - held + 1)), default=-9.0)


def from_best(found, acts, calm):
    """How far a level is from those that catch most of `acts` less the activations of `calm`: levels kept by each act and each calm part."""
    worth = lambda level: sum(k >= level for k in acts) - sum(k >= level for k in calm)
    grid = [k / 100 for k in range(5, 401)] + [found]
    most = max(map(worth, grid))
    return min(abs(level - found) for level in grid if worth(level) == most)


def set_up(gestures, tables):
    """Hits and false activations with the levels of the configuration and with those found for the person."""
    caught = {(n, part, which): {} for n in gestures for part in ("full", "weak") for which in ("default", "found")}
    worse, false, levels, far, states = [], {"default": 0, "found": 0}, {n: [] for n in gestures}, {n: {} for n in gestures}, {}
    for name, rows in people(tables):
        default, _ = switches(f"{tables}/{name}.csv", gestures)
        on = {"default": default, "found": {n: [int(r["g_" + n]) for r in rows] for n in gestures}}
        found = {r["gesture"]: r for r in read(f"{tables}/{name}-levels.csv")}
        value = values(f"{tables}/{name}.csv", gestures, len(rows))
        calms = spans(r["part"] == "calm" for r in rows)
        for n in gestures:
            level, hold_s = float(found[n]["on"]), float(found[n]["hold_s"])
            levels[n].append(level)
            states[found[n]["state"]] = states.get(found[n]["state"], 0) + 1
            count, reached = {}, []
            for part in ("full", "weak"):
                acts = spans(r["part"] == part and r["acted"] == n and float(r["height"]) > 0.05 for r in rows)
                for which in on:
                    hits = sum(any(on[which][n][a:b + int(AFTER_S * FPS)]) for a, b in acts)
                    caught[n, part, which][name] = (hits, len(acts))
                    count[which, part] = hits
                reached += [kept(value[n][a:b + int(AFTER_S * FPS)], hold_s) for a, b in acts]
            # Each kind of what is calm, of which three seconds at a time.
            quiet = [kept(value[n][a:a + 90], hold_s) for first, last in calms for a in range(first, last, 90)]
            far[n][name] = from_best(level, reached, quiet)
            for which in on:
                count[which] = sum(rows[f]["part"] == "calm" for f in rises(on[which][n]) if f < len(rows))
                false[which] += count[which]
            hits = {which: count[which, "full"] + count[which, "weak"] for which in on}
            if hits["found"] < hits["default"] or count["found"] > count["default"]:
                worse.append(f"{n} {name}: {hits['default']} hits and {count['default']} false before, {hits['found']} and {count['found']} after")
    share = lambda results: 100 * sum(h for h, _ in results) / max(1, sum(k for _, k in results))
    print(f"{'gesture':11} {'at full':>17} {'at 60 %':>17}  levels found    from the best  worst person at 60 %")
    for n in gestures:
        cells = [share(caught[n, part, which].values()) for part in ("full", "weak") for which in ("default", "found")]
        weak = caught[n, "weak", "found"]
        worst = min(weak, key=lambda p: weak[p][0] / max(1, weak[p][1]))
        print(f"{n:11} {cells[0]:6.1f} to {cells[1]:5.1f} % {cells[2]:6.1f} to {cells[3]:5.1f} %  {min(levels[n]):.2f} to {max(levels[n]):.2f}"
              f"    {max(far[n].values()):.2f} at most   {worst} {weak[worst][0]} of {weak[worst][1]}")
    total = [share([r for n in gestures for r in caught[n, part, which].values()]) for part in ("full", "weak") for which in ("default", "found")]
    near = [d <= 0.1 for n in gestures for d in far[n].values()]
    print(f"all         {total[0]:6.1f} to {total[1]:5.1f} % {total[2]:6.1f} to {total[3]:5.1f} %  within .1 of the best: {sum(near)} of {len(near)}")
    print(f"false in the calm parts: {false['default']} before, {false['found']} after; states: {states}")
    print("made worse: " + ("; ".join(worse) or "nobody"))


def world(gestures, sessions, tables):
    tally = Tally(gestures)
    for name in sorted(f[:-4] for f in os.listdir(tables) if f.endswith(".csv")):
        rows = [r for r in read(f"{sessions}/{name}-1200/truth.csv") if r["person"] == "0"]
        names = list(rows[0])[-55:]
        w = {n: [float(r[n]) for r in rows] for n in names}
        frames = range(len(rows))
        heights = {n: [sum(w[e][f] for e in MADE_OF[n]) / len(MADE_OF[n]) for f in frames] for n in gestures}
        for side, other in (("left", "eyeBlink_R"), ("right", "eyeBlink_L")):
            if "wink_" + side in heights:
                heights["wink_" + side] = [h if w[other][f] < 0.1 else 0.0 for f, h in enumerate(heights["wink_" + side])]
        long = spans(h > 0.25 for h in heights.get("blink_long", []))
        short = {f for a, b in long if b - a < 0.5 * FPS for f in range(a, b)}
        if "blink_long" in heights:
            heights["blink_long"] = [0.0 if f in short else h for f, h in enumerate(heights["blink_long"])]
        speech = [any(w[s][i] > 0 for s in SPEECH for i in range(max(0, f - 10), min(len(rows), f + 10))) for f in frames]
        still = [all(w[n][f] < 0.05 for n in names if not n.startswith(CALM)) for f in frames]
        quiet = [all(w[n][f] < 0.05 for n in names if not n.startswith(("eyeBlink", "eyeLook"))) for f in frames]
        shut = [any(h > 0.25 for h in (heights.get("blink_long", [0] * len(rows))[f],)) or
                any(heights.get(x, [0] * len(rows))[f] > 0.25 for x in ("wink_left", "wink_right")) for f in frames]
        calm = ["" if shut[f] or f < 30 else "speak" if speech[f] and still[f] else "rest" if quiet[f] else "" for f in frames]
        tally.person(name, switches(f"{tables}/{name}.csv", gestures), heights, calm)
    tally.table()


def acted_heights(rows, gestures):
    """By gesture and frame, how much of it the person who shows most acts; winks only with the other eye open."""
    frames = max(int(r["frame"]) for r in rows) + 1
    heights = {n: [0.0] * frames for n in gestures}
    for row in rows:
        if row["person"] != "-1":
            for n in gestures:
                height = sum(float(row[e]) for e in MADE_OF[n]) / len(MADE_OF[n])
                other = {"wink_left": "eyeBlink_R", "wink_right": "eyeBlink_L"}.get(n)
                if other and float(row[other]) > 0.3:
                    height = 0.0
                heights[n][int(row["frame"])] = max(heights[n][int(row["frame"])], height)
    return heights


def life(gestures, tables):
    false, seconds = {n: 0 for n in gestures}, 0.0
    for name in sorted(f[:-4] for f in os.listdir(tables) if f.endswith(".csv") and not f.endswith("-truth.csv")):
        rows = read(f"{tables}/{name}-truth.csv")
        heights = acted_heights(rows, gestures)
        on, _ = switches(f"{tables}/{name}.csv", gestures)
        seconds += len({r["frame"] for r in rows if r["person"] != "-1"}) / FPS
        for n, g in gestures.items():
            held = max(1, int(0.8 * g["hold_s"] * FPS))
            for f in rises(on[n]):
                near = heights[n][max(0, f - int((g["hold_s"] + AFTER_S) * FPS) - 15):f + 1]
                if not any(b - a >= held for a, b in spans(h >= MADE for h in near)):
                    false[n] += 1
                    row = max((r for r in rows if int(r["frame"]) == f), key=lambda r: r["person"], default={})
                    acts = sorted(((float(v or 0), e) for e, v in list(row.items())[-55:]), reverse=True)[:4]
                    print(f"  {name} frame {f}: {n}; " + ", ".join(f"{e} {v:.2f}" for v, e in acts if v > 0.1))
    rates(seconds / 3600, false)


def faces(gestures, sessions, tables):
    shown = {n: [0, 0, {}] for n in STILLS}
    neutral = {"of these": [0, 0, {}], "of all": [0, 0, {}]}
    for name in sorted(f[:-4] for f in os.listdir(tables) if f.endswith(".csv")):
        on, _ = switches(f"{tables}/{name}.csv", gestures)
        for row in read(f"{sessions}{name}/truth.csv"):
            expression, during = int(row["expression"]), range(int(row["from"]), int(row["to"]))
            fires = [n for n in gestures if any(on[n][f] for f in during if f < len(on[n]))]
            for n, still in STILLS.items():
                if n in gestures and expression == still:
                    add(shown[n], n in fires, name)
            if expression == NEUTRAL:
                # What the still before has switched on is on for a moment.
                new = [n for n in gestures if any(f in during for f in rises(on[n]))]
                add(neutral["of these"], bool(set(new) & set(STILLS)), name)
                add(neutral["of all"], bool(new), name)
    for n, (yes, of, people) in shown.items():
        worst = min(people, key=lambda p: people[p][0] / people[p][1]) if people else ""
        print(f"{n:11} {100 * yes / max(1, of):.1f} % of {of} stills fire; worst {worst} {people.get(worst, '')}")
    for what, (yes, of, _) in neutral.items():
        print(f"neutral stills that fire one {what}: {100 * yes / max(1, of):.1f} % of {of}")


def add(tally, yes, name):
    tally[0] += yes
    tally[1] += 1
    person = tally[2].setdefault(name.split("-")[0], [0, 0])
    person[0] += yes
    person[1] += 1


def main():
    config, what, *folders = sys.argv[1:]
    with open(config, "rb") as f:
        gestures = {g["name"]: g for g in tomllib.load(f)["gesture"]}
    {"own": own, "world": world, "faces": faces, "life": life, "set_up": set_up}[what](gestures, *folders)


if __name__ == "__main__":
    main()
