"""Draws docs/beside-mediapipe.svg and docs/weights-beside-mediapipe.svg from the tables that tests/peers/run writes into docs/results.md.

plot.py [--check]      --check: exit 1 if a picture is not what the tables say

The first has a row for each condition: the mean landmark error of mien and of MediaPipe, with a line from the best to the worst scene
where a row sums up several, and the share of frames in which either reports a face. The second has one for each unit, the mean of its
sides: correlation of the weight with what is acted, and how loud it is at rest. Light or dark as the reader's system asks for.
"""
import os
import re
import sys

ROOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../..")
TABLES = os.path.join(ROOT, "docs/results.md")
# Headings, and labels with the rows they sum up; a scene that is in no row keeps its own name.
ROWS = [
    ("Second simulated world", None),
    ("sitting", r"second world, (hairy|person\d+)"),
    ("turning the head", r"second world, yaw"),
    ("changing light", r"second world, light"),
    ("glasses", r"second world, glasses"),
    ("hand in front of the face", r"second world, occlude"),
    ("holding still", r"second world, static"),
    ("Own simulator", None),
    ("hair, hats, glasses", r"own wild scenes, .*"),
    ("Real people", None),
    ("portraits, without depth", r"portraits of .*"),
    ("stills in infrared, with depth", r"six real faces, .*"),
]
UNITS = [
    ("Brows", None), ("raised inside (AU1)", "AU1"), ("raised outside (AU2)", "AU2"), ("lowered (AU4)", "AU4"),
    ("Lids", None), ("wide (AU5)", "AU5"), ("shut (AU43)", "AU43"),
    ("Cheeks and nose", None), ("cheeks raised (AU6)", "AU6"), ("nose wrinkled (AU9)", "AU9"), ("cheeks puffed (AU34)", "AU34"),
    ("Mouth", None), ("upper lip raised (AU10)", "AU10"), ("smile (AU12)", "AU12"), ("dimples (AU14)", "AU14"),
    ("corners lowered (AU15)", "AU15"), ("chin raised (AU17)", "AU17"), ("pucker (AU18)", "AU18"), ("stretched (AU20)", "AU20"),
    ("funnel (AU22)", "AU22"), ("open (AU25)", "AU25"), ("lips drawn in (AU28)", "AU28"),
    ("Jaw", None), ("dropped (AU26)", "AU26"), ("forward (AU29)", "AU29"), ("to a side (AU30)", "AU30"),
]
WIDE, LEFT, RIGHT, FOUND, END, TOP, STEP = 860, 260, 600, 670, 810, 92, 30


def cells_of(command):
    """Cells of the lines that this command writes into the page."""
    text = open(TABLES, encoding="utf-8").read().split(f"<!-- begin {command} -->")[1].split("<!-- end")[0]
    for line in text.splitlines():
        yield [cell.strip().replace("*", "") for cell in line.strip("|").split("|")]


def scenes():
    """Name, found (mien, peer) in %, error (mien, peer) of every row of the tables."""
    for cells in cells_of("tests/peers/run"):
        if len(cells) > 4 and re.match(r"[\d.]+ %", cells[1]):
            share = tuple(float(cell.split()[0]) for cell in cells[1:3])
            error = re.match(r"([\d.]+) / ([\d.]+)", cells[4])
            yield cells[0], share, (float(error[1]), float(error[2]))


def grouped():
    """Label, number of scenes, their shares and errors, in the order of ROWS."""
    left = list(scenes())
    for label, pattern in ROWS:
        if pattern is None:
            yield label, [], []
            continue
        ours = [scene for scene in left if re.fullmatch(pattern, scene[0])]
        left = [scene for scene in left if scene not in ours]
        if ours:
            many = f" ({len(ours)} people)" if len(ours) > 1 else ""
            yield label + many, [share for _, share, _ in ours], [error for *_, error in ours]
    for name, share, error in left:
        yield name, [share], [error]


def units():
    """Label, rest and correlation (mien, peer) of every unit, in the order of UNITS; a heading has none."""
    found = {}
    for cells in cells_of("tests/peers/run --weights"):
        if cells[0].startswith("By unit, in our own"):
            break
        unit = re.fullmatch(r"(AU\d+)[LR]?", cells[0])
        if unit and "/" in cells[2] and "/" in cells[3]:
            found.setdefault(unit[1], []).append([[float(v) for v in cells[k].split(" / ")] for k in (3, 2)])
    heading = None
    for label, unit in UNITS:
        if unit is None:
            heading = label
        elif unit in found:
            if heading:
                yield heading, [], []
            heading = None
            rest, correlation = (tuple(sum(values) / len(values) for values in zip(*side)) for side in zip(*found[unit]))
            yield label, [rest], [correlation]


class Axis:
    """From left to right in pixels, from least to most in the table's unit; what is beyond lies on the edge."""

    def __init__(self, title, left, right, least, most, ticks):
        self.title, self.left, self.right, self.least, self.most, self.ticks = title, left, right, least, most, ticks

    def __call__(self, value):
        return self.left + (self.right - self.left) * (min(max(value, self.least), self.most) - self.least) / (self.most - self.least)


# What a picture shows, its rows, the axis of what stands last in a row, that of what stands before it, and below what the latter is written.
PICTURES = {
    "docs/beside-mediapipe.svg": (
        "Landmark error and share of frames with a face, mien beside MediaPipe, by condition", grouped,
        Axis("Landmark error, % of the outer-eye distance", LEFT, RIGHT, 0, 5, (0, 1, 2, 3, 4, 5)),
        Axis("Frames with a face, %", FOUND, END, 85, 100, (85, 90, 95, 100)), 99.95),
    "docs/weights-beside-mediapipe.svg": (
        "Correlation of weights with what is acted and their rest, mien beside MediaPipe, by unit", units,
        Axis("Correlation with what is acted", LEFT, RIGHT, 0, 1, (0, 0.2, 0.4, 0.6, 0.8, 1)),
        Axis("Rest, 95th percentile", FOUND, END, 0, 0.6, (0, 0.2, 0.4, 0.6)), 0),
}


def drawn(title, rows, x, at, written_below):
    rows = list(rows())
    tall = TOP + STEP * len(rows) + 30
    out = []
    put = lambda name, text="", **keys: out.append(
        f"<{name} " + " ".join(f'{k.rstrip("_").replace("_", "-")}="{v:.1f}"' if isinstance(v, float) else
                               f'{k.rstrip("_").replace("_", "-")}="{v}"' for k, v in keys.items()) +
        (f">{text}</{name}>" if text != "" else "/>"))

    def mark(kind, cx, cy):
        if kind == "mien":
            put("circle", class_=kind, cx=float(cx), cy=float(cy), r=5.5)
        else:
            put("rect", class_=kind, x=float(cx - 5), y=float(cy - 5), width=10, height=10)

    put("rect", class_="page", x=0.5, y=0.5, width=WIDE - 1, height=tall - 1, rx=8)
    for axis in (x, at):
        put("text", axis.title, class_="title", x=axis.left, y=30)
    for k, kind in enumerate(("mien", "MediaPipe")):
        mark(kind.lower(), LEFT + 8 + 90 * k, 52)
        put("text", kind, x=LEFT + 22 + 90 * k, y=57)
    bottom = TOP + STEP * len(rows) - 12
    for axis in (x, at):
        for value in axis.ticks:
            put("line", class_="grid", x1=axis(value), x2=axis(value), y1=TOP - 16, y2=bottom)
            put("text", value, class_="tick", x=axis(value), y=bottom + 22)
    for n, (label, shares, errors) in enumerate(rows):
        y = TOP + STEP * n + 6
        put("text", label, class_="label" if errors else "label title", x=LEFT - 16, y=y + 5)
        if not errors:
            continue
        # The peer first, so that mien's mark lies on top where they meet.
        for k, kind, up in ((1, "mediapipe", 5), (0, "mien", -5)):
            values = [error[k] for error in errors]
            if len(values) > 1:
                put("line", class_=f"span {kind}", x1=x(min(values)), x2=x(max(values)), y1=y + up, y2=y + up)
            mark(kind, x(sum(values) / len(values)), y + up)
            found = sum(share[k] for share in shares) / len(shares)
            mark(kind, at(found), y + up)
            if found < written_below:
                put("text", f"{found:.1f}", class_="value", x=at(found) - 11, y=y + up + 5)
    return f"""<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDE} {tall}" width="{WIDE}" height="{tall}" role="img">
<title>{title}</title>
<style>
text {{ font: 14px system-ui, "Segoe UI", "DejaVu Sans", sans-serif; fill: #1f2328; }}
.title {{ font-weight: 600; }} .label, .value {{ text-anchor: end; }} .tick {{ text-anchor: middle; fill: #57606a; font-size: 13px; }}
.page {{ fill: #ffffff; stroke: #d0d7de; }} .grid {{ stroke: #d8dee4; }} .span {{ stroke-width: 3; opacity: .45; }}
.mien {{ fill: #0969da; stroke: #0969da; }} .mediapipe {{ fill: #bc4c00; stroke: #bc4c00; }}
@media (prefers-color-scheme: dark) {{
text {{ fill: #e6edf3; }} .tick {{ fill: #9da7b3; }} .page {{ fill: #0d1117; stroke: #30363d; }} .grid {{ stroke: #30363d; }}
.mien {{ fill: #58a6ff; stroke: #58a6ff; }} .mediapipe {{ fill: #f0883e; stroke: #f0883e; }}
}}
</style>
""" + "\n".join(out) + "\n</svg>\n"


def main():
    for name, what in PICTURES.items():
        path, picture = os.path.join(ROOT, name), drawn(*what)
        if "--check" not in sys.argv[1:]:
            with open(path, "w", encoding="utf-8") as file:
                file.write(picture)
        elif not os.path.exists(path) or open(path, encoding="utf-8").read() != picture:
            sys.exit(f"{name} is not what docs/results.md says: run tests/peers/plot.py")


main()
