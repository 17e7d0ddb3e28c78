"""Planners that LieEDNN is compared with: interpolation, sampling, optimisation and movement primitives."""
