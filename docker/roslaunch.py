#!/usr/bin/python3
"""roslaunch, but more patient: it gives a starting master 10 s, which a busy small board needs longer for."""

import sys

import roslaunch
import roslaunch.launch

# Private to roslaunch, and there is no option for it. Where it goes by another name, nothing changes.
roslaunch.launch._TIMEOUT_MASTER_START = 120.0  # noqa: SLF001

sys.exit(roslaunch.main())
