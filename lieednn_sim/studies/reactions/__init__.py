"""The reactive benchmark: planners that react to disturbances in the closed loop."""
