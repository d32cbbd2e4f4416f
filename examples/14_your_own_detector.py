"""Masks of a detector of your own, which ran elsewhere, become a scene that is planned in.

RF-DETR, YOLO and others write what they find as COCO: a bbox, a score, and a segmentation as
polygons or run lengths. Here the file holds the true masks of a rendered picture; put yours in its
place, and your picture by `load_picture`. `optipromp see DIR --boxes FILE` does the same.

    python examples/14_your_own_detector.py    (needs the packages optipromp-eyes and -sim)
"""

import json

import numpy as np

from optipromp import plan_pick
from optipromp_eyes import ByDetector, look_at, seen_scene
from optipromp_eyes.detector import of_coco
from optipromp_sim.generate import generate
from optipromp_sim.simulation.photograph import photograph

KINDS = "ripe", "unripe", "stem"
true = generate("cluster", 3)
shot = photograph(true, seed=3)
found = []
for value, mark in enumerate(shot.marked, start=1):
    if mark.kind in KINDS and (mask := shot.masks == value).any():
        ends = np.flatnonzero(np.diff(mask.ravel(order="F"))) + 1  # columns after columns
        runs = {"size": [480, 640], "counts": np.diff([0, *ends, mask.size]).tolist()}
        found.append({"image_id": 1, "category_id": KINDS.index(mark.kind), "score": 0.9,
                      "bbox": [0, 0, 640, 480], "segmentation": runs})  # fmt: skip
image = {"id": 1, "file_name": "row.rgb.png", "width": 640, "height": 480}
names = [{"id": k, "name": name} for k, name in enumerate(KINDS)]
file = json.dumps({"images": [image], "categories": names, "annotations": found})

finder = ByDetector.of(of_coco(json.loads(file), "detections.json")["row"])
sight = look_at(shot.picture, up=true.up, finder=finder)
scene, assumed = seen_scene(sight, true)
picked = plan_pick(scene, seed=0)
print(*assumed, f"{len(sight.detections)} fruits: {picked.message}", sep="\n")
raise SystemExit(0 if picked.success else 1)
