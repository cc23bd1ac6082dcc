"""Outputs of the reference interpreter on a drawn person, for core/face/src/nets/golden.rs.

    pip install ai-edge-litert==2.3.0 numpy
    python make.py FOLDER_OF_TFLITE_FILES

One file a network: all its outputs one after the other as little-endian f32; of the segmentation every 16th value.
"""
import sys

import numpy as np
from ai_edge_litert.interpreter import Interpreter


def person(side):
    """A coarse person on a textured ground in whole numbers, 0 to 255."""
    y, x = np.mgrid[0:side, 0:side] * 256 // side
    ground = np.stack([30 + (x * 7 + y * 3) % 40, 110 + (x * 5 + y * 11) % 30, 60 + x * y % 23], -1)
    image = ground.copy()

    def blob(cx, cy, rx, ry, colour):
        inside = ((x - cx) * ry) ** 2 + ((y - cy) * rx) ** 2 < (rx * ry) ** 2
        image[inside] = np.array(colour) + (ground[inside] % 13)

    blob(128, 250, 90, 70, (60, 60, 90))
    blob(128, 170, 30, 50, (190, 140, 115))
    blob(128, 105, 52, 70, (205, 155, 130))
    blob(128, 50, 56, 30, (50, 35, 25))
    for eye in (106, 150):
        blob(eye, 98, 10, 5, (235, 235, 230))
        blob(eye, 98, 5, 5, (40, 25, 15))
        blob(eye, 84, 14, 3, (50, 35, 25))
    blob(128, 122, 8, 12, (185, 130, 105))
    blob(128, 145, 20, 6, (170, 80, 80))
    return image


NETS = [
    ("face_detection_short_range", 128, (2 / 255, -1.0), 1),
    ("face_landmark", 192, (1 / 255, 0.0), 1),
    ("selfie_segmentation", 256, (1 / 255, 0.0), 16),
    ("iris_landmark", 64, (1 / 255, 0.0), 1),
]
for name, side, (scale, offset), step in NETS:
    net = Interpreter(model_path=f"{sys.argv[1]}/{name}.tflite")
    net.allocate_tensors()
    image = person(side).astype(np.float32) * np.float32(scale) + np.float32(offset)
    net.set_tensor(net.get_input_details()[0]["index"], image[None])
    net.invoke()
    values = np.concatenate([net.get_tensor(output["index"]).ravel()[::step] for output in net.get_output_details()])
    values.astype("<f4").tofile(f"{name}.f32")
    print(name, values.size, float(values.min()), float(values.max()))
