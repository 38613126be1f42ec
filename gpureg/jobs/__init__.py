"""The work of each command: read a file, process it, write the result."""
