"""Proofs about the neural ODE x' = -gamma x + mu W phi(x) + mu b, from its weight matrix alone.

`assess` evaluates a hierarchy of sufficient conditions for stability, each with the convergence rate that it proves.
`find_certificate` searches for a diagonal Lyapunov matrix, which proves that there is one equilibrium and that it
attracts every start, whatever the bias; `verify` checks one. `robustness` bounds the effect of perturbations of the
state, the lag behind a moving target, and the time steps with which a fixed-step integrator keeps the proof.
"""

from lieednn_sim.stability.certificate import Certificate as Certificate
from lieednn_sim.stability.certificate import find_certificate as find_certificate
from lieednn_sim.stability.certificate import verify as verify
from lieednn_sim.stability.conditions import CONDITIONS as CONDITIONS
from lieednn_sim.stability.conditions import Condition as Condition
from lieednn_sim.stability.conditions import Verdict as Verdict
from lieednn_sim.stability.conditions import assess as assess
from lieednn_sim.stability.contraction import Contraction as Contraction
from lieednn_sim.stability.contraction import find_contraction as find_contraction
from lieednn_sim.stability.contraction import verify_contraction as verify_contraction
from lieednn_sim.stability.guarantees import Guarantee as Guarantee
from lieednn_sim.stability.norms import LogNorms as LogNorms
from lieednn_sim.stability.norms import WeightedNorm as WeightedNorm
from lieednn_sim.stability.norms import log_norms as log_norms
from lieednn_sim.stability.norms import smallest_one_norm as smallest_one_norm
from lieednn_sim.stability.norms import weighted_norm as weighted_norm
from lieednn_sim.stability.robustness import INTEGRATORS_WITH_PROOF as INTEGRATORS_WITH_PROOF
from lieednn_sim.stability.robustness import Decay as Decay
from lieednn_sim.stability.robustness import Robustness as Robustness
from lieednn_sim.stability.robustness import robustness as robustness
from lieednn_sim.typecheck import typecheck_public

typecheck_public(globals())
