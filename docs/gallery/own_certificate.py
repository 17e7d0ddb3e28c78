"""
A certificate for your own weights
==================================

A recurrent network x' = -gamma x + mu W tanh(x) + mu b may have one equilibrium that
attracts every start, or several, or none that is stable. Who has such a network,
whether from training or from a paper, wants to know which it is. This example assesses
three weight matrices: it shows which conditions hold, which fail, and by how much the
weights must be scaled to pass, beside the trajectories from everywhere. It needs no
robot and no network class, only a matrix.
"""

import matplotlib.pyplot as plt
import numpy as np

import lieednn_sim as ls

# %%
# The first matrix is strong in one direction only. Every condition on its norms
# fails, but there is a diagonal Lyapunov matrix, which is found and then checked by
# its eigenvalues: lambda_max lies below gamma/mu = 1. So the network has one
# equilibrium, for every bias, and it attracts every start.

gamma, mu, bias = 1.0, 1.0, np.array([0.2, -0.1])
strong = np.array([[0.4, 4.0], [-1.5, 0.3]])
print(ls.stability.assess(strong, gamma=gamma, mu=mu))

# %%
# The second matrix excites each neuron by itself. Here everything fails; the best
# diagonal Lyapunov matrix reaches a lambda_max above gamma/mu. For a fixed diagonal
# lambda_max is proportional to W, so the weights pass once they are multiplied by
# less than gamma/(mu lambda_max). A gamma raised to more than mu lambda_max does the
# same.

exciting = np.array([[1.8, -0.5], [0.3, 1.6]])
verdict = ls.stability.assess(exciting, gamma=gamma, mu=mu)
print(verdict)
largest = gamma / (mu * verdict.certificate.lambda_max)
print(f"certified below {largest:.3f} W, or above gamma {gamma / largest:.3f}")
scaled = 0.95 * largest * exciting
print(ls.stability.find_certificate(scaled, gamma=gamma, mu=mu))

# %%
# The trajectories from everywhere in the plane say the same. The stars are the states
# that they end at: one, two, one.

x = np.linspace(-3.0, 3.0, 25)
grid = np.stack(np.meshgrid(x, x), axis=-1)


def rate(weight, state):
    return -gamma * state + mu * (np.tanh(state) @ weight.T + bias)


figure, axes = plt.subplots(1, 3, figsize=(6.4, 2.7), sharey=True)
figure.set_layout_engine("constrained")
shown = {
    "strong, certified": strong,
    "exciting, not certified": exciting,
    f"times {0.95 * largest:.2f}, certified": scaled,
}
for panel, (title, weight) in zip(axes, shown.items(), strict=True):
    flow = rate(weight, grid)
    u, v = np.moveaxis(flow, -1, 0)
    panel.streamplot(x, x, u, v, linewidth=0.7, arrowsize=0.7, density=0.9)
    ends = grid.reshape(-1, 2)
    for _ in range(4000):
        ends = ends + 0.02 * rate(weight, ends)
    panel.plot(*ends.T, "*", color="C3", ms=9)
    panel.set(xlabel="$x_1$", aspect="equal", xlim=(-3.0, 3.0), ylim=(-3.0, 3.0))
    panel.set_title(title, fontsize="medium")
    print(f"{title}: {len(np.unique(ends.round(3), axis=0))} end(s)")
axes[0].set_ylabel("$x_2$")
