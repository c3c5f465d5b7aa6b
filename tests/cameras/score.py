"""Table of what `mien run` finds in the films of films.py.

score.py DATA TABLES      (numpy)
"""
import csv
import os
import sys

import numpy as np

from films import PORTRAITS, SHOWN, pictures

SEEN = ("warming", "tracking")


def rows(path):
    with open(path) as file:
        return [row for row in csv.DictReader(file)]


def main():
    data, tables = sys.argv[1:]
    sets = [folder for folder, _ in pictures(data)]
    found = {}
    for film in ("upright", "upside-down", "negative"):
        seen = [r for r in rows(os.path.join(tables, film + ".csv")) if r["state"] in SEEN]
        # A face of the picture before may be seen in the first frame of the next.
        found[film] = {int(r["frame"]) // SHOWN for r in seen if int(r["frame"]) % SHOWN}
    print("| pictures | number | face found upright | upside down | negative |")
    print("| --- | --- | --- | --- | --- |")
    for folder, _ in PORTRAITS:
        numbers = [k for k, name in enumerate(sets) if name == folder]
        if numbers:
            cells = [f"{sum(k in found[film] for k in numbers)}" for film in ("upright", "upside-down", "negative")]
            print(f"| `{folder}` | {len(numbers)} | {' | '.join(cells)} |")
    hour = os.path.join(tables, "hour.csv")
    if os.path.exists(hour):
        seen = [r for r in rows(hour) if r["state"] in SEEN]
        seconds = sorted({int(r["frame"]) // 30 for r in seen})
        print(f"\nhour without a face: one seen in {len(seen)} frames of {len(seconds)} of 3600 seconds", *seconds[:20])
    talking = rows(os.path.join(tables, "talking.csv"))
    with_face = [r for r in talking if r["state"] in SEEN]
    if with_face:
        points = np.array([[[float(r[f"{a}{i}"]) for a in "xy"] for i in range(68)] for r in with_face])
        eyes = np.linalg.norm(points[:, 36] - points[:, 45], axis=1).mean()
        # Second differences: what a steady motion does not explain.
        noise = np.linalg.norm(np.diff(points, 2, axis=0), axis=2) / np.sqrt(6)
        still = np.median(noise, axis=1)
        print(f"\ntalking face: a face in {len(with_face)} of {len(talking)} frames, first in frame {with_face[0]['frame']};",
              f"noise of the points from frame to frame {100 * np.percentile(still, 25) / eyes:.2f} % of the outer-eye distance in the quieter",
              f"quarter of the frames")


if __name__ == "__main__":
    main()
