"""What a GPU makes of the kernels, beside what was predicted: ``python -m bench.gpu``, at most eight minutes."""
