"""What artists share, as rows of the recipe: `move` and `jaw` of config/blendshapes.toml from sculpted shapes; judged leaving one out.

python consensus.py STUDIO DATA WORK --rows OUT [--without NAME] [--recipe RECIPE]   writes the recipe with rows that they share
python consensus.py STUDIO DATA WORK [--shapes] [--write PAGE] [--recipe RECIPE]     errors on each artist's head
WORK as for judge.py; needs numpy and scipy. Artists: facecap, faceunits, vitruvian, ict; for licences see NOTICE.

rows      For every shape: the displacements of the 78 control points in the face's frame and unit, of both sides where there are
          both, are made as long as 1 together. Their mean, weighted by the square root of that length (faint shapes say less) and by
          how far the artist agrees with the others over all shapes (1 / (0.15 + v), where the mean cosine of two artists is
          1 / sqrt((1 + v)(1 + w))), is the direction; the geometric mean of the lengths is the extent. Points that move less than
          0.006 stay. A jaw that slides goes with chin and lower lip; a point takes its part of that, and in `move` what is left.
          After each row stands the spread: how far the artists' rows, made as long, lie from it (root of the weighted mean square).
          Shapes without an artist, and those that turn the jaw, close lids, undo another shape or move the tongue, stay as they are;
          so do KEPT, unless who made them is to have no say.
errors    For each artist the recipe is made from the others alone and baked on the artist's head; shapes that no other artist has are
          left out. Error as in judge.py: |g b - t| / |t| with the best gain g, over the skin that a camera in front sees. Beside it
          what the others themselves do: their shapes carried over (judge.py: carried). A gain below 1: ours goes too far.
"""
import argparse
import pathlib
import re
import subprocess
import tomllib

import numpy as np

import judge
import verdict
from mesh import Head, polygons, positions, unit

SIDE = re.compile(r"_(L|R)(?=$|_|\d)")
STILL, LEFT_OVER, DOUBT = 0.006, 0.015, 0.15
SOURCE = pathlib.Path(__file__).parents[2]
NAMES = re.search(r'POINTS: &str = "([^"]*)"', (SOURCE / "src/baking/bake/names.rs").read_text())[1].split()
OTHER = {"L": "R", "R": "L"}
MIRROR = [NAMES.index(SIDE.sub(lambda m: "_" + OTHER[m[1]], name, count=1)) for name in NAMES]
OUTWARDS = np.array([-1.0 if (m := SIDE.search(name)) and m[1] == "R" else 1.0 for name in NAMES])
JAW = [NAMES.index(name) for name in "chin jaw_L1 jaw_R1 lip_lower lip_lower_L1 lip_lower_R1".split()]
# Shapes that stop short of the mean extent: beyond it a head of tests/heads/run shows folds, or skin from behind at the mouth.
EASED = {"mouthRollUpper": 0.9, "mouthPressLeft": 0.9, "mouthUpperUpLeft": 0.9, "mouthShrugUpper": 0.8}
# Shapes whose rows stay as ICT, Vitruvian and hand made them: on the two other artists' heads they err less than the mean of the rest.
KEPT, BY = {"browDownLeft", "mouthSmileLeft", "eyeLookUpLeft"}, {"ict", "vitruvian"}
BEGIN, END = "<!-- tests/heads/run --artists -->\n", "<!-- end -->"


class Artist:
    """A head with the shapes that somebody sculpted on it."""

    def __init__(self, name, text, marks, shapes):
        self.name, self.marks, self.shapes = name, marks, shapes
        self.head = head = Head(positions(text), polygons(text), marks)
        self.points = [*marks, *derived(head)]
        self.x = ((head.p[self.points] - head.p[marks[27]]) @ head.axes)[:, 0] / head.w
        lids = head.p[marks[[43, 44, 40, 41]]] - head.p[marks[[47, 46, 38, 37]]]
        self.opening = np.linalg.norm(lids, axis=1).mean() / head.w
        for both in ("cheekPuff", "browInnerUp"):
            if both not in shapes and both + "Right" in shapes:
                shapes[both] = shapes[both + "Left"] + shapes[both + "Right"]

    def rows(self, name):
        """Mean of the shape and the mirror image of its other side, eye distances in the face's frame; None if it is not there."""
        at = lambda d: d[self.points] @ self.head.axes / self.head.w
        found = [at(self.shapes[name])] if name in self.shapes else []
        other = name.replace("Left", "Right")
        found += [flipped(at(self.shapes[other]))] if other in self.shapes else []
        if found:
            return np.mean(found, axis=0)
        if name == "browInnerUp" and (left := self.rows(name + "Left")) is not None:
            return left + flipped(left)
        # A shape of both sides at once is one of each, cut in the middle.
        both = [d for n, d in self.shapes.items() if name in n.split("+")] + [self.shapes.get(name.removesuffix("Left"))]
        return at(both[0]) * np.clip(0.5 + self.x / 0.3, 0, 1)[:, None] if both[0] is not None else None


def flipped(rows):
    return (rows * [-1, 1, 1])[MIRROR]


def derived(head):
    """The ten points on cheeks and forehead."""
    p, up, out = head.p[head.landmarks], head.axes[:, 1], head.axes[:, 2]
    t, normal = head.triangles, np.zeros_like(head.p)
    for k in range(3):
        np.add.at(normal, t[:, k], np.cross(head.p[t[:, 1]] - head.p[t[:, 0]], head.p[t[:, 2]] - head.p[t[:, 0]]))
    some = head.skin & (unit(normal) @ out > 0.1)
    some[head.landmarks] = False
    some = np.flatnonzero(some)
    for side in (range(68), MIRROR):
        at = [p[side[k]] for k in range(68)]
        aims = [(at[47] + at[35]) / 2, (at[46] + at[54] + at[14]) / 3, (at[54] + at[11]) / 2]
        for aim in [*aims, at[24] + up * 0.5 * head.w, at[23] + up * 1.1 * head.w]:
            far = head.p[some] - aim
            yield some[np.argmin((far**2).sum(1) - 0.9 * (far @ out) ** 2)]


def taught(entry):
    return not entry.keys() & {"undo", "tongue", "close", "jaw_opens"}


def trust(artists, recipe):
    """Weight of each artist, by how far the others agree."""
    equations, known = [], []
    for i, a in enumerate(artists):
        for j, b in enumerate(artists[:i]):
            pairs = [(a.rows(e["name"]), b.rows(e["name"])) for e in recipe if taught(e)]
            pairs = [(x, y) for x, y in pairs if x is not None and y is not None and x.any() and y.any()]
            cosine = np.mean([(x * y).sum() / np.linalg.norm(x) / np.linalg.norm(y) for x, y in pairs])
            equations.append(np.sqrt(len(pairs)) * np.isin(range(len(artists)), [i, j]))
            known.append(-2 * np.sqrt(len(pairs)) * np.log(cosine))
    doubt = np.exp(np.maximum(np.linalg.lstsq(np.array(equations), known)[0], 0)) - 1
    return 1 / (DOUBT + doubt)


def consensus(entry, artists, trusted):
    """Rows that the artists share, their spread, and how long each artist's are."""
    found = [(a.rows(entry["name"]), w, a.opening) for a, w in zip(artists, trusted)]
    found = [(rows, w, opening) for rows, w, opening in found if rows is not None and rows.any()]
    if not found or not taught(entry):
        return None
    eyes = entry.get("in") == "eye_opening"
    rows = np.array([r / (opening if eyes else 1) for r, _, opening in found])
    length = np.sqrt((rows**2).sum((1, 2)))
    weight = np.array([w for _, w, _ in found]) * np.sqrt(length)
    weight /= weight.sum()
    rows /= length[:, None, None]
    mean = np.einsum("i,ijk->jk", weight, rows)
    extent = np.exp(np.log(length).mean()) * EASED.get(entry["name"], 1)
    mean *= extent / np.linalg.norm(mean)
    if "mirror" not in entry:
        mean = (mean + flipped(mean)) / 2
    mean[np.linalg.norm(mean, axis=1) < STILL] = 0
    spread = np.sqrt(weight @ ((rows * extent - mean) ** 2).sum(2))
    return mean, spread, length / extent


def grouped(values, spread, kept):
    """Lines of TOML, points with like values in one."""
    alike = {}
    for k in filter(kept, range(len(values))):
        way = tuple(np.round(np.atleast_1d(values[k]), 2) + 0.0)
        alike.setdefault(way, []).append(k)
    lines = []
    for way, points in alike.items():
        both = lambda k: SIDE.sub("_S", NAMES[k], count=1) if MIRROR[k] in points and MIRROR[k] != k else NAMES[k]
        words = " ".join(dict.fromkeys(map(both, points)))
        lines.append(f'  ["{words}", {", ".join(f"{x:.2f}" for x in way)}],  # {max(spread[points]):.2f}\n')
    return lines


def moves(rows, spread, derived=True):
    rows = rows * np.column_stack([OUTWARDS, np.ones((78, 2))])
    return grouped(rows, spread, lambda k: derived and k >= 68 or np.round(rows[k], 2).any())


def replaced(text, name, key, value):
    """The recipe with another value of a shape's key."""
    start = text.index(f'name = "{name}"\n')
    end = text.find("\n\n", start) % (len(text) + 1)
    block, old = text[start:end], re.compile(rf"^{key} = (?:\[[^\n]*\]|\[.*?^\])$", re.M | re.S)
    block = old.sub(lambda _: value, block, count=1) if old.search(block) else block + "\n" + value
    return text[:start] + block + text[end:]


def shared(text, artists):
    """The recipe with the rows that artists share."""
    recipe = tomllib.loads(text)["shape"]
    trusted = trust(artists, recipe)
    for entry in recipe:
        found = consensus(entry, artists, trusted)
        if found is None or entry["name"] in KEPT and BY <= {a.name for a in artists}:
            continue
        (rows, spread, lengths), name = found, entry["name"]
        if "jaw" in entry:
            shift = rows[JAW].mean(0) * ([0, 1, 1] if "mirror" not in entry else [1, 0, 0])
            share = np.clip(rows @ shift / (shift @ shift), 0, 1)
            share = np.round((share + share[MIRROR]) / 2, 2)
            text = replaced(text, name, "jaw_shift", f"jaw_shift = [{', '.join(f'{x:.3f}' for x in shift)}]")
            text = replaced(text, name, "jaw", "jaw = [\n" + "".join(grouped(share, spread, lambda k: share[k] > 0.01)) + "]")
            rows = rows - share[:, None] * shift
            rows[68:] = 0
            rows[np.linalg.norm(rows, axis=1) < LEFT_OVER] = 0
        head = f"move = [  # {len(lengths)} artists, whose rows are {min(lengths):.2f} to {max(lengths):.2f} times as long\n"
        text = replaced(text, name, "move", head + "".join(moves(rows, spread, "jaw" not in entry)) + "]")
    return text


def errors(artists, options):
    """Of each artist: errors and gains of ours, and errors of the others' shapes carried over, by shape."""
    for a in artists:
        folder = options.work / a.name / "left-out"
        folder.mkdir(parents=True, exist_ok=True)
        others = [b for b in artists if b is not a]
        (folder / "recipe.toml").write_text(shared(options.recipe.read_text(), others))
        (folder / "h.txt").write_text("".join(f"{v}\n" for v in a.marks))
        words = ["--mesh", options.work / a.name / "head.obj", "--landmarks", folder / "h.txt", "--out", folder / "h.glb"]
        words = [options.studio, "bake", *words, "--obj", folder / "obj", "--recipe", folder / "recipe.toml"]
        subprocess.run(list(map(str, words)), check=True, stdout=subprocess.DEVNULL)
        d = judge.baked(folder)[2]
        known = {n: t for n, t in a.shapes.items() if any(t.any() and b.rows(left(n)) is not None for b in others)}
        ours, gains = judge.errors(a.head, d, known, gains=True)
        carried = {b.name: judge.errors(a.head, judge.carried(a.head, b.head, b.shapes), known) for b in others}
        yield a.name, ours, gains, carried


def left(name):
    return name if name in ("mouthLeft", "mouthRight", "jawLeft", "jawRight") else name.replace("Right", "Left")


def table(found):
    """One line an artist; means with the worst shape beside."""
    mean = lambda e: f"{np.mean([*e.values()]):.3f} ({max(e, key=e.get)} {max(e.values()):.2f})"
    lines = [["head", "shapes", "ours", "ICT carried over", "ours worse", "mean of the other artists", "ours worse"]]
    lines.append(["---"] * len(lines[0]))
    for name, ours, _, carried in found:
        ict = carried.get("ict", {})
        both = {n: e for n, e in ours.items() if any(n in c for c in ([ict] if ict else carried.values()))}
        others = {n: np.mean([c[n] for c in carried.values() if n in c]) for n in both}
        worse = lambda theirs: str(sum(both[n] > theirs[n] for n in both))
        cells = [mean(ict), worse(ict)] if ict else ["", ""]
        lines.append([name, str(len(both)), mean(both), *cells, mean(others), worse(others)])
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)


def each(found):
    """Every shape: ours with its gain, and the others'."""
    for name, ours, gains, carried in found:
        print(f"{name:36}{'ours':>8}{'gain':>8}" + "".join(f"{other:>11}" for other in carried))
        for n in ours:
            print(f"   {n:33}{ours[n]:8.2f}{gains[n]:8.2f}" + "".join(f"{c.get(n, np.nan):11.2f}" for c in carried.values()))


def main():
    ask = argparse.ArgumentParser()
    ask.add_argument("studio", type=pathlib.Path)
    ask.add_argument("data", type=pathlib.Path)
    ask.add_argument("work", type=pathlib.Path)
    ask.add_argument("--recipe", type=pathlib.Path, default=SOURCE / "config/blendshapes.toml")
    ask.add_argument("--rows", type=pathlib.Path, help="writes the recipe with the rows that artists share")
    ask.add_argument("--without", default="", help="the artist who has no say in --rows")
    ask.add_argument("--shapes", action="store_true", help="every shape")
    ask.add_argument("--write", type=pathlib.Path, help="puts the table into this page, between its marks")
    options = ask.parse_args()
    for name in ("facecap", "faceunits", "vitruvian"):
        head = judge.heads(options.data, options.work)[name]()[0]
        judge.bake(options.studio, head, "aoi", options.work / name)
    artists = [Artist(*found) for found in verdict.artists(options.data, options.work)]
    if options.rows:
        text = shared(options.recipe.read_text(), [a for a in artists if a.name != options.without])
        options.rows.write_text(text)
        return
    for a, (_, text, *_) in zip(artists, verdict.artists(options.data, options.work)):
        (options.work / a.name).mkdir(parents=True, exist_ok=True)
        (options.work / a.name / "head.obj").write_text(text)
    found = list(errors(artists, options))
    if options.shapes:
        each(found)
    print(table(found), end="")
    if options.write:
        before, rest = options.write.read_text().split(BEGIN)
        options.write.write_text(before + BEGIN + table(found) + END + rest.split(END)[1])


if __name__ == "__main__":
    main()
