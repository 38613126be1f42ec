"""The figures of the paper, drawn again: one file each, ``python -m bench.figures DIR``."""
