"""``python -m gpureg``."""

from .cli import main

main()
