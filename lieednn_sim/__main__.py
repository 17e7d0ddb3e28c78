"""``python -m lieednn_sim`` runs the command ``lieednn-sim``, also where that is not on the path."""

import sys

from lieednn_sim.cli import main

sys.exit(main())
