"""The NVIDIA Warp backend: CUDA devices, or the CPU."""
