"""Positions and velocities of the joints of closed loops, by Newton's method on MuJoCo's own equality constraints."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import scipy

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.checks import FREE, SCALAR
from lieednn_sim.arm.equalities import EXACT, Indices, Residuals, dof_addresses, names, position_addresses, turns
from lieednn_sim.errors import InputError, NoSolutionError
from lieednn_sim.values import Floats

# The largest residual [m, rad] that is accepted if rounding allows no smaller one.
CLOSED = 1e-10
# Singular values below this part of the largest count as zero: the loop is at a dead centre, or not determined.
SINGULAR = 1e-5
# Largest turn of a joint in one step along the way to a configuration [rad], and the least part of the way in a step.
LARGEST_TURN, LEAST_STEP = 0.5, 1e-3
# Grid of configurations from which others are reached [rad; fraction of the model's extent], and how many are kept.
GRID_TURN, GRID_SLIDE, GRID_SIZE = 0.25, 0.05, 4096
_DEACTIVATE = 'deactivate the equality: active="false" in a file, or data.eq_active'


class _Solution(NamedTuple):
    """A configuration ``(nq,)`` that closes the loops, and the Jacobian ``(E, nv)`` of their residual there."""

    qpos: Floats
    jacobian: Floats


class ClosedLoops:
    """The joints that equality constraints of closed loops move when others are given.

    A solution is followed from the model's state along a straight line in the given joints, so that the loops stay on
    the branch of the state. It does not depend on earlier calls.

    The dependent joints of the loops' equalities are moved by the drivers, dofs of the independent joints; ``follow``
    sets the joints of ``(nq,)`` that follow those in closed form, in place. `NoSolutionError` if the loops cannot be
    closed near the state, or it is a dead centre; `InputError` if the dependent joints are not determined.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        equalities: Sequence[int],
        joints: Sequence[int],
        drivers: Indices,
        follow: Callable[[Floats], object],
    ) -> None:
        self._model, self._joints, self._drivers, self._follow = model, tuple(joints), drivers, follow
        self._residuals = Residuals(model, data, equalities, joints)
        self.dofs = self._residuals.dofs
        self._grid = np.where(turns(model, drivers), GRID_TURN, GRID_SLIDE * model.stat.extent)
        self._near: dict[tuple[int, ...], _Solution | None] = {}
        start = data.qpos.copy()
        follow(start)
        residual, start = self._residuals.settle(start)
        # Equalities without dependent joints tie independent ones, which `check_independent` reports.
        if joints and np.abs(residual).max(initial=0.0) > CLOSED:
            raise NoSolutionError(
                f"in the given state {self._residuals.gap(residual)}, and no position of {names(model, joints)} near "
                "it closes the gap; put a state into data.qpos in which the parts meet, or check the anchors"
            )
        self._reference = _Solution(start, self._residuals.at(start)[1])
        self._check_determined()

    def solve(self, rows: Floats) -> None:
        """Set the dependent joints of the rows ``(S, nq)``, in place; all other joints are given.

        A row that has no solution, or none that is reached from the state, becomes NaN.
        """
        last, (guesses, moved) = self._reference, self._interpolated(rows)
        for row, guess in zip(rows, guesses, strict=True):
            # The guess is so good that one step of Newton's method leads to the solution.
            jacobian = self._newton(guess, moved) if moved else None
            solution, reached = self._reach(last, row) if jacobian is None else (_Solution(guess, jacobian), True)
            if reached:
                last, row[:] = solution, solution.qpos
            else:
                row[:] = np.nan

    def _interpolated(self, rows: Floats) -> tuple[Floats, float]:
        """Rows ``(S, nq)`` near the solutions along a path, from those of every eighth, and how far these are apart.

        It gives the rows and zero if these are few or too far apart, or have no solutions.
        """
        some, given = np.append(np.arange(0, len(rows) - 1, 8), len(rows) - 1), self._residuals.given
        few = rows[some if len(some) >= 8 else []]
        if not len(few) or np.abs(np.diff(few[:, given], axis=0)).max(initial=0.0) > 0.1:
            return rows, 0.0
        self.solve(few)
        if np.isnan(few).any():
            return rows, 0.0
        guesses = scipy.interpolate.CubicSpline(some, few)(np.arange(len(rows)))
        for guess in guesses:
            mujoco.mj_normalizeQuat(self._model, guess)
        guesses[:, given] = rows[:, given]
        return guesses, float(np.linalg.norm(np.diff(few, axis=0), axis=1).max())

    def slopes(self, qpos: Floats, known: Floats) -> Floats:
        """Velocities ``(D, m)`` of the dependent dofs at the closed configuration ``(nq,)``: -J_d^+ J_i V.

        V ``(nv, m)``, here ``known``, are the velocities of the other dofs for each independent rate. `NoSolutionError`
        if the configuration is a dead centre.
        """
        jacobian, given = self._residuals.at(qpos)[1], self._residuals.known
        result, singular = self._residuals.least_squares(jacobian, jacobian[:, given] @ known[given])
        if len(singular) and singular[-1] <= SINGULAR * singular[0]:
            raise NoSolutionError(
                f"joints {names(self._model, self._joints)} are at a dead centre (singular) where "
                f"{self._drivers_at(qpos)}: their velocities are not determined; keep away from there"
            )
        return result

    def check_independent(self, known: Floats, joints: Sequence[int]) -> None:
        """Raise `InputError` where the loops leave the independent joints less freedom than they have, at the state.

        ``known`` is V ``(nv, m)`` as in `slopes`; ``joints`` are the joints of the independent rates.
        """
        jacobian = self._residuals.at(self._reference.qpos)[1]
        given = jacobian[:, self._residuals.known] @ known[self._residuals.known]
        left = given + jacobian[:, self.dofs] @ self._residuals.least_squares(jacobian, given)[0]
        large = np.abs(left) > 1e-6 * max(1.0, np.abs(given).max(initial=0.0))
        # A stretched loop lets its joints move at first, but no further.
        large[:, [self._stuck(rates) for rates in known.T]] = True
        if large.any():
            tied = {joint for joint, column in zip(joints, large.T, strict=True) if column.any()}
            excess = int(np.linalg.matrix_rank(left, 1e-6))
            leave = f"leave {excess} of them out of the independent joints, or " if 0 < excess < left.shape[1] else ""
            raise InputError(
                f"joints {names(self._model, tied)} cannot move independently, because of "
                f"{self._residuals.owners(large.any(axis=1))}; {leave}{_DEACTIVATE}"
            )

    def _stuck(self, rates: Floats) -> bool:
        """Whether the loops close neither after a small motion ``(nv,)`` of the given joints nor after the reverse."""
        small, start = 1e-3, self._reference
        for motion in (small * rates, -small * rates):
            target = start.qpos.copy()
            mujoco.mj_integratePos(self._model, target, motion, 1.0)
            self._follow(target)
            if self._track(start, target)[1] == 1.0:
                return False
        return True

    def _reach(self, last: _Solution, row: Floats) -> tuple[_Solution, bool]:
        """The solution at a row, or the last one on the way there; and whether the row was reached."""
        furthest, most = last, -1.0
        for start in self._starts(last, row):
            solution, part = self._track(start, row)
            if part > most:
                furthest, most = solution, part
            if part == 1.0:
                break
        return furthest, most == 1.0

    def _newton(self, qpos: Floats, moved: float) -> Floats | None:
        """Close the loops in place after a motion of size ``moved``; the Jacobian there, or None if it went too far.

        Corrections that shrink by 4, the first one against the motion, leave Newton's method no way to another branch.
        """
        while True:
            residual, jacobian = self._residuals.at(qpos)
            error = np.abs(residual).max(initial=0.0)
            if error < EXACT:
                return jacobian
            step, _ = self._residuals.least_squares(jacobian, residual)
            size = float(np.linalg.norm(step))
            if size > 0.25 * moved or size == 0.0:
                return jacobian if error < CLOSED else None
            self._residuals.move(qpos, step)
            moved = size

    def _track(self, solution: _Solution, target: Floats) -> tuple[_Solution, float]:
        """Follow a solution towards the given joints of ``target``; the last solution, and its part of the way."""
        known, involved, turning = self._residuals.known, self._residuals.involved, self._residuals.turning
        change = self._residuals.difference(solution.qpos, target)
        change[self.dofs] = 0.0
        turn = np.abs(change[turning]).max(initial=0.0)
        longest = min(1.0, LARGEST_TURN / turn) if turn else 1.0
        reached, size = 0.0, longest
        while reached < 1.0:
            final = size >= 1.0 - reached
            motion = change * min(size, 1.0 - reached)
            rates = solution.jacobian[:, known] @ motion[known]
            motion[self.dofs], _ = self._residuals.least_squares(solution.jacobian, rates)
            jacobian = None
            if np.abs(motion[turning]).max(initial=0.0) <= 1.001 * LARGEST_TURN:
                qpos = solution.qpos.copy()
                mujoco.mj_integratePos(self._model, qpos, motion, 1.0)
                if final:
                    qpos[self._residuals.given] = target[self._residuals.given]
                else:
                    self._follow(qpos)
                jacobian = self._newton(qpos, float(np.linalg.norm(motion[involved])))
            if jacobian is not None:
                solution = _Solution(qpos, jacobian)
                reached = 1.0 if final else reached + size
                size = min(2.0 * size, longest)
            elif size <= LEAST_STEP:
                break
            else:
                size *= 0.5
        return solution, reached

    def _starts(self, last: _Solution, row: Floats) -> Iterator[_Solution]:
        """Solutions to start from towards ``row``: on a path the last one; after a jump, a known one near by."""
        steps = self._residuals.difference(last.qpos, row)[self._drivers] / self._grid
        on_path = bool(np.abs(steps).max(initial=0.0) <= 1.0)
        if on_path:
            yield last
        if (near := self._solution_near(row)) is not None:
            yield near
        if not on_path or last is not self._reference:
            yield self._reference

    def _solution_near(self, row: Floats) -> _Solution | None:
        """The solution on a grid point of the independent joints near ``row``; None where it is not reached."""
        steps = np.rint(self._residuals.difference(self._reference.qpos, row)[self._drivers] / self._grid)
        key, known = tuple(map(int, steps)), self._near
        if key not in known:
            motion = np.zeros(self._model.nv)
            motion[self._drivers] = steps * self._grid
            target = self._reference.qpos.copy()
            mujoco.mj_integratePos(self._model, target, motion, 1.0)
            self._follow(target)
            if len(known) >= GRID_SIZE:
                self._near = known = {}  # another thread may be reading the old ones
            solution, reached = self._track(self._reference, target)
            known[key] = solution if reached == 1.0 else None
        return known[key]

    def _check_determined(self) -> None:
        """Raise `InputError` if dependent joints can move alone, `NoSolutionError` if they are singular."""
        model, start = self._model, self._reference.qpos
        _, singular, directions = np.linalg.svd(self._reference.jacobian[:, self.dofs])
        free = directions[np.count_nonzero(singular > SINGULAR * singular.max(initial=0.0)) :]
        # Newton's method tells the two apart: it undoes a small motion at a dead centre, but not that of a free joint.
        small, moving = 1e-2, False
        for direction in free:
            qpos = start.copy()
            self._residuals.move(qpos, small * direction)
            if self._newton(qpos, small) is not None:
                moving |= bool(np.linalg.norm(self._residuals.difference(start, qpos)[self.dofs]) > 0.5 * small)
        if moving:
            parts = {j: free[:, np.isin(self.dofs, dof_addresses(model, [j]))] for j in self._joints}
            loose = [j for j, part in parts.items() if np.abs(part).max() > 1e-6]
            scalars = [j for j in loose if model.jnt_type[j] in SCALAR]
            columns = free[:, np.searchsorted(self.dofs, model.jnt_dofadr[scalars])]
            # The joints that move most come first.
            triangle, order = scipy.linalg.qr(columns, mode="r", pivoting=True)
            chosen = [scalars[k] for k, left in zip(order, np.diag(triangle), strict=False) if abs(left) > 1e-6]
            more = f"add {len(chosen)} of these to them, for example {names(model, chosen)}, or " if chosen else ""
            ties = np.abs(self._reference.jacobian[:, dof_addresses(model, loose)]).max(axis=1) > 1e-6
            held = ", a body in the hand by a weld in place of a connect" if FREE in model.jnt_type[loose] else ""
            raise InputError(
                f"joints {names(model, loose)} are moved by the arm through {self._residuals.owners(ties)}, but not "
                f"determined by its independent joints; {more}hold them by another equality{held}, or {_DEACTIVATE}"
            )
        if len(free):
            raise NoSolutionError(
                f"the given state is a dead centre (singular) of the loops of {names(model, self._joints)}, where "
                "these can move in two ways; put a state into data.qpos that is away from it"
            )

    def failure(self, number: int, row: Floats) -> NoSolutionError:
        """The error for a row ``(nq,)``, named by its number, that has no solution."""
        furthest, _ = self._reach(self._reference, row)
        start = row.copy()
        dependent = np.setdiff1d(np.arange(self._model.nq), self._residuals.given)
        start[dependent] = furthest.qpos[dependent]
        residual, _ = self._residuals.settle(start)
        gap = "the loops close, but a dead centre is on the way from the state, or there"
        if np.abs(residual).max(initial=0.0) > CLOSED:
            gap = f"{self._residuals.gap(residual)}, whatever {names(self._model, self._joints)} do"
        return NoSolutionError(
            f"no solution for row {number}, where {self._drivers_at(row)}: {gap}; on the way there the last solution "
            f"is where {self._drivers_at(furthest.qpos)}, so keep the independent joints on that side"
        )

    def _drivers_at(self, qpos: Floats) -> str:
        joints = dict.fromkeys(map(int, self._model.dof_jntid[self._drivers]))
        values = ((names(self._model, [j]), qpos[position_addresses(self._model, [j])]) for j in joints)
        return ", ".join(f"{name} = {' '.join(f'{x:.4g}' for x in value)}" for name, value in values)
