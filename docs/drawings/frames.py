"""The link frames of an arm, drawn on it, and what its joints do between them."""

from drawings import style

import lieednn_sim as ls

arm = ls.Arm.load("telescopic_pr")
q = arm.keyframe("extended")
_, axis = style.figure(3.9)
seen_at = style.show_arm(axis, arm, q, size=(960, 640), crop=(0.14, 0.96, 1.0, 0.0))
frames = [arm.base.as_matrix(), *arm.link_poses(q).as_matrix()]
origins = style.draw_frames(axis, seen_at, frames, 0.24)
labels = ("base", "link 1", "link 2", "link 3", "link 4 =\nend effector")
places = ((0, 44), (-74, -34), (-40, -62), (-76, -50), (-60, -80))
box = {"boxstyle": "round,pad=0.2", "fc": "white", "ec": "none", "alpha": 0.85}
for label, origin, place in zip(labels, origins, places, strict=True):
    axis.annotate(label, origin + place, ha="center", va="center", bbox=box)
names = ("turn\nlift", "pitch\nextend1", "yaw\nextend2", "wrist_pitch\nextend3")
sides = ((-66, 0), (62, 50), (44, 58), (26, 62))
for i, (name, side) in enumerate(zip(names, sides, strict=True)):
    middle = seen_at(0.5 * (frames[i][:3, 3] + frames[i + 1][:3, 3]))
    axis.annotate(name, middle + side, ha="center", va="center", color=style.ORANGE, bbox=box)
