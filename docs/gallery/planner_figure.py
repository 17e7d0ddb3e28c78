"""
Five planners in a figure for a paper
=====================================

If you write about motion planning, you need a table of all runs and a figure that
summarises it. This example compares five planners on the same random targets, keeps
every run in a CSV table, and draws medians and ranges of three measures. It saves the
figure as PDF for the paper and as PNG for slides. There are only three targets, so that
this page is built quickly; more seeds, arms and scenes are a change of one line each.
"""

from concurrent.futures import ThreadPoolExecutor

import matplotlib.pyplot as plt
import numpy as np

import lieednn_sim as ls
from lieednn_sim.studies import Settings

# %%
# The comparison writes each run to ``comparison/comparison.csv`` at once, and
# continues from there if it is interrupted. By default it uses worker processes,
# which in a script need the guard ``if __name__ == "__main__":``. For a few runs a
# thread will do.

planners = ["minimum-jerk", "se3-geodesic", "dmp", "lieednn-certified", "lieednn-shaped"]
table = ls.compare(
    "comparison",
    planners=planners,
    arms=["telescopic_pr"],
    scenes=["free"],
    controllers=["inverse-dynamics"],
    seeds=3,
    settings=Settings(duration=2.0, hold=0.2),
    executor=ThreadPoolExecutor(1),
)
rows = {name: [] for name in planners}
for row in table.sorted_rows():
    rows[row.planner].append(row)
print(f"{'planner':<18}  arrived  proof   path [m]  jerk [ranges/s³]  gap [mm]")
for name, runs in rows.items():
    values = [(row.path_m, row.jerk_joints, row.gap_mm) for row in runs]
    path, jerk, gap = np.median(values, axis=0)
    arrived = f"{sum(row.success for row in runs)} of {len(runs)}"
    measured = f"{path:8.2f}  {jerk:16.2f}  {gap:8.3f}"
    print(f"{name:<18}  {arrived}   {runs[0].stability:<6}  {measured}")

# %%
# Each dot is a run, each bar spans all runs, and each vertical mark is a median. Path
# lengths are relative to those of minimum jerk, since the targets lie at different
# distances. Planners with a proof of global stability are blue.

shortest = np.array([row.path_m for row in rows["minimum-jerk"]])
measures = {
    "path / minimum jerk": ("path_m", shortest),
    "joint jerk [ranges/s³]": ("jerk_joints", 1.0),
    "mechanism gap [mm]": ("gap_mm", 1.0),
}
with plt.rc_context({"font.size": 8, "pdf.fonttype": 42}):  # text stays text in the PDF
    figure, axes = plt.subplots(1, 3, figsize=(6.75, 2.5), sharey=True)
    figure.set_layout_engine("constrained")
    for panel, (title, (column, unit)) in zip(axes, measures.items(), strict=True):
        for y, runs in enumerate(rows.values()):
            x = np.array([getattr(row, column) for row in runs]) / unit
            style = {"color": "C0" if runs[0].stability == "global" else "0.45"}
            panel.plot([x.min(), x.max()], [y, y], lw=6, alpha=0.3, **style)
            panel.plot(x, np.full(len(x), y), "o", ms=3, **style)
            panel.plot(np.median(x), y, "|", ms=14, mew=2, **style)
        panel.set_xlabel(title)
        panel.grid(axis="x", alpha=0.3)
    axes[0].set_yticks(range(len(planners)), planners)
    axes[0].set_ylim(len(planners) - 0.5, -0.5)
    figure.savefig("planners.pdf")
    figure.savefig("planners.png", dpi=110)
plt.close(figure)

# %%
# Without obstacles straight minimum jerk is the shortest and smoothest. A certified
# network adds its proof, at the price of a longer path and of a mechanism gap. A
# shaped network has the proof and nearly the path of minimum jerk, almost without a
# gap.
