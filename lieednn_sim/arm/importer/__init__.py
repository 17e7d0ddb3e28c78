"""Import of arms: any MJCF or URDF with a serial chain of hinge, slide and ball joints, made into one `Arm` reads."""

from lieednn_sim.arm.importer.draft import ImportReport
from lieednn_sim.arm.importer.importing import ImportOptions, import_arm
from lieednn_sim.typecheck import typecheck_public

__all__ = ["ImportOptions", "ImportReport", "import_arm"]

typecheck_public(globals())
