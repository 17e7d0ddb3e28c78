"""
A certificate for your own weights
==================================

Is your recurrent network globally stable? A network x' = -gamma x + mu W tanh(x) + mu b may have one equilibrium that
attracts every start, several stable equilibria, or none. This example assesses three weight matrices. It shows which
conditions hold, which fail, by how much the weights must be scaled to pass, and trajectories from many starts. It needs
only a matrix, no robot.
"""

import matplotlib.pyplot as plt
import numpy as np

import lieednn_sim as ls

# %%
# The first matrix has strong couplings of opposite signs. Every condition on norms fails. But a search finds a diagonal
# Lyapunov matrix, and eigenvalues confirm it: lambda_max is below gamma/mu = 1. So the network has one equilibrium for
# every bias, which attracts every start.

gamma, mu, bias = 1.0, 1.0, np.array([0.2, -0.1])
strong = np.array([[0.4, 4.0], [-1.5, 0.3]])
print(ls.stability.assess(strong, gamma=gamma, mu=mu))

# %%
# In the second matrix each neuron excites itself. All conditions fail, and lambda_max of the best diagonal Lyapunov
# matrix exceeds gamma/mu. For a given diagonal, lambda_max is proportional to W. So the weights pass after
# multiplication by less than gamma/(mu lambda_max), or with gamma above mu lambda_max.

exciting = np.array([[1.8, -0.5], [0.3, 1.6]])
verdict = ls.stability.assess(exciting, gamma=gamma, mu=mu)
print(verdict)
largest = gamma / (mu * verdict.certificate.lambda_max)
print(f"passes below {largest:.3f} times W, or with gamma above {gamma / largest:.1f}")
scaled = 0.95 * largest * exciting
print(ls.stability.find_certificate(scaled, gamma=gamma, mu=mu))

# %%
# Trajectories agree with this. The stars mark where they end: in one state, in two, and in one.

x = np.linspace(-3.0, 3.0, 25)
figure, axes = plt.subplots(1, 3, figsize=(6.4, 2.7), sharey=True)
figure.set_layout_engine("constrained")
titles = ("strong: certified", "exciting: not certified", "scaled: certified")
for panel, weight, title in zip(axes, (strong, exciting, scaled), titles, strict=True):
    states = np.stack(np.meshgrid(x, x), axis=-1)
    for step in range(4000):
        rate = -gamma * states + mu * (np.tanh(states) @ weight.T + bias)
        if step == 0:
            panel.streamplot(x, x, *np.moveaxis(rate, -1, 0), linewidth=0.7, arrowsize=0.7)
        states = states + 0.02 * rate
    ends = states.reshape(-1, 2)
    panel.plot(*ends.T, "*", color="C3", ms=9)
    panel.set(xlabel="$x_1$", aspect="equal", xlim=(-3.0, 3.0), ylim=(-3.0, 3.0))
    panel.set_title(title, fontsize="medium")
    print(f"{title}; final states: {len(np.unique(ends.round(3), axis=0))}")
axes[0].set_ylabel("$x_2$")
