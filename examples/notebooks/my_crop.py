"""A crop of your own, planned, executed and seen; scripts/notebooks.py makes the notebook."""

# %% [markdown]
# # My crop
#
# A cluster of your own: where the fruits hang, how large they are, what they bear. The scene is
# planned, executed in the simulation, and planned again as a detector with errors would see it.
#
# The same as a script: `python examples/notebooks/my_crop.py` (needs the package `optipromp-sim`).

# %%
import tempfile
from pathlib import Path

from optipromp import load_scene, plan, simulate

# %% [markdown]
# A scene file lists objects. The ripe fruit is the `target`, the others are `pushable`, the gutter
# is `static`. A stem goes from the fruit to its root. Lengths are in metres.

# %%
SCENE = """
format: 1
name: my-crop
robot: panda
tool: {kind: cup, radius: 0.03}
start: [1.42, 1.10, -1.26, -2.42, -1.69, 1.02, 0.8]
target: ripe
objects:
  - {id: ripe, role: target, shape: {sphere: {radius: 0.017}},
     position: [0.45, 0.0, 0.80], stem: {root: [0.45, 0.01, 0.97]}}
  - {id: green, role: pushable, shape: {capsule: {radius: 0.014, length: 0.012}},
     position: [0.46, 0.025, 0.76], stem: {root: [0.46, 0.05, 0.97]}}
  - {id: white, role: pushable, shape: {sphere: {radius: 0.012}},
     position: [0.43, -0.02, 0.75], stem: {root: [0.43, -0.04, 0.97]}}
  - {id: gutter, role: static, shape: {box: {size: [0.1, 1.0, 0.05]}}, position: [0.45, 0.0, 1.0]}
"""
folder = Path(tempfile.mkdtemp())
(folder / "my-crop.yaml").write_text(SCENE)
scene = load_scene(folder / "my-crop.yaml")
print(*(f"{item.id}: {item.role}" for item in scene.objects), sep="\n")

# %% [markdown]
# `plan` returns a result, whether it succeeds or not. The message says which fruit is pushed, and
# how hard.

# %%
result = plan(scene, seed=0)
print(result.status)
print(result.message)

# %%
print(f"not clean with probability {result.prediction.probability:.0%}")
print({name: f"{force:.1f} N" for name, force in result.prediction.forces.items()})

# %%
result.plot()

# %% [markdown]
# The simulation has stems that bend, fruits that swing, and a joint controller. Its outcome is not
# the planner's word.

# %%
outcome = simulate(result).outcome
print(outcome.success, "-", outcome.message)

# %% [markdown]
# A detector errs. `sigma` is its standard deviation in metres. The prediction is a mean over places
# where the fruits may hang. Here there is room, and the probability stays small.

# %%
for millimetres in (0, 5, 10):
    seen = f"role: pushable, sigma: {millimetres / 1000},"
    (folder / "seen.yaml").write_text(SCENE.replace("role: pushable,", seen))
    made = plan(load_scene(folder / "seen.yaml"))
    print(f"{millimetres:2d} mm: {made.status}, not clean: {made.prediction.probability:.0%}")

# %%
assert result.success
assert outcome.success
