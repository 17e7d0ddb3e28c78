import dm_env
import numpy as np
import pytest
from absl.testing import absltest
from dm_env.test_utils import EnvironmentTestMixin
from numpy.testing import assert_array_equal

from lieednn_sim.arm import Arm
from lieednn_sim.environments.expert import Expert
from lieednn_sim.errors import InputError

control = pytest.importorskip("dm_control.rl.control")
suite = pytest.importorskip("lieednn_sim.environments.suite")


class TestReach(EnvironmentTestMixin, absltest.TestCase):
    """The contract of dm_env, to the end of an episode and on."""

    def make_object_under_test(self):
        return suite.load("telescopic_pr", "reach", random=0, time_limit=0.3)

    def make_action_sequence(self):
        for _ in range(40):
            yield self.make_action()


class TestTrack(TestReach):
    def make_object_under_test(self):
        return suite.load("telescopic_pr", "track", random=0, time_limit=0.3)


def play(environment, steps=20):
    rng = np.random.default_rng(0)
    shape = environment.action_spec().shape
    return [environment.step(rng.uniform(-1.0, 1.0, shape)) for _ in range(steps)]


def flat(steps):
    return np.concatenate([np.ravel(value) for step in steps for value in step.observation.values()])


def test_one_seed_makes_one_sequence_of_episodes():
    options = {"task": "track", "time_limit": 0.1}
    one, other = (suite.load(random=seed, **options) for seed in (5, np.random.default_rng(5)))
    first = play(one)
    assert_array_equal(flat(play(other)), flat(first))
    # The second episode is another one, and after a reset with the seed all is as it was.
    targets = [step.observation["preview"] for step in first if step.first()]
    assert (targets[0] != targets[1]).any()
    fresh = suite.load(random=5, **options)
    assert_array_equal(flat([one.reset(seed=5), *play(one, 5)]), flat([fresh.reset(), *play(fresh, 5)]))


def test_episodes_end_at_the_time_limit_with_discount_1_and_when_physics_fails_with_0():
    environment = suite.load(random=0, time_limit=0.1)
    steps = play(environment, 7)
    assert [step.step_type for step in steps] == [dm_env.StepType(kind) for kind in (0, 1, 1, 1, 1, 2, 0)]
    assert steps[5].discount == 1.0
    environment.task.simulation.data.qvel[0] = np.inf
    failed = environment.step(np.zeros(8))
    assert failed.last()
    assert failed.discount == 0.0
    assert failed.reward == 0.0
    assert environment.step(np.zeros(8)).first()


def test_specs_name_what_they_are():
    environment = suite.load("telescopic_rrp", "track", control_timestep=0.01, preview=3)
    assert environment.control_timestep() == pytest.approx(0.01)
    assert "yaw4" in environment.action_spec().name
    spec = environment.observation_spec()
    assert {name: item.shape for name, item in spec.items()} == {
        "position": (12,),
        "velocity": (12,),
        "command": (12,),
        "position_error": (12,),
        "approach": (12,),
        "pose_error": (1, 6),
        "target_velocity": (12,),
        "preview": (3, 12),
    }
    assert all(item.name == name and item.dtype == np.float64 for name, item in spec.items())


def test_physics_is_what_is_simulated():
    environment = suite.load(random=0, time_limit=0.1)
    assert isinstance(environment, control.Environment)
    data, physics = environment.task.simulation.data, environment.physics
    for k in range(4):
        step = environment.step(np.full(8, 0.5)) if k else environment.reset()
        np.testing.assert_allclose(physics.position()[:8], step.observation["position"], atol=1e-12)
        assert physics.data.ptr is data
        assert physics.time() == pytest.approx(environment.task.time)
        # What follows from the positions belongs to the present time too.
        ahead = physics.copy()
        ahead.forward()
        assert_array_equal(physics.data.xpos, ahead.data.xpos)
        assert_array_equal(physics.data.cam_xpos, ahead.data.cam_xpos)
        assert_array_equal(physics.data.qfrc_bias, ahead.data.qfrc_bias)
    # A copy goes on by itself.
    before = data.qpos.copy()
    ahead.step(3)
    assert_array_equal(data.qpos, before)
    assert ahead.time() == pytest.approx(physics.time() + 0.006)


@pytest.mark.rendering
def test_the_pixel_wrapper_of_dm_control_sees_the_arm_move():
    from dm_control.suite.wrappers import pixels

    environment = suite.load(random=0, time_limit=1.0)
    # Shadows of 4096 points and smooth pictures of 1920 x 1080 take longest without a graphics card.
    visual = environment.physics.model.vis
    visual.quality.shadowsize, visual.quality.offsamples = 64, 0
    visual.global_.offwidth, visual.global_.offheight = 64, 48
    options = {"height": 48, "width": 64, "camera_id": "side"}
    wrapped = pixels.Wrapper(environment, pixels_only=False, render_kwargs=options)
    assert wrapped.observation_spec()["pixels"].shape == (48, 64, 3)
    first = wrapped.reset().observation
    assert {"pixels", "position"} < set(first)
    assert first["pixels"].std() > 5.0
    for _ in range(4):
        step = wrapped.step(np.ones(8))
    assert (step.observation["pixels"] != first["pixels"]).any()
    assert_array_equal(step.observation["pixels"], environment.physics.render(**options))


def test_the_expert_works_here_too():
    environment = suite.load(random=0, task="track", time_limit=0.2)
    expert = Expert(environment)
    step = environment.reset()
    while not step.last():
        step = environment.step(expert.act())
    assert step.reward == 1.0


def test_an_arm_of_one_s_own_is_as_good_as_a_name():
    assert suite.load(Arm.load("telescopic_pr"), "reach", scene="poles", random=0).task.arm.scene == "poles"
    with pytest.raises(InputError, match="random must be a whole number"):
        suite.load(random=-1)
