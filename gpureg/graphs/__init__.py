"""Weighted graphs: storage, construction, reading and writing."""
