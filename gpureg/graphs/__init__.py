"""Weighted graphs: how they are stored, made, read and written."""
