"""What the plots show: units, names and scales, read from the figures themselves."""

from dataclasses import replace

import gantries
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from rollouts import make_rollout

import lieednn_sim as ls
from lieednn_sim.arm import Arm
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.errors import InputError
from lieednn_sim.evaluation import figure_layout, joint_plots, plots
from lieednn_sim.evaluation.figure_layout import fix_layout
from lieednn_sim.learning.training import History
from lieednn_sim.planning.motion import Motion
from lieednn_sim.simulation import Disturbances, Push


@pytest.fixture
def drawn(monkeypatch):
    """The figures, kept instead of written."""
    figures = []
    monkeypatch.setattr(figure_layout, "save_figure", lambda figure, path: figures.append(figure))
    return figures


@pytest.fixture(scope="module")
def arm():
    return replace(Arm.load("telescopic_pr"), length_scale=2.0)


def rollout_of(arm, q, q_ref):
    return make_rollout(
        arm,
        q,
        t=np.linspace(0.0, 1.0, len(q)),
        q_ref=q_ref,
        force=np.tile(0.05 * arm.force_limits, (len(q), 1)),
        motion_end=0.5,
        disturbances=Disturbances(pushes=(Push("link 1", (1.0, 0.0, 0.0), 0.25, 0.5),)),
    )


def test_a_run_is_plotted_by_one_call(gantry, tmp_path):
    target = np.array([0.1, 0.2, 0.3, 0.4])
    planned = ls.plan(gantry, target, planner="linear-attractor", duration=2.0)
    written = ls.plot(ls.simulate(gantry, planned, hold=0.0), tmp_path / "new")
    assert {path.name for path in written} == {"tracking.png", "joints.png", "network.png", "clearance.png"}
    assert all(path.exists() for path in written)
    policy = ls.make_policy("linear-attractor", gantry, target)
    written = ls.plot(ls.follow(policy, target, 0.1).rollout, tmp_path / "other")
    assert {path.name for path in written} == {"tracking.png", "joints.png", "channels.png"}
    with pytest.raises(InputError, match="rollout must be a Rollout"):
        ls.plot(planned, tmp_path)


def test_no_bound_is_plotted_above_a_measured_distance(drawn):
    """A push leads the arm into the window's frame for a while."""
    arm = Arm.load("telescopic_pr", scene="window", seed=1)
    planned = ls.plan(arm, ls.draw_target(arm, seed=1))
    push = Push(arm.link_names[-1], (300.0, 300.0, 0.0), 1.5, 0.3)
    for disturbances in (Disturbances(pushes=(push,)), Disturbances()):
        run = ls.simulate(arm, planned, disturbances=disturbances)
        plots.plot_clearance(run, "clearance.png")
        axis = drawn[-1].axes[0]
        words = [text.get_text() for text in drawn[-1].legends[0].texts]
        assert (words[:2] == ["proved", "not proved"]) == bool(push in disturbances.pushes)
        bound, edges, _ = axis.patches[0].get_data()
        t, measured = axis.lines[0].get_data()
        assert edges[0] == 0.0
        assert edges[-1] == run.t[-1]
        assert measured[145] == pytest.approx(1e3 * Collisions(arm).clearance(run.q[725]))
        for time, distance in zip(t, measured, strict=True):
            # On an edge both intervals hold.
            here = bound[(edges[:-1] <= time + 1e-9) & (time - 1e-9 <= edges[1:])]
            assert (here <= max(distance, 0.0) + 1e-6).all()
        proved = bound > 0.0
        assert np.diff(edges)[~proved].sum() == pytest.approx(np.diff(run.clearance.unproved).sum(), abs=0.05)
        # And not far below.
        assert np.mean(np.interp(0.5 * (edges[1:] + edges[:-1]), t, measured)[proved] - bound[proved]) < 3.0


def test_the_network_s_plot_names_links_and_shows_radians_and_metres(arm, drawn):
    t, target = np.array([0.0, 1.0]), np.arange(24.0).reshape(4, 6) / 24.0
    xi = np.stack([np.zeros((4, 6)), target])
    zeros = np.zeros((2, 8))
    motion = Motion(t, t, xi, target, zeros, zeros, np.zeros((2, 4)), np.zeros((2, 4)))
    plots.plot_network(replace(rollout_of(arm, zeros, zeros), motion=motion), "network.png")
    *axes, clock, bend = (axis for axis in drawn[0].axes if axis.get_visible())
    assert len(axes) == 8
    assert clock.lines[0].get_ydata() == pytest.approx([0.0, 1.0])
    assert [line.get_label() for line in bend.lines] == list(arm.link_names)
    assert np.abs([line.get_ydata() for line in bend.lines]).max() < 1e-9, "straight ways"
    for i, (angle, length) in enumerate(zip(axes[::2], axes[1::2], strict=True)):
        assert angle.get_title("left").startswith(f"{arm.link_names[i]} (neuron {i + 1})")
        assert (angle.get_ylabel(), length.get_ylabel()) == ("[rad]", "[m]")
        assert [line.get_ydata()[-1] for line in angle.lines[::2]] == pytest.approx(target[i, :3])
        # Twists are stored in units of the arm's length scale.
        assert [line.get_ydata()[-1] for line in length.lines[::2]] == pytest.approx(2.0 * target[i, 3:])
        assert [line.get_ydata()[0] for line in length.lines[1::2]] == pytest.approx(2.0 * target[i, 3:])
    assert "target" in [text.get_text() for text in drawn[0].legends[0].texts]


def test_what_other_neurons_do_together_is_the_distance_from_the_straight_way():
    """From (3, 1) to (0, 1): half way on a circle 2 off, and a neuron that stays where it is."""
    xi = np.array([[[3.0, 1.0], [5.0, 5.0]], [[1.5, 3.0], [5.0, 5.0]], [[0.0, 1.0], [5.0, 5.0]]])
    assert plots.bends(xi, xi[-1]) == pytest.approx(np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 0.0]]))


@pytest.mark.parametrize("names", [["a"], ["lieednn-shaped, from their mean start", "starts elsewhere"] * 4])
def test_a_legend_is_within_its_figure(names):
    figure = Figure(figsize=(6.4, 4), layout="constrained")
    figure.subplots()
    figure_layout.fitted_legend(figure, {f"{name} {k}": Line2D([], []) for k, name in enumerate(names)}, 7)
    fix_layout(figure, 130)
    (legend,) = figure.legends
    box = legend.get_window_extent()
    assert 0.0 <= box.x0 < box.x1 <= figure.bbox.width


def test_the_joints_plot_tells_the_error_and_does_not_exaggerate(arm, drawn):
    reference = np.tile(arm.keyframe("home"), (3, 1))
    q = reference.copy()
    q[:, 0] += np.deg2rad([0.0, 0.5, 0.2])
    q[:, 1] += [0.0, 0.002, 0.001]
    rates = np.zeros_like(q)
    rates[1, :2] = [0.25, -0.5] * arm.velocity_limits[:2]
    joint_plots.plot_joints(replace(rollout_of(arm, q, reference), qd=rates), "joints.png")
    rows = np.array(drawn[0].axes).reshape(-1, 4)
    turn, lift = rows[0], rows[1]
    assert turn[1].lines[0].get_ydata() == pytest.approx([0.0, 0.5, 0.2])
    assert lift[1].lines[0].get_ydata() == pytest.approx([0.0, 2.0, 1.0])
    assert (turn[1].get_ylabel(), lift[1].get_ylabel()) == ("[deg]", "[mm]")
    assert turn[2].lines[0].get_ydata() == pytest.approx([0.0, 25.0, 0.0])
    assert lift[2].lines[0].get_ydata() == pytest.approx([0.0, -50.0, 0.0])
    np.testing.assert_allclose(turn[3].lines[0].get_ydata(), 5.0)
    assert turn[3].get_ylim()[1] >= 10.0, "a twentieth of the limit does not fill the height"
    assert turn[0].lines[0].get_color() != turn[0].lines[1].get_color()
    words = [text.get_text() for text in drawn[0].legends[0].texts]
    assert words == ["simulated", "reference", "limits", "end of the motion", "push"]


@pytest.mark.usefixtures("drawing")
def test_the_joints_plot_can_be_drawn(gantry, tmp_path, monkeypatch):
    monkeypatch.setattr(figure_layout, "_DPI", 20)
    joint_plots.plot_joints(make_rollout(gantry), tmp_path / "joints.png")
    assert (tmp_path / "joints.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(("joint", "column", "unit"), [(7, 0, 1e-3), (0, 1, np.deg2rad(1.0))])
def test_the_tracking_plot_shows_how_far_from_the_reference_and_from_the_target(arm, drawn, joint, column, unit):
    """In mm of the last slide, which moves the end effector alone, and in degrees of a turn of the whole arm."""
    reference = np.tile(arm.keyframe("home"), (3, 1))
    q, target = reference.copy(), reference[0].copy()
    q[:, joint] += unit * np.array([0.0, 0.5, 0.2])
    target[joint] += 2.0 * unit
    plots.plot_tracking(replace(rollout_of(arm, q, reference), target=target), "tracking.png")
    upper, lower = drawn[0].axes[column::2]
    *others, last = upper.lines[: arm.n_links]
    assert last.get_ydata() == pytest.approx([0.0, 0.5, 0.2])
    for line in others:
        np.testing.assert_allclose(line.get_ydata(), last.get_ydata() if joint == 0 else 0.0, atol=1e-9)
    assert lower.lines[0].get_ydata() == pytest.approx([2.0, 1.5, 1.8])
    assert lower.lines[0].get_color() == last.get_color()


def test_the_tracking_plot_ends_where_nothing_matters(arm, drawn):
    q = np.tile(arm.keyframe("home"), (3, 1))
    plots.plot_tracking(rollout_of(arm, q, q), "tracking.png")
    upper, lower = drawn[0].axes[:2], drawn[0].axes[2:]
    # Errors of rounding: the axes still span a tenth of what counts as settled, 1 mm and 0.1 degrees.
    assert [axis.get_ylim() for axis in upper] == [pytest.approx((-0.002, 0.1)), pytest.approx((-0.0002, 0.01))]
    assert [axis.get_ylim()[0] for axis in lower] == pytest.approx([0.01, 0.001])
    assert [axis.get_ylabel() for axis in drawn[0].axes] == ["[mm]", "[deg]"] * 2
    assert {"end of the motion", "push"} <= {text.get_text() for text in drawn[0].legends[0].texts}
    assert [line.get_xdata()[0] for line in upper[0].lines[-1:]] == [0.5]


def test_the_training_s_plot_has_units_and_ticks(drawn):
    epochs = np.arange(1.0, 4.0)
    xi = np.stack([np.full((1, 6), value) for value in (0.5, 0.9, 1.0)])
    columns = np.array([[3.0, 2.0, 1e-6], [0.0, 0.5, 1.0], [0.5, 0.8, 0.8]])
    history = History(epochs, *columns, epochs, epochs, xi)
    plots.plot_training(history, np.ones((1, 6)), 1e-5, "training.png")
    distance, accuracy, rate, equilibrium = drawn[0].axes
    assert distance.lines[1].get_ydata() == pytest.approx([0.5, 0.1, 0.0])
    assert accuracy.lines[0].get_ydata() == pytest.approx([0.0, 50.0, 100.0])
    assert rate.get_ylim() == pytest.approx((0.1, 1.0)), "whole decades, so that ticks have numbers"
    assert all(axis.get_ylabel() for axis in drawn[0].axes)
    assert [text.get_text() for text in equilibrium.get_legend().texts][-1] == "target"


@pytest.mark.usefixtures("drawing")
@pytest.mark.parametrize(("kind", "first"), [("pdf", b"%PDF"), ("svg", b"<?xml"), ("png", b"\x89PNG")])
def test_plots_are_written_in_the_format_of_the_name(kind, first, tmp_path):
    figure = Figure(figsize=(1, 1), layout="constrained")
    figure.subplots().set_title("$\\xi$")
    figure_layout.save_figure(figure, tmp_path / f"plot.{kind}")
    assert (tmp_path / f"plot.{kind}").read_bytes().startswith(first)


@pytest.mark.usefixtures("drawing")
def test_the_training_s_plot_can_be_drawn_of_a_single_epoch(tmp_path, monkeypatch):
    monkeypatch.setattr(figure_layout, "_DPI", 20)
    one = np.ones(1)
    history = History(one, one, one, one, one, one, np.zeros((1, 1, 6)))
    plots.plot_training(history, np.ones((1, 6)), 1e-5, tmp_path / "training.png")
    assert (tmp_path / "training.png").read_bytes().startswith(b"\x89PNG")


def test_a_settled_figure_is_as_its_layout_engine_leaves_it_and_is_drawn_once(tmp_path, monkeypatch):
    def made():
        figure = Figure(figsize=(2, 1.5), layout="constrained")
        figure.subplots().set_ylabel("two\nlines")
        figure.legend([Line2D([], [])], ["a"], loc="outside upper center")
        return figure

    one, other = made(), made()
    one.savefig(tmp_path / "one.png", dpi=130)
    fix_layout(other, 130)
    draws = []
    monkeypatch.setattr(other, "draw", lambda renderer: (draws.append(1), Figure.draw(other, renderer)))
    other.savefig(tmp_path / "other.png", dpi=130)
    assert draws == [1]
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "other.png").read_bytes()


def test_channels_of_one_unit_share_a_subplot_and_every_entry_has_a_line(gantry, drawn):
    channels = {"pull": np.arange(6.0).reshape(3, 2), "twist": np.arange(3.0), "push": np.arange(12.0).reshape(3, 2, 2)}
    rollout = make_rollout(gantry, channels=channels, channel_units={"pull": "N", "twist": "N m", "push": "N"})
    plots.plot_channels(rollout, "channels.png")
    forces, torques = drawn[0].axes
    assert [axis.get_ylabel() for axis in (forces, torques)] == ["[N]", "[N m]"]
    assert torques.get_xlabel() == "time [s]"
    names = ["pull[0]", "pull[1]", "push[0, 0]", "push[0, 1]", "push[1, 0]", "push[1, 1]"]
    assert [text.get_text() for text in forces.get_legend().texts] == names
    np.testing.assert_array_equal(forces.lines[4].get_ydata(), channels["push"][:, 1, 0])
    np.testing.assert_array_equal(torques.lines[0].get_ydata(), channels["twist"])


def test_the_frequencies_of_a_load_are_plotted_along_the_motion(drawn, tmp_path):
    """The same everywhere, for a pendulum below a cart."""
    arm = gantries.gantry(damping=3.0)
    run = ls.simulate(arm, ls.plan(arm, [1.0], planner="minimum-jerk", duration=2.0), hold=1.0)
    assert "modes" in plots.plots_of(run)
    plots.plot_modes(run, tmp_path / "modes.png")
    (line, _) = drawn[-1].axes[0].lines
    np.testing.assert_allclose(line.get_ydata(), np.sqrt(9.81 / gantries.LENGTH) / (2.0 * np.pi), rtol=1e-4)
    assert [text.get_text() for text in drawn[-1].legends[0].texts] == ["1 swing (3.4%)", "end of the motion"]
