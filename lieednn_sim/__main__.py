"""``python -m lieednn_sim``, the command ``lieednn-sim`` where it is not on the path."""

import sys

from lieednn_sim.cli import main

sys.exit(main())
