"""Draws docs/beside-mediapipe.svg from the tables that tests/peers/run writes into docs/results.md.

plot.py [--check]      --check: exit 1 if the picture is not what the tables say

One row a condition: the mean landmark error of mien and of MediaPipe, with a line from the best to the worst scene where a row
sums up several, and the share of frames in which either reports a face. Light or dark as the reader's system asks for.
"""
import os
import re
import sys

ROOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../..")
TABLES, PICTURE = os.path.join(ROOT, "docs/results.md"), os.path.join(ROOT, "docs/beside-mediapipe.svg")
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
WIDE, LEFT, RIGHT, FOUND, END, TOP, STEP = 860, 260, 600, 670, 810, 92, 30
MOST, LEAST_FOUND = 5.0, 85.0


def scenes():
    """Name, found (mien, peer) in %, error (mien, peer) of every row of the tables."""
    text = open(TABLES, encoding="utf-8").read().split("<!-- begin tests/peers/run -->")[1].split("<!-- end")[0]
    for line in text.splitlines():
        cells = [cell.strip().replace("*", "") for cell in line.strip("|").split("|")]
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


def drawn():
    rows = list(grouped())
    tall = TOP + STEP * len(rows) + 30
    x = lambda error: LEFT + (RIGHT - LEFT) * error / MOST
    at = lambda share: FOUND + (END - FOUND) * (max(share, LEAST_FOUND) - LEAST_FOUND) / (100 - LEAST_FOUND)
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
    put("text", "Landmark error, % of the outer-eye distance", class_="title", x=LEFT, y=30)
    put("text", "Frames with a face, %", class_="title", x=FOUND, y=30)
    for k, kind in enumerate(("mien", "MediaPipe")):
        mark(kind.lower(), LEFT + 8 + 90 * k, 52)
        put("text", kind, x=LEFT + 22 + 90 * k, y=57)
    bottom = TOP + STEP * len(rows) - 12
    for error in range(int(MOST) + 1):
        put("line", class_="grid", x1=x(error), x2=x(error), y1=TOP - 16, y2=bottom)
        put("text", error, class_="tick", x=x(error), y=bottom + 22)
    for share in (85, 90, 95, 100):
        put("line", class_="grid", x1=at(share), x2=at(share), y1=TOP - 16, y2=bottom)
        put("text", share, class_="tick", x=at(share), y=bottom + 22)
    for n, (label, shares, errors) in enumerate(rows):
        y = TOP + STEP * n + 6
        put("text", label, class_="label" if errors else "label title", x=LEFT - 16, y=y + 5)
        if not errors:
            continue
        # The peer first, so that mien's mark lies on top where they meet.
        for k, kind, up in ((1, "mediapipe", 5), (0, "mien", -5)):
            values = [error[k] for error in errors]
            if len(values) > 1:
                put("line", class_=f"span {kind}", x1=x(min(values)), x2=x(min(max(values), MOST)), y1=y + up, y2=y + up)
            mark(kind, x(sum(values) / len(values)), y + up)
            found = sum(share[k] for share in shares) / len(shares)
            mark(kind, at(found), y + up)
            if found < 99.95:
                put("text", f"{found:.1f}", class_="value", x=at(found) - 11, y=y + up + 5)
    title = "Landmark error and share of frames with a face, mien beside MediaPipe, by condition"
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
    picture = drawn()
    if "--check" in sys.argv[1:]:
        if not os.path.exists(PICTURE) or open(PICTURE, encoding="utf-8").read() != picture:
            sys.exit("docs/beside-mediapipe.svg is not what docs/results.md says: run tests/peers/plot.py")
        return
    with open(PICTURE, "w", encoding="utf-8") as file:
        file.write(picture)


main()
