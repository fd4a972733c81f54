"""`python -m sandgait.certify`, which is `sandgait certify`."""

import sys

from .command import main

sys.exit(main())
