"""A recording of another picker beside our planner; scripts/notebooks.py makes the notebook."""

# %% [markdown]
# # My recording
#
# Your machine picked: what would our planner have done? Nothing is moved. The same as a script:
# `python examples/notebooks/my_recording.py` (needs the package `optipromp-loop`).

# %%
import json
from pathlib import Path
from tempfile import mkdtemp

import numpy as np

from optipromp import load_scene, plan
from optipromp.core.scenes.io import scene_to_dict
from optipromp_loop.shadow import compared, page, recording

# %% [markdown]
# A recording is a table of joint states, with the gripper's joint, and a file of what was detected.
# Here another planner is the machine, and goes straight at the ripe fruit.

# %%
folder, scene = Path(mkdtemp()), load_scene("scenario-3")
motion = plan(scene, planner="promp").trajectory
times = np.arange(0.0, motion.duration + 2.0, 0.01)  # it stands for a second before and after
gripper = np.where(times < motion.duration + 1.5, 0.04, 0.01)
rows = np.column_stack([times, motion.sample(times - 1.0)[0], gripper])
head = ",".join(["time", *motion.joint_names, "finger"])
np.savetxt(folder / "arm.csv", rows, delimiter=",", header=head, comments="")
fruits = [item | {"sigma": 0.003} for item in scene_to_dict(scene)["objects"] if "stem" in item]
looks = [{"time": 0.1 * k, "objects": fruits} for k in range(5)]
told = {"joint_states": "arm.csv", "gripper": "finger", "looks": looks}
_ = (folder / "shift.json").write_text(json.dumps(told))

# %% [markdown]
# The same as `optipromp shadow shift.json --known scenario-3 --out shift.html`:

# %%
read = recording.load_recorded(folder / "shift.json", scene)
picks = compared.shadowed(read, scene)
print(*page.told_in_words(page.summary(picks)), *read.lacks, sep="\n")
print("recorded:", picks[0].theirs.message)
print("ours:", picks[0].ours.status, f"paths {1e3 * picks[0].apart:.0f} mm apart")
page.paths_figure(picks[0])

# %%
assert picks[0].harmful
assert picks[0].tried
