"""Chains of coupled joints, by hand."""

import pytest

from lieednn_sim.arm.coordinates import to_independent_leaders
from lieednn_sim.errors import InputError


def test_followers_of_followers_follow_their_leader():
    """q3 = 5 q2 + 7 with q2 = 2 q1 + 3 and q1 = -q0 + 1: q2 = -2 q0 + 5 and q3 = -10 q0 + 32."""
    direct = {3: (2, 5.0, 7.0), 2: (1, 2.0, 3.0), 1: (0, -1.0, 1.0), 9: (8, 0.5, 0.25)}
    assert to_independent_leaders(direct, str) == {
        3: (0, -10.0, 32.0),
        2: (0, -2.0, 5.0),
        1: (0, -1.0, 1.0),
        9: (8, 0.5, 0.25),
    }


@pytest.mark.parametrize("circle", [{1: 1}, {1: 2, 2: 1}, {0: 1, 1: 2, 2: 1}, {0: 1, 1: 2, 2: 3, 3: 2}])
def test_circles_are_refused_wherever_they_are_entered(circle):
    direct = {follower: (leader, 1.0, 0.0) for follower, leader in circle.items()}
    with pytest.raises(InputError, match=f"joint {next(iter(circle))} is coupled in a circle"):
        to_independent_leaders(direct, lambda joint: f"joint {joint}")
