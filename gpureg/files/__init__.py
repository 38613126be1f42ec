"""Read and write picture files and text tables; nothing here uses graphs."""
