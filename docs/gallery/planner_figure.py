"""
Five planners in a figure for a paper
=====================================

Compare five planners on the same random targets, and make a table and a figure for a paper. Every run is in a CSV
table; the figure shows medians and ranges of three measures, as PDF for the paper and as PNG for slides. There are only
three targets, so that this page builds quickly; add seeds, arms and scenes by changing one line each.
"""

import matplotlib.pyplot as plt
import numpy as np

import lieednn_sim as ls
from lieednn_sim.studies import Settings

# %%
# Each finished run is stored in ``comparison/comparison.sqlite``; an interrupted comparison continues from there. With
# ``jobs=4`` it uses worker processes; a script then needs the guard ``if __name__ == "__main__":``.

planners = ["minimum-jerk", "se3-geodesic", "dmp", "lieednn-certified", "lieednn-shaped"]
case = {"arms": ["telescopic_pr"], "scenes": ["free"], "controllers": ["inverse-dynamics"]}
settings = Settings(duration=2.0, hold=0.2)
rows = list(ls.compare("comparison", planners=planners, seeds=3, **case, settings=settings).rows.values())
runs = {name: [row for row in rows if row.planner == name] for name in planners}
measures, values = ("path_m", "jerk_joints", "gap_mm"), {}
print(f"{'planner':<18}  arrived  proof   path [m]  jerk [ranges/s³]  gap [mm]")
for name in planners:
    values[name] = np.array([[getattr(row, m) for row in runs[name]] for m in measures])
    path, jerk, gap = np.median(values[name], axis=1)
    arrived, proof = sum(row.success for row in runs[name]), runs[name][0].stability
    print(f"{name:<18}  {arrived} of 3   {proof:<6}  {path:8.2f}  {jerk:16.2f}  {gap:8.3f}")

# %%
# Each dot is a run, each bar spans all runs, and each vertical mark is a median. Path lengths are relative to those of
# minimum jerk, since the targets lie at different distances. Planners with a proof of global stability are blue.

titles = ("path / minimum jerk", "joint jerk [ranges/s³]", "mechanism gap [mm]")
with plt.rc_context({"font.size": 8, "pdf.fonttype": 42}):  # text stays text in the PDF
    figure, axes = plt.subplots(1, 3, figsize=(6.75, 2.5), sharey=True)
    figure.set_layout_engine("constrained")
    for k, (panel, title) in enumerate(zip(axes, titles, strict=True)):
        for y, name in enumerate(planners):
            x = values[name][k] / (values["minimum-jerk"][0] if k == 0 else 1.0)
            style = {"color": "C0" if runs[name][0].stability == "global" else "0.45"}
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
# Without obstacles minimum jerk is the shortest and smoothest. A certified network pays for its proof with a longer
# path and a mechanism gap. A shaped network has the proof, nearly the path of minimum jerk, and almost no gap.
