"""The variational problem (eq. 19, 20): its checks, arrays on a device, result and memory."""
