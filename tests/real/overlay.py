"""What `mien run` follows, drawn into the real recordings frame by frame: contact sheets to be looked at. They show people and
stay on the machine.

overlay.py DATA CACHE TABLES OUT      (numpy, opencv-python-headless)

A tile of a film, a desk or real frames: depth in false colour (0.4 m red to 2 m blue), the head's box of the table white, that
of the truth magenta, the axes of the head (5 cm: red to the image's right, green down, blue out of the face), frame, slot,
state and confidence. A tile of a face: the last frame of a segment, infrared with the landmarks (green to red by confidence),
the truth's 15 points magenta, the axes, and the box.
OVERLAY_STEP=N draws every Nth frame of the film (default 2) and of the desk (default 6).
"""
import os
import sys

import cv2
import numpy as np

import score

# The depth camera's own view; a point of the colour picture lies about here in these recordings.
FOCAL_PX, CENTRE = 575.8, np.array([320.0, 240.0])
COLUMNS, TILE_ROWS = 6, 5
STATES = {"tracking": (80, 255, 80), "warming": (80, 255, 200), "posed": (255, 200, 80), "held": (80, 200, 255), "lost": (90, 90, 255)}
AXES = [((0.05, 0, 0), (60, 60, 255)), ((0, 0.05, 0), (60, 255, 60)), ((0, 0, -0.05), (255, 90, 60))]


class Session:
    """Files of a session by depth frame, and its scale of depth."""

    def __init__(self, folder):
        self.folder = folder
        with open(f"{folder}/INDEX.txt") as f:
            names = f.read().split()
        self.depth = [n for n in names if n.startswith("d-")]
        self.colour = [n for n in names if n.startswith("r-")]

    def depth_picture(self, n):
        with open(f"{self.folder}/{self.depth[n]}", "rb") as f:
            body = f.read()
        raw = np.frombuffer(body[-2 * 640 * 480:], "<u2").reshape(480, 640).astype(np.float32)
        # Even in 1/z, as the sensor's steps are: the usual formula of the raw value.
        near = 3.3309 - 0.0030711 * raw
        share = np.clip((near - 1 / 2.0) / (1 / 0.4 - 1 / 2.0), 0, 1)
        picture = cv2.applyColorMap((share * 255).astype(np.uint8), cv2.COLORMAP_JET)
        # Edges and folds show in the light of the surface's slope.
        slope = np.clip((cv2.blur(near, (3, 3)) - np.roll(cv2.blur(near, (3, 3)), (2, 2), (0, 1))) * 8 + 0.75, 0.35, 1)
        picture = (picture * slope[..., None]).astype(np.uint8)
        picture[raw >= 2047] = 0
        return picture

    def colour_picture(self, n):
        with open(f"{self.folder}/{self.colour[n]}", "rb") as f:
            body = f.read()
        return np.frombuffer(body[-3 * 640 * 480:], np.uint8).reshape(480, 640, 3)[..., ::-1].copy()


def draw_axes(picture, row):
    q = row.vector(["qx", "qy", "qz", "qw"])
    if row.position_m is None or q is None:
        return
    x, y, z, w = q / np.linalg.norm(q)
    turn = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])
    pixel = lambda p: tuple(int(v) for v in CENTRE + FOCAL_PX * p[:2] / max(p[2], 0.1))
    for tip, colour in AXES:
        cv2.line(picture, pixel(row.position_m), pixel(row.position_m + turn @ np.array(tip)), colour, 4, cv2.LINE_AA)


def draw_box(picture, box, colour, thick=2):
    x0, y0, x1, y1 = (int(round(float(v))) for v in box)
    cv2.rectangle(picture, (x0, y0), (x1 - 1, y1 - 1), colour, thick)


def write(picture, text, line, colour=(255, 255, 255)):
    at = (6, picture.shape[0] - 8 - 26 * line)
    cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.85, (0, 0, 0), 5, cv2.LINE_AA)
    cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.85, colour, 2, cv2.LINE_AA)


def tile(picture, rows, caption):
    rows = [r for r in rows if r.state != "absent"]
    for k, row in enumerate(rows):
        colour = STATES.get(row.state, (255, 255, 255))
        if row.box is not None:
            draw_box(picture, row.box, (255, 255, 255) if row.position_m is not None else (150, 150, 150))
        draw_axes(picture, row)
        write(picture, f"{row.user} {row.state} {float(row.values['confidence'] or 0):.2f}", k + 1, colour)
    write(picture, caption, 0)
    return cv2.resize(picture, (320, 240), interpolation=cv2.INTER_AREA)


def sheets(out, name, tiles, columns=COLUMNS, rows=TILE_ROWS):
    for k in range(0, len(tiles), columns * rows):
        part = tiles[k:k + columns * rows]
        blank = np.zeros_like(part[0])
        part += [blank] * (-len(part) % columns)
        lines = [np.hstack(part[i:i + columns]) for i in range(0, len(part), columns)]
        path = f"{out}/{name}-{k // (columns * rows)}.png"
        cv2.imwrite(path, np.vstack(lines))
        print(path)


def film(data, cache, tables, out, name, step, heads, caption):
    run = score.load(tables, name)
    if run is None:
        return
    session = Session(f"{cache}/{name}")
    tiles = []
    for n in sorted(set(range(0, len(session.depth), step)) | set(heads if step <= 2 else [])):
        picture = session.depth_picture(n)
        for head in heads.get(n, []):
            draw_box(picture, head, (255, 0, 255), 2)
        tiles.append(tile(picture, run.at(n), f"{n} {caption(n)}"))
    sheets(out, name, tiles)


def faces(cache, tables, out):
    for p in range(6):
        tiles = []
        for k in range(9):
            name = f"p{p:02}-{k}"
            run = score.load(tables, name)
            if run is None:
                continue
            session = Session(f"{cache}/{name}")
            for row in score.read(f"{cache}/{name}/truth.csv"):
                n, expression = int(row["to"]) - 1, int(row["expression"])
                picture = session.colour_picture(n)
                for r in run.at(n):
                    if r.face:
                        sure = [float(r.values[f"c{i}"] or 0) for i in range(68)]
                        for (x, y), c in zip(r.points(), sure):
                            cv2.circle(picture, (round(x), round(y)), 2, (0, int(255 * c), int(255 * (1 - c))), -1)
                for i in range(15):
                    cv2.circle(picture, (round(float(row[f"x{i}"])), round(float(row[f"y{i}"]))), 4, (255, 0, 255), 1)
                depth = session.depth_picture(n)
                # Only the face is there: both pictures cut to it, side by side.
                cut = (slice(80, 360), slice(180, 460))
                both = np.hstack([tile_cut(picture, run.at(n), cut, f"{k} {score.EXPRESSIONS[expression][:12]}", False),
                                  tile_cut(depth, run.at(n), cut, f"{n}", True)])
                tiles.append(both)
        if tiles:
            sheets(out, f"p{p:02}", tiles, 5, 6)


def tile_cut(picture, rows, cut, caption, axes):
    for row in rows:
        if row.box is not None and axes:
            draw_box(picture, row.box, (255, 255, 255))
        if axes:
            draw_axes(picture, row)
    picture = cv2.resize(picture[cut], (420, 420))
    write(picture, caption, 0)
    if axes:
        for k, row in enumerate(rows):
            write(picture, f"{row.state} {float(row.values['confidence'] or 0):.2f}", k + 1, STATES.get(row.state, (255, 255, 255)))
    return cv2.resize(picture, (200, 200), interpolation=cv2.INTER_AREA)


def main():
    data, cache, tables, out = sys.argv[1:]
    boxes = lambda r: [float(r[k]) for k in ("x0", "y0", "x1", "y1")]
    step = os.environ.get("OVERLAY_STEP")
    if os.path.exists(f"{cache}/film"):
        heads, facing = {}, {}
        for r in score.read(f"{data}/kinect_v1_film/heads.csv"):
            heads.setdefault(int(r["frame"]), []).append(boxes(r))
        for r in score.read(f"{data}/kinect_v1_film/facing.csv"):
            facing.update({f: r["facing"] for f in range(int(r["from"]), int(r["to"]) + 1)})
        for name in ("film", "film-depth"):
            film(data, cache, tables, out, name, int(step or 2), heads, lambda n: facing.get(n, ""))
    if os.path.exists(f"{cache}/desk"):
        heads = {}
        for r in score.read(f"{data}/kinect_v1_desk/heads.csv"):
            for held in range(6):
                heads.setdefault(int(r["source_frame"]) + held, []).append(boxes(r))
        film(data, cache, tables, out, "desk", int(step or 6), heads, lambda n: "")
    for name, marked in score.PCL_HEADS.items():
        if os.path.exists(f"{cache}/{name}"):
            film(data, cache, tables, out, name, 10, {n: marked for n in range(90)}, lambda n: "")
    faces(cache, tables, out)


if __name__ == "__main__":
    main()
