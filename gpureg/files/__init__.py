"""Picture files and text tables; this room knows no graph."""
