"""`python -m nqr_geom.cli` is the command `nqr-geom`."""

import sys

from nqr_geom.cli import main

sys.exit(main())
