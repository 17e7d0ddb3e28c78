"""Proofs about the neural ODE x' = -gamma x + mu W phi(x) + mu b, from its weight matrix alone.

`assess` evaluates a hierarchy of sufficient conditions for stability, each with the convergence rate that it proves.
`find_certificate` searches for a diagonal Lyapunov matrix, which proves that there is one equilibrium and that it
attracts every start, whatever the bias; `verify` checks one. `robustness` bounds the effect of perturbations of the
state, the lag behind a moving target, and the time steps with which a fixed-step integrator keeps the proof.
"""

from lieednn_sim.stability.certificate import Certificate, find_certificate, verify
from lieednn_sim.stability.conditions import CONDITIONS, Condition, Verdict, assess
from lieednn_sim.stability.contraction import Contraction, find_contraction, verify_contraction
from lieednn_sim.stability.norms import LogNorms, WeightedNorm, log_norms, smallest_one_norm, weighted_norm
from lieednn_sim.stability.robustness import INTEGRATORS_WITH_PROOF, Decay, Guarantee, Robustness, robustness
from lieednn_sim.typecheck import typecheck_public

__all__ = [
    "CONDITIONS",
    "INTEGRATORS_WITH_PROOF",
    "Certificate",
    "Condition",
    "Contraction",
    "Decay",
    "Guarantee",
    "LogNorms",
    "Robustness",
    "Verdict",
    "WeightedNorm",
    "assess",
    "find_certificate",
    "find_contraction",
    "log_norms",
    "robustness",
    "smallest_one_norm",
    "verify",
    "verify_contraction",
    "weighted_norm",
]

typecheck_public(globals())
