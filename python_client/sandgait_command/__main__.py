"""Runs the command line for `python -m sandgait_command`, or if Python is given the path of this package."""

import sys
from pathlib import Path

if not __package__:
    sys.path.insert(0, str(Path(__file__).parents[1]))

from sandgait_command import main

sys.exit(main())
