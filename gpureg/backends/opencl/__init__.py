"""The OpenCL backend: any GPU with a driver, or a CPU through PoCL."""
