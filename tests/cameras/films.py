"""Writes a film of grey pictures (YUV4MPEG2) to standard output.

films.py DATA upright|upside-down|negative|talking|hour      (numpy, OpenCV)
"""
import glob
import os
import sys

import cv2
import numpy as np

# Frames for which each portrait is shown.
SHOWN = 12
# Data sets of photographs of one face each, the most pictures of each set, and a room without a face.
PORTRAITS = [("faces_frl189", 200), ("faces_ytfaces68", 150), ("faces_dlib68", 10), ("faces_cootes58", 20), ("kinect_v1_desk", 64)]
SIZE = (640, 480)


def pictures(data):
    """Paths of all pictures, with the name of their set, in a fixed order."""
    for folder, most in PORTRAITS:
        files = glob.glob(os.path.join(data, folder, "**", "*.*"), recursive=True)
        files = sorted(f for f in files if f.lower().endswith((".jpg", ".jpeg", ".png", ".ppm")) and "depth" not in f)
        # Spread over the set.
        for k in range(min(most, len(files))):
            yield folder, files[k * len(files) // min(most, len(files))]


def fitted(grey):
    """The picture in the upper left corner of a frame, as large as it fits."""
    scale = min(SIZE[0] / grey.shape[1], SIZE[1] / grey.shape[0])
    grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    frame = np.full((SIZE[1], SIZE[0]), 90, np.uint8)
    frame[: grey.shape[0], : grey.shape[1]] = grey
    return frame


CHANGES = {"upright": lambda g: g, "upside-down": lambda g: g[::-1], "negative": lambda g: 255 - g}


def hour(data):
    """An hour without a face: a new part of a picture every second, upside down or as a negative, under a moving camera."""
    random = np.random.default_rng(1)
    greys = [fitted(cv2.imread(path, cv2.IMREAD_GRAYSCALE)) for _, path in pictures(data)]
    for _ in range(3600):
        grey = greys[random.integers(len(greys))]
        is_negative = random.random() < 0.5
        turn = random.uniform(-30, 30) + (0 if is_negative else 180)
        start, end = random.uniform((160, 120), (480, 360), (2, 2))
        zoom = random.uniform(0.8, 3.0)
        for share in np.arange(30) / 30:
            middle = start + (end - start) * share
            turned = cv2.getRotationMatrix2D(tuple(middle), turn, zoom)
            turned[:, 2] += np.array(SIZE) / 2 - middle
            frame = cv2.warpAffine(grey, turned, SIZE, borderMode=cv2.BORDER_REPLICATE)
            yield 255 - frame if is_negative else frame


def frames(data, film):
    if film == "hour":
        yield from hour(data)
        return
    if film == "talking":
        for path in sorted(glob.glob(os.path.join(data, "video_talkingface", "img", "*.jpg"))):
            yield cv2.imread(path, cv2.IMREAD_GRAYSCALE)
        return
    for _, path in pictures(data):
        frame = CHANGES[film](fitted(cv2.imread(path, cv2.IMREAD_GRAYSCALE)))
        for _ in range(SHOWN):
            yield frame


def main():
    out, first = sys.stdout.buffer, True
    for frame in frames(sys.argv[1], sys.argv[2]):
        if first:
            rate = "24:1" if sys.argv[2] == "talking" else "30:1"
            out.write(f"YUV4MPEG2 W{frame.shape[1]} H{frame.shape[0]} F{rate} Ip A1:1 Cmono\n".encode())
            first = False
        out.write(b"FRAME\n" + np.ascontiguousarray(frame).tobytes())


if __name__ == "__main__":
    main()
