"""Environments for robot learning: tasks on simulated arms, with two interfaces and an expert policy.

- `tasks`: the tasks, independent of the interface: ``make_task("reach")``, ``make_task("track")``.
- `suite`: the tasks in the style of the dm_control suite: ``suite.load("telescopic_pr", "reach")`` returns a
  ``dm_control.rl.control.Environment``, with ``physics`` and rendering.
- `gymnasium`: the tasks as Gymnasium environments ``LieEDNN/TelescopicReach-v0`` and ``LieEDNN/TelescopicTrack-v0``,
  single or many that are stepped together; needs the extra ``gymnasium``.
- `expert`: a policy for a single environment that follows a LieEDNN plan.
"""
