"""Bring your own arm: any MJCF with a serial chain of hinge, slide and ball joints, made into one that `Arm` reads."""

from lieednn_sim.arm.importer.adopt import Adoption, adopt

__all__ = ["Adoption", "adopt"]
