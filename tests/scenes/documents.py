"""Scene documents that tests begin with."""

import copy

FRUIT = {"id": "ripe", "role": "target", "shape": {"sphere": {"radius": 0.015}}}
FRUIT["position"] = [0.45, 0.0, 0.89]
MINIMAL = {"format": 1, "name": "s", "robot": "panda", "objects": [FRUIT]}


def with_object(**entries):
    document = copy.deepcopy(MINIMAL)
    document["objects"].append(
        {"id": "n1", "role": "pushable", "shape": {"sphere": {"radius": 0.015}}}
        | {"position": [0.4, 0.0, 0.8]}
        | entries
    )
    return document


def with_fruit(**entries):
    document = copy.deepcopy(MINIMAL)
    document["objects"][0].update(entries)
    return document
