"""``python -m bench.quality`` measures."""

import sys

from .run import main

sys.exit(main())
