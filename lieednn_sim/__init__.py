"""LieEDNN on a telescopic manipulator: certified neural planners on se(3), simulated and rendered in MuJoCo."""
