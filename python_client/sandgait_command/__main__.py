"""`python -m sandgait_command`, also by its path."""

import sys
from pathlib import Path

if not __package__:
    sys.path.insert(0, str(Path(__file__).parents[1]))

from sandgait_command import main

sys.exit(main())
