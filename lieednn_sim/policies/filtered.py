"""A policy behind the safety filter, which replaces its reference by the nearest that keeps limits and clearance."""

from __future__ import annotations

from collections.abc import Mapping

from lieednn_sim.policies.barriers import FilterOptions
from lieednn_sim.policies.base import Policy
from lieednn_sim.policies.safety_filter import SafetyFilter
from lieednn_sim.values import Floats


class FilteredPolicy(Policy):
    """Another policy behind a safety filter, which keeps position, velocity and acceleration limits and clearance.

    The state of the wrapped policy does not depend on the filter, except that its speed limits count from the filtered
    reference. Its proof covers only this state; where an obstacle blocks the arm, the filtered reference stays behind.

    Args:
        policy: the policy.
        options: settings of the filter.

    Attributes:
        inner: the wrapped policy.
        blocking: what held the reference back in the last period, see `FilterStep`.
        braked: see `FilterStep`.

    Raises:
        InputError: `reset` raises it if something touches at the start.
    """

    def __init__(self, policy: Policy, options: FilterOptions | None = None) -> None:
        super().__init__(policy.arm, policy.rate)
        self.inner, self._options = policy, options
        self.certified = policy.certified
        # A dictionary, which can be pickled.
        self.channel_units = dict(policy.channel_units)

    def begin(self, q: Floats) -> None:
        """See `Policy`; unchecked."""
        self.inner.reset(q)
        self._filter = SafetyFilter(self.arm, self.period, self._options)
        self._filter.allow(q)
        self.blocking: tuple[str, ...] = ()
        self.braked = False

    def see(self, places: Mapping[str, Floats]) -> None:
        """See `Policy`; raises `InputError` for names of no obstacles."""
        super().see(places)
        self.inner.see(places)
        self._filter.see(places)

    def act(self, measured: Floats | None, target: Floats) -> tuple[Floats, Floats]:
        """See `Policy`; unchecked."""
        q, qd = self.inner.step(measured, target)
        error = q - self.q - 0.5 * self.period * self.qd
        # Rate at which the reference is pulled towards the unfiltered one [1/s].
        tracking_gain = 8.0
        step = self._filter.step(self.q, self.qd, qd + tracking_gain * error)
        self.blocking, self.braked = step.blocking, step.braked
        moved = self.q + 0.5 * self.period * (self.qd + step.velocity)
        # The inner policy takes the filtered reference for its own.
        self.inner.q, self.inner.qd = moved, step.velocity
        return moved, step.velocity

    @property
    def state(self) -> Floats:
        """See `Policy`."""
        return self.inner.state

    @property
    def message(self) -> str:
        """See `Policy`."""
        if not self.blocking:
            return self.inner.message
        return f"{'brakes for' if self.braked else 'is held back by'} {self.blocking[0]}"

    def channels(self) -> Floats:
        """See `Policy`."""
        return self.inner.channels()
