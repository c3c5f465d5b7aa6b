"""Pictures of a session's frames in which a gesture goes on, with its name: pictures.py SESSION TABLE NAME"""
import csv
import sys

import cv2

session, table, name = sys.argv[1:]
with open(f"{session}/INDEX.txt") as f:
    colour = [line.strip() for line in f if line.startswith("r-")]
before = {}
with open(table) as f:
    for row in csv.DictReader(f):
        for gesture in (k for k in row if k.startswith("g_")):
            on, key = row[gesture] == "1", (row["user"], gesture)
            if on and not before.get(key):
                picture = cv2.imread(f"{session}/{colour[int(row['frame'])]}")
                cv2.imwrite(f"{name}-{row['frame']}-{gesture[2:]}.jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 80])
            before[key] = on
