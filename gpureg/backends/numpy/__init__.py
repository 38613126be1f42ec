"""The numpy backend: the oracle that the devices are compared with."""
