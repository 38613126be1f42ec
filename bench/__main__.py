"""``python -m bench`` runs the cases."""

import sys

from .run import main

sys.exit(main())
