"""Random starts: which arrive, and where the others come to rest."""

from __future__ import annotations

import numpy as np

from lieednn_sim.learning.demonstrations import Demonstration, align
from lieednn_sim.learning.demonstrations.alignment import displacement
from lieednn_sim.learning.demonstrations.models import LinearAttractor, even_grid, run_field
from lieednn_sim.studies.demonstrations.models import Attraction, attraction, random_starts

LINE = align([Demonstration.from_samples([[2.0, 0.0], [0.0, 0.0]], [0.0, 1.0])])


class TwoWells:
    """x' = x - x^3 along x, and decay in y: attractors at x = 1 and -1, after a shift at 0 and -2."""

    name, n_parameters, durations = "two wells", 0, 1.0

    def reproduce(self, start, t):
        shift = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0])

        def field(x):
            return np.where(shift > 0.0, 10.0 * (x - x**3), -x)

        return run_field(field, start + shift, even_grid(t[-1], 0.01), t) - shift


def test_a_second_attractor_is_found():
    starts = np.zeros((5, 6))
    starts[:, 3] = [-3.0, -2.0, -1.5, -0.5, 1.0]
    starts[:, 4] = 0.1
    assert attraction(TwoWells(), LINE, starts) == Attraction(starts=5, arrived=2, spurious=1)


def test_what_still_moves_is_no_attractor():
    slow = LinearAttractor(duration=100.0)
    found = attraction(slow, LINE, random_starts(LINE, 20))
    assert found.spurious == 0
    assert found.arrived < 20
    assert attraction(LinearAttractor.fit(LINE), LINE, random_starts(LINE, 20)).arrived == 20


def test_starts_surround_the_demonstrations():
    starts = random_starts(LINE, 2000, seed=1)
    np.testing.assert_array_equal(starts[:, [0, 1, 2, 5]], 0.0)
    np.testing.assert_allclose(starts[:, 3].min(), -2.0, atol=0.02)
    np.testing.assert_allclose(starts[:, 3].max(), 4.0, atol=0.02)
    np.testing.assert_allclose(starts[:, 4].max(), 2.0, atol=0.02)
    posed = align([Demonstration.from_samples([[2.0, 0, 0, 1, 0, 0, 0], [0, 0, 0, 1, 0, 0, 0]])])
    turned = displacement(random_starts(posed, 2000, seed=1))
    np.testing.assert_allclose(np.linalg.norm(turned[:, :3], axis=1).max(), 0.9 * np.pi, rtol=1e-3)
    np.testing.assert_allclose(turned[:, 5].max(), 2.0, atol=0.02)
