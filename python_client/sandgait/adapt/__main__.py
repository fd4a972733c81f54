"""`python -m sandgait.adapt`, which is `sandgait adapt`."""

import sys

from .command import main

sys.exit(main())
