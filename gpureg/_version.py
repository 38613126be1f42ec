"""The version of gpureg."""

__version__ = "0.1.0"
