"""Steps of a mass of 1 kg on a servo, whose growth is known by hand, and what is said of them."""

import numpy as np
import pytest

import lieednn_sim as ls
from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.step_stability import step_growth, step_remedy
from lieednn_sim.errors import SimulationError

MASS = """<mujoco><option timestep=".002" integrator="{}"/><worldbody><body name="mass">
<joint name="x" type="slide" axis="1 0 0" range="-1 1"/><geom size=".1" mass="1"/></body></worldbody>
<actuator><position joint="x" kp="{}" kv="{}"/></actuator></mujoco>"""
TOLD = "steps near rest are unstable with integrator {} and timestep 0.002, and stable with <option {}/>"


@pytest.mark.parametrize(
    ("integrator", "kp", "kv", "growth", "remedy"),
    [
        # v' = (1 - h kv) v by Euler's method, v / (1 + h kv) by the other.
        ("Euler", 0, 1500, 2.0, TOLD.format("Euler", 'integrator="implicitfast"')),
        ("implicitfast", 0, 1500, 1.0, ""),
        ("Euler", 0, 999, 1.0, ""),
        # Without damping h^2 kp may be 4: at 9 the root is that of z + 1 / z = 2 - 9.
        ("implicitfast", 9 / 4e-6, 0, 6.854, TOLD.format("implicitfast", 'integrator="implicitfast" timestep="0.001"')),
        ("Euler", 9 / 4e-6, 0, 6.854, TOLD.format("Euler", 'integrator="implicitfast" timestep="0.001"')),
    ],
)
def test_unstable_steps_are_told_with_what_makes_them_stable(integrator, kp, kv, growth, remedy):
    model = mujoco.MjModel.from_xml_string(MASS.format(integrator, kp, kv))
    assert step_growth(model, np.zeros(1)) == pytest.approx(growth, rel=1e-3)
    assert step_remedy(model, np.zeros(1)) == remedy


def test_a_report_says_that_servos_of_a_file_are_unstable_and_a_run_why_it_failed():
    spec = mujoco.MjSpec.from_string(MASS.format("Euler", 1000, 1500))
    arm, told = ls.Arm.from_spec(spec, floor="none"), TOLD.format("Euler", 'integrator="implicitfast"')
    assert told in arm.import_report.notes
    motion = ls.plan(arm, [0.5], planner="minimum-jerk", duration=1.0)
    with pytest.raises(SimulationError, match=f"failed at t = .* s: .*; {told}$"):
        ls.simulate(arm, motion)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    stable = ls.Arm.from_spec(spec, floor="none")
    assert not any("unstable" in note for note in stable.import_report.notes)
    assert ls.evaluate(ls.simulate(stable, motion)).final_worst_mm < 1e-3
