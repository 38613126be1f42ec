"""gpureg and its peers side by side: ``python -m bench`` in a checkout. README.md says how to read the table."""
