"""The figure of a learnt primitive: the demonstrations, and the band it puts about them."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from optipromp.promp import Demonstrations, ProMP

RECORDED, LEARNT = "#3d434b", "#1f5fb4"


def primitive_figure(promp: "ProMP", demonstrations: "Demonstrations") -> "Figure":
    """Each joint over the phase: the demonstrations, the mean, and two standard deviations.

    Args:
        promp: learnt from ``demonstrations``.
        demonstrations: of the same joints in the same order.
    """
    from matplotlib.figure import Figure

    n = promp.n_joints
    columns = 1 if n <= 3 else 2
    rows = -(-n // columns)
    figure = Figure(figsize=(5.2 * columns, 1.9 * rows + 0.8), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True).ravel(order="F")
    phases = np.linspace(0.0, 1.0, 201)
    mean, band = promp.mean_trajectory(phases), 2.0 * promp.standard_deviation(phases)
    faint = float(np.clip(20.0 / len(demonstrations), 0.3, 0.8))
    for j, panel in enumerate(panels[:n]):
        for i, item in enumerate(demonstrations):
            label = "demonstrations" if i == 0 else None
            panel.plot(
                item.phases, item.positions[:, j], color=RECORDED, lw=0.7, alpha=faint, label=label
            )
        panel.fill_between(
            phases, mean[:, j] - band[:, j], mean[:, j] + band[:, j], color=LEARNT, alpha=0.2, lw=0,
            label="learnt mean ± 2 standard deviations",
        )  # fmt: skip
        panel.plot(phases, mean[:, j], color=LEARNT, lw=1.8)
        panel.set_title(promp.joint_names[j].replace("$", r"\$"), fontsize=9, loc="left")
        panel.set_ylabel("rad or m", fontsize=8)
        panel.margins(x=0.0, y=0.06)
        panel.spines[["top", "right"]].set_visible(False)
        panel.grid(color="#e6e8eb", lw=0.7)
        panel.tick_params(labelsize=8, labelbottom=j % rows == rows - 1 or j == n - 1)
    for panel in panels[n:]:
        panel.set_visible(False)
    handles, labels = panels[0].get_legend_handles_labels()
    legend = figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)
    for handle in legend.legend_handles:
        if handle is not None and handle.get_label() == "demonstrations":
            handle.set_alpha(1.0)
    counted = f"{len(demonstrations)} demonstrations, {promp.basis.count} bases a joint"
    figure.suptitle(f"{counted}: joints over the phase", fontsize=11)
    return figure
