"""`python -m cabinpose`, for environments whose scripts are not on the path."""

from __future__ import annotations

import sys

from cabinpose.app.cli import main

sys.exit(main())
