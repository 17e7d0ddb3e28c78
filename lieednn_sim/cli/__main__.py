"""``python -m lieednn_sim.cli``."""

import sys

from lieednn_sim.cli import main

sys.exit(main())
